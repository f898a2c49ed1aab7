"""`companion fleet`: its command line, and the words for what vehicles answer and check. The rest is flown in tests/fleet."""

import argparse
import json
import logging
from math import pi
from pathlib import Path

import pytest
from msgspec.structs import replace
from test_director import status

from companion.cli import main
from companion.config.fleet import load_fleet
from companion.config.reference import (
    CircleReference,
    Figure8Reference,
    PointReference,
    Reference,
    TargetReference,
    WaypointsReference,
)
from companion.config_file import ConfigError
from companion.fleet_options import FleetOptions, add_fleet_arguments, fleet_options
from companion.ground.answers import answer_lines, answers_as_data, readiness_as_data, readiness_lines, status_lines
from companion.ground.formations import assigned, check_wish, places_enu_m, refusal_of, wished_slots
from companion.ground.readiness import checks_of
from companion.ground.references import wished
from companion.ground.session import Answer, operator_here
from companion.link.log import COMMANDS_A_SECOND, CommandLog
from companion.types import (
    ZERO3,
    Command,
    CommandName,
    CommandReply,
    FlightPhase,
    FlownSlot,
    Heading,
    HealthFlag,
    HeldReference,
    PositionError,
    Status,
    Vector3,
)

PAIR = str(Path(__file__).parents[2] / "config" / "fleets" / "pair.yaml")
AT = ["--at", "0", "-5", "4"]
ANSWERS = {
    2: Answer(CommandReply(2, 9, False, "arm: attitude \x1b[31mstale"), 0.0314),
    1: Answer(CommandReply(1, 9, True, "arm"), 0.012),
    3: None,
}


def test_each_vehicle_has_a_line_with_its_answer_and_time() -> None:
    assert answer_lines(ANSWERS, 3.0) == [
        "vehicle 1   accepted   12 ms  arm",
        "vehicle 2   refused    31 ms  arm: attitude ?[31mstale",
        "vehicle 3   missing           no answer within 3 s",
    ]


def test_the_same_as_data() -> None:
    data = json.loads(json.dumps(answers_as_data(ANSWERS, 3.0)))
    assert [(v["vehicle_id"], v["answer"], v["after_s"]) for v in data] == [
        (1, "accepted", 0.012),
        (2, "refused", 0.0314),
        (3, "missing", None),
    ]


FIT = replace(status(1), peers=(2,), battery_percent=80.0, position_error=PositionError(0.1, 0.2))


def test_a_vehicle_in_order_is_ready() -> None:
    checks = checks_of(replace(FIT, flags=(HealthFlag.LEADER_LOST,)), (1, 2), 1)
    assert all(check.fit for check in checks)
    lines = readiness_lines({1: checks}, [], 3.0)
    assert lines[0] == "vehicle 1  ready"
    assert "  battery     ok  80 %" in lines
    assert "  estimator   ok  error 0.10 m in the plane, 0.20 m in height" in lines
    assert readiness_as_data({1: checks}, [2])[1] == {"vehicle_id": 2, "ready": False, "checks": []}


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        ({"flags": (HealthFlag.MODE_STALE,)}, "autopilot", "flight mode older than allowed"),
        ({"flags": (HealthFlag.POSITION_JUMPED,)}, "estimator", "jumped too far"),
        ({"lacks": ("battery: 15 %; wanted: at least 40 %",)}, "battery", "15 %; wanted"),
        ({"flags": (HealthFlag.FRAME_UNKNOWN,)}, "origin", "origin is unknown"),
        ({"flags": (HealthFlag.FENCE,)}, "origin", "outside the fence"),
        ({"peers": ()}, "peers", "does not hear 2"),
        ({"formation_hash": 2}, "fleet file", "another one than this"),
        ({"lacks": ("separation: in the plane vehicle 2 is 0.40 m",)}, "separation", "in the plane vehicle 2"),
        ({"lacks": ("altitude: on the ground vehicle 2 is 3.0 m above",)}, "separation", "altitude: on the ground"),
        ({"lacks": ("COM_OF_LOSS_T: not found",)}, "parameters", "COM_OF_LOSS_T"),
    ],
)
def test_whatever_is_wrong_is_one_check_that_says_so(change: dict[str, object], name: str, words: str) -> None:
    checks = checks_of(replace(FIT, **change), (1, 2), 1)  # type: ignore[arg-type]
    wrong = [check for check in checks if not check.fit]
    assert [check.name for check in wrong] == [name]
    assert words in wrong[0].found
    assert readiness_lines({1: checks}, [], 3.0)[0] == "vehicle 1  not ready"


def test_every_flag_is_somebodys() -> None:
    for flag in set(HealthFlag) - {HealthFlag.LEADER_LOST}:
        checks = checks_of(replace(FIT, flags=(flag,)), (1, 2), 1)
        assert sum(not check.fit for check in checks) == 1, flag


def test_the_status_says_who_holds_command_and_who_is_silent() -> None:
    lines = status_lines({1: replace(FIT, holder="anna@ground")}, [2], 3.0)
    assert "commanded by anna@ground" in lines[0]
    assert lines[1] == "vehicle 2   missing: nothing heard of it for 3 s"


@pytest.mark.parametrize(
    ("slot", "words"),
    [
        (FlownSlot(ZERO3, formation=3, waiting=3), "3"),
        (FlownSlot(ZERO3, formation=3, waiting=4), "3, 4 to come"),
        (FlownSlot(ZERO3, (0.1, 0.0, 0.0), formation=4, waiting=4, moves=True), "on the way to 4"),
    ],
)
def test_the_status_says_which_formation_is_flown_or_on_its_way(slot: FlownSlot, words: str) -> None:
    assert f" formation {words}, reference -, " in status_lines({1: replace(FIT, slot=slot)}, [], 3.0)[0]


def test_the_status_says_where_a_formation_points_that_turns() -> None:
    assert " formation 0 at 90 deg, " in status_lines({1: replace(FIT, heading=Heading(pi / 2.0))}, [], 3.0)[0]


@pytest.mark.parametrize(
    ("held", "target_age_s", "words"),
    [
        (HeldReference(2, 2), None, "2"),
        (HeldReference(2, 3), None, "2, 3 to come"),
        (HeldReference(2, 2), 0.31, "2, target 0.3 s old"),
    ],
)
def test_the_status_says_which_reference_is_flown_and_how_old_its_target_is(
    held: HeldReference, target_age_s: float | None, words: str
) -> None:
    told = status_lines({1: replace(FIT, reference=held, target_age_s=target_age_s)}, [], 3.0)[0]
    assert f" reference {words}, commanded by nobody" in told


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["hold", "--fleet", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["hold", "--fleet", PAIR, "--only", "7"], "vehicle 7 is not in"),
        (["leader", "7", "--fleet", PAIR], "expected some of 1, 2"),
        (["hold", "--fleet", PAIR, "--connect", "nonsense"], '--connect "nonsense": expected PROTOCOL/HOST:PORT'),
        (["hold", "--fleet", PAIR, "--only", "300"], "expected a vehicle's id from 1 to 250"),
        (["hold", "--fleet", PAIR, "--as", "two words"], "expected 1 to 63 letters"),
        (["hold", "--fleet", PAIR, "--wait-s", "nan"], "expected seconds from 0.1 to 60"),
        (["formation", "star", "--spacing", "3", "--fleet", PAIR], "invalid choice: 'star'"),
        (["formation", "line", "--fleet", PAIR], "--spacing"),
        (["formation", "line", "--spacing", "0", "--fleet", PAIR], "expected metres above 0, up to 1000"),
        (["formation", "line", "--spacing", "3", "--heading", "999", "--fleet", PAIR], "expected degrees"),
        (["formation", "line", "--spacing", "3", "--only", "1", "--fleet", PAIR], "--only"),
        (
            ["formation", "line", "--spacing", "3", "--scale", "0", "--fleet", PAIR],
            "expected a factor from 0.01 to 100",
        ),
        (
            ["formation", "line", "--slots", "s.yaml", "--fleet", PAIR],
            "command line: --slots: is a formation of its own",
        ),
        (["formation", "--spacing", "3", "--fleet", PAIR], "command line: --spacing: goes with a SHAPE"),
        (["formation", "--fleet", PAIR], "command line: SHAPE: missing; expected one, --slots FILE"),
        (["formation", "--slots", "nowhere.yaml", "--fleet", PAIR], "nowhere.yaml: cannot be read"),
        (["formation", "--slots", PAIR, "--fleet", PAIR], "this is a fleet file; a file with slots_enu_m is expected"),
        (["reference", "--fleet", PAIR], "command line: KIND: missing; expected one of point, waypoints, circle"),
        (["reference", "spiral", "--fleet", PAIR], "invalid choice: 'spiral'"),
        (["reference", "point", "--fleet", PAIR], "command line: --at: given 0 times; a reference point has one"),
        (
            ["reference", "circle", *AT, *AT, "--fleet", PAIR],
            "command line: --at: given 2 times; a reference circle has one",
        ),
        (["reference", "circle", *AT, "--period", "20", "--fleet", PAIR], "command line: reference.radius_m: missing"),
        (
            ["reference", "point", *AT, "--radius", "2", "--fleet", PAIR],
            "command line: reference.radius_m: unknown key",
        ),
        (
            ["reference", "point", "--at", "0", "0", "nan", "--fleet", PAIR],
            "reference.point_enu_m[2]: nan is not a finite",
        ),
        (["reference", "point", "--at", "0", "0", "--fleet", PAIR], "expected 3 arguments"),
        (
            ["reference", "target", "--name", "A/b", "--fleet", PAIR],
            "command line: reference.name: 'A/b': expected at most 41",
        ),
        (["reference", "point", "--file", "r.yaml", "--fleet", PAIR], "command line: --file: says all by itself"),
        (["reference", "--file", "nowhere.yaml", "--fleet", PAIR], "nowhere.yaml: cannot be read"),
        (["reference", "--file", PAIR, "--fleet", PAIR], "a file with nothing but a reference is expected"),
        (["reference", "point", *AT, "--only", "1", "--fleet", PAIR], "--only"),
        (["hold"], "--fleet"),
        (["dance", "--fleet", PAIR], "invalid choice: 'dance'"),
    ],
)
def test_what_cannot_be_asked_ends_with_2_and_words(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["fleet", *arguments])
    except SystemExit as usage:
        code = int(usage.code or 0)
    assert code == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "reference"),
    [
        (["point", *AT], PointReference((0.0, -5.0, 4.0))),
        (
            ["waypoints", *AT, "--at", "3", "0", "4", "--pause", "2", "--speed", "3", "--acceleration", "0.5"],
            WaypointsReference(((0.0, -5.0, 4.0), (3.0, 0.0, 4.0)), 2.0, 3.0, 0.5),
        ),
        (
            ["circle", *AT, "--radius", "8", "--period", "30", "--ramp", "4", "--clockwise"],
            CircleReference((0.0, -5.0, 4.0), 8.0, 30.0, 4.0, clockwise=True),
        ),
        (
            ["figure_8", *AT, "--width", "20", "--height", "8", "--period", "40"],
            Figure8Reference((0.0, -5.0, 4.0), 20.0, 8.0, 40.0),
        ),
        (
            ["target", "--name", "walker", "--offset", "0", "-2", "6", "--follows-altitude"],
            TargetReference((7.0, 8.0, 9.0), "walker", (0.0, -2.0, 6.0), follows_altitude=True),
        ),
        (["target", *AT], TargetReference((0.0, -5.0, 4.0))),
    ],
)
def test_a_reference_by_the_command_line_is_what_a_file_would_hold(arguments: list[str], reference: Reference) -> None:
    wish = options_of("reference", *arguments, "--fleet", PAIR).reference
    assert wish
    assert wished(wish, here_enu_m=(7.0, 8.0, 9.0)) == reference


def test_a_target_is_waited_for_where_the_fleet_is_or_where_it_is_told() -> None:
    wish = options_of("reference", "target", "--fleet", PAIR).reference
    assert wish
    with pytest.raises(ConfigError, match="--at: missing; nobody is heard to lead"):
        wished(wish, here_enu_m=None)


def test_a_reference_file_holds_a_reference_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "reference.yaml"
    wish = options_of("reference", "--file", str(file), "--fleet", PAIR).reference
    assert wish
    file.write_text("reference: {kind: point, point_enu_m: [1, 2, 3]}\n")
    assert wished(wish, here_enu_m=None) == PointReference((1.0, 2.0, 3.0))
    file.write_text("reference: {kind: point, point_enu_m: [1, 2]}\n")
    with pytest.raises(ConfigError, match=r"reference\.yaml: reference\.point_enu_m: "):
        wished(wish, here_enu_m=None)
    file.write_text("reference: {kind: point, point_enu_m: [1, 2, 3]}\nname: x\n")
    with pytest.raises(ConfigError, match=r"reference\.yaml: name: unknown key"):
        wished(wish, here_enu_m=None)


FLOWN = {1: (1.0, 0.0, 0.5), 2: (-1.0, 0.0, 0.0)}


def slots_by(*arguments: str) -> dict[int, Vector3]:
    wish = options_of("formation", *arguments, "--fleet", PAIR).formation
    assert wish
    check_wish(wish, load_fleet(Path(PAIR)))
    return wished_slots(wish, flying(FlightPhase.FORMATION), load_fleet(Path(PAIR)))


def flying(phase: FlightPhase, **where_enu_m: Vector3) -> list[Status]:
    """Both with FLOWN as their slots, at these places."""
    return [
        replace(status(i), phase=phase, slot=FlownSlot(slot), position_enu_m=where_enu_m.get(f"v{i}", slot))
        for i, slot in FLOWN.items()
    ]


def test_before_a_formation_slots_are_assigned_to_where_the_vehicles_are() -> None:
    crossed = {"v1": (19.0, 5.0, 0.0), "v2": (21.0, 5.0, 0.0)}
    slots = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]
    assert assigned(places_enu_m(flying(FlightPhase.READY, **crossed)), slots) == {1: slots[1], 2: slots[0]}
    assert assigned(places_enu_m(flying(FlightPhase.FORMATION, **crossed)), slots) == {1: slots[0], 2: slots[1]}


def test_places_count_in_the_formation_s_own_frame() -> None:
    turned = [replace(said, heading=Heading(pi / 2.0)) for said in flying(FlightPhase.HOLD, v1=(0.0, 3.0, 1.0))]
    assert places_enu_m(turned)[1] == pytest.approx((3.0, 0.0, 1.0))


def test_slots_flown_are_scaled_and_turned_and_stay_whose_they_are() -> None:
    slots_enu_m = slots_by("--scale", "2", "--heading", "90")
    assert slots_enu_m[1] == pytest.approx((0.0, 2.0, 1.0))
    assert slots_enu_m[2] == pytest.approx((0.0, -2.0, 0.0))


def test_a_shape_is_scaled_by_its_spacing() -> None:
    assert sorted(slots_by("line", "--spacing", "2", "--scale", "1.5").values()) == [(0.0, -1.5, 0.0), (0.0, 1.5, 0.0)]


def test_free_slots_are_as_their_file_says(tmp_path: Path) -> None:
    file = tmp_path / "slots.yaml"
    file.write_text("slots_enu_m: {2: [0, 0, 0], 1: [-3, 1.5, 0]}\n")
    assert slots_by("--slots", str(file)) == {1: (-3.0, 1.5, 0.0), 2: (0.0, 0.0, 0.0)}
    assert slots_by("--slots", str(file), "--scale", "2")[1] == (-6.0, 3.0, 0.0)
    for ids, words in (("1", "slots_enu_m.2: missing"), ("1, 2, 3", "slots_enu_m.3: no such vehicle")):
        file.write_text("slots_enu_m: {" + ", ".join(f"{i}: [{i}, 0, 0]" for i in ids.split(", ")) + "}\n")
        with pytest.raises(ConfigError, match=words):
            slots_by("--slots", str(file))


def test_slots_too_near_are_refused_also_on_the_way() -> None:
    there = {1: (-1.0, 0.0, 0.0), 2: (1.0, 0.0, 0.0)}  # past one another
    refusal = refusal_of(there, FLOWN, separation_m=1.0)
    assert refusal
    assert "the slots of vehicles 1 and 2 come within 0.2" in refusal
    assert refusal_of({i: (2.0 * x, y, z) for i, (x, y, z) in FLOWN.items()}, FLOWN, 1.0) is None
    assert refusal_of({1: ZERO3}, {1: ZERO3}, 1.0) is None


def options_of(*arguments: str) -> FleetOptions:
    parser = argparse.ArgumentParser()
    add_fleet_arguments(parser)
    return fleet_options(parser.parse_args(arguments))


def test_the_operator_has_a_name_that_vehicles_take(monkeypatch: pytest.MonkeyPatch) -> None:
    import re

    from companion.wire.ground import OPERATOR

    assert re.fullmatch(OPERATOR, operator_here())
    assert operator_here() == operator_here()
    monkeypatch.setattr("companion.ground.session.getpass.getuser", lambda: "_häns meier")
    monkeypatch.setattr("companion.ground.session.socket.gethostname", lambda: "h" * 100)
    assert re.fullmatch(OPERATOR, operator_here())

    def nobody() -> str:
        raise KeyError("getpwuid(): uid not found: 1234")

    monkeypatch.setattr("companion.ground.session.getpass.getuser", nobody)
    assert operator_here().startswith("operator@")


def test_every_command_is_a_line_and_a_flood_of_them_a_number(caplog: pytest.LogCaptureFixture) -> None:
    log, command = CommandLog(), Command(CommandName.ARM, 12, "anna@ground", 7)
    with caplog.at_level(logging.INFO):
        for _ in range(COMMANDS_A_SECOND + 30):
            log.answered(command, CommandReply(1, 12, False, "old command"), 100.5)
        log.answered(command, CommandReply(1, 12, True, "arm"), 101.2)
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "command arm, number 12 of anna@ground: refused, old command"
    assert lines[COMMANDS_A_SECOND:] == ["30 more commands", "command arm, number 12 of anna@ground: accepted, arm"]
