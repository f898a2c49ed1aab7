"""The command line of `companion fleet`. Whole missions are flown in tests/fleet."""

import argparse
from math import pi
from pathlib import Path

import pytest

from common import ROOT, with_fields
from companion.cli.fleet import FLEET, fleet_request
from companion.cli.main import main
from companion.config.file import ConfigError
from companion.config.fleet_check import load_fleet
from companion.config.reference import (
    CircleReference,
    Figure8Reference,
    PointReference,
    Reference,
    TargetReference,
    WaypointsReference,
)
from companion.ground.changes import (
    FleetAction,
    FormationRequest,
    assign_slots,
    change_to,
    check_request,
    named_slots,
    positions_enu_m,
    refusal_of,
    resolve_reference,
    resolve_slots,
)
from companion.ground.session import operator_here
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, Heading
from companion.types.status import Status
from companion.types.values import ZERO3, Vector3
from ground_fleet import directed_status

PAIR = str(ROOT / "config" / "fleets" / "pair.yaml")
AT = ["--at", "0", "-5", "4"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["hold", "--fleet", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["hold", "--fleet", PAIR, "--only", "7"], "vehicle 7 is not in"),
        (["leader", "7", "--fleet", PAIR], "expected some of 1, 2"),
        (["hold", "--fleet", PAIR, "--connect", "nonsense"], '--connect "nonsense": expected PROTOCOL/HOST:PORT'),
        (["hold", "--fleet", PAIR, "--only", "300"], "expected a vehicle id from 1 to 250"),
        (["hold", "--fleet", PAIR, "--as", "two words"], "expected 1 to 63 letters"),
        (["hold", "--fleet", PAIR, "--wait-s", "nan"], "expected seconds from 0.1 to 60"),
        (["formation", "star", "--spacing", "3", "--fleet", PAIR], "invalid choice: 'star'"),
        (["formation", "v", "--fleet", PAIR], "companion fleet formation: --spacing: missing; v needs it"),
        (["formation", "line", "--spacing", "0", "--fleet", PAIR], "expected metres above 0, up to 1000"),
        (["formation", "line", "--spacing", "3", "--heading", "999", "--fleet", PAIR], "expected degrees"),
        (["formation", "line", "--spacing", "3", "--only", "1", "--fleet", PAIR], "--only"),
        (
            ["formation", "line", "--spacing", "3", "--scale", "0", "--fleet", PAIR],
            "expected a factor from 0.01 to 100",
        ),
        (
            ["formation", "line", "--slots", "s.yaml", "--fleet", PAIR],
            "companion fleet formation: --slots: is a whole formation",
        ),
        (["formation", "--spacing", "3", "--fleet", PAIR], "companion fleet formation: --spacing: belongs to a SHAPE"),
        (["formation", "--fleet", PAIR], "companion fleet formation: SHAPE: missing; expected one, --slots FILE"),
        (["formation", "--slots", "nowhere.yaml", "--fleet", PAIR], "nowhere.yaml: cannot be read"),
        (["formation", "--slots", PAIR, "--fleet", PAIR], "this is a fleet file; a file with slots_enu_m is expected"),
        (
            ["reference", "--fleet", PAIR],
            "companion fleet reference: KIND: missing; expected one of point, circle, figure_8",
        ),
        (["reference", "spiral", "--fleet", PAIR], "invalid choice: 'spiral'"),
        (
            ["reference", "point", "--fleet", PAIR],
            "companion fleet reference: --at: given 0 times; a reference point has one",
        ),
        (
            ["reference", "circle", *AT, *AT, "--fleet", PAIR],
            "companion fleet reference: --at: given 2 times; a reference circle has one",
        ),
        (
            ["reference", "circle", *AT, "--period", "20", "--fleet", PAIR],
            "companion fleet reference: reference.radius_m: missing",
        ),
        (
            ["reference", "point", *AT, "--radius", "2", "--fleet", PAIR],
            "companion fleet reference: reference.radius_m: unknown key",
        ),
        (
            ["reference", "point", "--at", "0", "0", "nan", "--fleet", PAIR],
            "reference.point_enu_m[2]: nan is not a finite",
        ),
        (["reference", "point", "--at", "0", "0", "--fleet", PAIR], "expected 3 arguments"),
        (
            ["reference", "target", "--name", "A/b", "--fleet", PAIR],
            "companion fleet reference: reference.name: 'A/b': expected at most 41",
        ),
        (
            ["reference", "point", "--file", "r.yaml", "--fleet", PAIR],
            "companion fleet reference: --file: describes the whole reference",
        ),
        (["reference", "--file", "nowhere.yaml", "--fleet", PAIR], "nowhere.yaml: cannot be read"),
        (["reference", "--file", PAIR, "--fleet", PAIR], "a file with nothing but a reference is expected"),
        (["reference", "point", *AT, "--only", "1", "--fleet", PAIR], "--only"),
        (["hold"], "--fleet"),
        (["dance", "--fleet", PAIR], "invalid choice: 'dance'"),
    ],
)
def test_a_request_that_cannot_be_used_ends_with_2_and_a_reason(
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
            WaypointsReference(((0.0, -5.0, 4.0), (3.0, 0.0, 4.0)), 2.0, 3.0, max_acceleration_m_s2=0.5),
        ),
        (
            ["circle", *AT, "--radius", "8", "--period", "30", "--ramp", "4", "--clockwise"],
            CircleReference((0.0, -5.0, 4.0), 8.0, period_s=30.0, ramp_s=4.0, clockwise=True),
        ),
        (
            ["figure_8", *AT, "--width", "20", "--height", "8", "--period", "40"],
            Figure8Reference((0.0, -5.0, 4.0), 20.0, 8.0, period_s=40.0),
        ),
        (
            ["target", "--name", "walker", "--offset", "0", "-2", "6", "--follows-altitude"],
            TargetReference((7.0, 8.0, 9.0), "walker", (0.0, -2.0, 6.0), follows_altitude=True),
        ),
        (["target", *AT], TargetReference((0.0, -5.0, 4.0))),
    ],
)
def test_a_reference_from_options_equals_that_of_a_file(arguments: list[str], reference: Reference) -> None:
    request = request_of("reference", *arguments, "--fleet", PAIR).reference
    assert request
    assert resolve_reference(request, here_enu_m=(7.0, 8.0, 9.0)) == reference


def test_a_target_needs_a_position_where_no_leader_reports() -> None:
    request = request_of("reference", "target", "--fleet", PAIR).reference
    assert request
    with pytest.raises(ConfigError, match="--at: missing; no leader reports a reference"):
        resolve_reference(request, here_enu_m=None)


def test_a_reference_file_holds_only_a_reference(tmp_path: Path) -> None:
    file = tmp_path / "reference.yaml"
    request = request_of("reference", "--file", str(file), "--fleet", PAIR).reference
    assert request
    file.write_text("reference: {kind: point, point_enu_m: [1, 2, 3]}\n")
    assert resolve_reference(request, here_enu_m=None) == PointReference((1.0, 2.0, 3.0))
    file.write_text("reference: {kind: point, point_enu_m: [1, 2]}\n")
    with pytest.raises(ConfigError, match=r"reference\.yaml: reference\.point_enu_m: "):
        resolve_reference(request, here_enu_m=None)
    file.write_text("reference: {kind: point, point_enu_m: [1, 2, 3]}\nname: x\n")
    with pytest.raises(ConfigError, match=r"reference\.yaml: name: unknown key"):
        resolve_reference(request, here_enu_m=None)


FLOWN = {1: (1.0, 0.0, 0.5), 2: (-1.0, 0.0, 0.0)}


def slots_by(*arguments: str) -> dict[int, Vector3]:
    request = request_of("formation", *arguments, "--fleet", PAIR).formation
    assert request
    check_request(request, load_fleet(Path(PAIR)))
    return resolve_slots(request, flying(FlightPhase.FORMATION), load_fleet(Path(PAIR)))


def flying(phase: FlightPhase, **where_enu_m: Vector3) -> list[Status]:
    """Both with FLOWN as their slots, at these positions."""
    return [
        with_fields(
            directed_status(i), phase=phase, slot=FlownSlot(slot), position_enu_m=where_enu_m.get(f"v{i}", slot)
        )
        for i, slot in FLOWN.items()
    ]


def test_slots_are_assigned_by_position_before_a_formation() -> None:
    crossed = {"v1": (19.0, 5.0, 0.0), "v2": (21.0, 5.0, 0.0)}
    slots = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]
    assert assign_slots(positions_enu_m(flying(FlightPhase.READY, **crossed)), slots) == {1: slots[1], 2: slots[0]}
    assert assign_slots(positions_enu_m(flying(FlightPhase.FORMATION, **crossed)), slots) == {1: slots[0], 2: slots[1]}


def test_positions_are_in_the_frame_of_the_formation() -> None:
    turned = [with_fields(said, heading=Heading(pi / 2.0)) for said in flying(FlightPhase.HOLD, v1=(0.0, 3.0, 1.0))]
    assert positions_enu_m(turned)[1] == pytest.approx((3.0, 0.0, 1.0))


def test_flown_slots_are_scaled_and_rotated_and_keep_their_vehicles() -> None:
    slots_enu_m = slots_by("--scale", "2", "--heading", "90")
    assert slots_enu_m[1] == pytest.approx((0.0, 2.0, 1.0))
    assert slots_enu_m[2] == pytest.approx((0.0, -2.0, 0.0))


def test_a_shape_is_scaled_by_its_spacing() -> None:
    assert sorted(slots_by("line", "--spacing", "2", "--scale", "1.5").values()) == [(0.0, -1.5, 0.0), (0.0, 1.5, 0.0)]


def test_slots_from_a_file_are_used_as_given(tmp_path: Path) -> None:
    file = tmp_path / "slots.yaml"
    file.write_text("slots_enu_m: {2: [0, 0, 0], 1: [-3, 1.5, 0]}\n")
    assert slots_by("--slots", str(file)) == {1: (-3.0, 1.5, 0.0), 2: (0.0, 0.0, 0.0)}
    assert slots_by("--slots", str(file), "--scale", "2")[1] == (-6.0, 3.0, 0.0)
    for ids, words in (("1", "slots_enu_m.2: missing"), ("1, 2, 3", "slots_enu_m.3: no such vehicle")):
        file.write_text("slots_enu_m: {" + ", ".join(f"{i}: [{i}, 0, 0]" for i in ids.split(", ")) + "}\n")
        with pytest.raises(ConfigError, match=words):
            slots_by("--slots", str(file))


def test_slots_too_close_are_refused() -> None:
    there = {1: (-0.4, 0.0, 0.0), 2: (0.4, 0.0, 0.0)}
    refusal = refusal_of(there, separation_m=1.0, has_height=True)
    assert refusal
    assert "the slots of vehicles 1 and 2 come within 0.80 m" in refusal
    assert refusal_of({i: (2.0 * x, y, z) for i, (x, y, z) in there.items()}, 1.0, True) is None
    above = {
        i: (x, y, 5.0 * i) for i, (x, y, _) in there.items()
    }  # with altitudes that are held the height does not count
    assert refusal_of(above, 2.5, has_height=True) is None
    assert refusal_of(above, 2.5, has_height=False)
    assert refusal_of({1: ZERO3}, 1.0, True) is None


def request_of(*arguments: str) -> FleetAction:
    parser = argparse.ArgumentParser()
    FLEET.add_arguments(parser)
    return fleet_request(parser.parse_args(arguments)).action


def test_the_default_operator_has_a_valid_name(monkeypatch: pytest.MonkeyPatch) -> None:
    import re

    from companion.types.commands import OPERATOR

    assert re.fullmatch(OPERATOR, operator_here())
    assert operator_here() == operator_here()
    monkeypatch.setattr("companion.ground.session.getpass.getuser", lambda: "_häns meier")
    monkeypatch.setattr("companion.ground.session.socket.gethostname", lambda: "h" * 100)
    assert re.fullmatch(OPERATOR, operator_here())

    def no_such_user() -> str:
        raise KeyError("getpwuid(): uid not found: 1234")

    monkeypatch.setattr("companion.ground.session.getpass.getuser", no_such_user)
    assert operator_here().startswith("operator@")


def test_the_rest_of_a_fleet_gets_a_formation_with_a_slot_for_the_vehicle_that_does_not_report() -> None:
    fleet = load_fleet(Path(PAIR))
    only_1 = [status for status in flying(FlightPhase.FORMATION) if status.agent.vehicle_id == 1]
    slots_enu_m = resolve_slots(FormationRequest("line", None, 4.0, 0.0, 1.0), only_1, fleet)
    assert set(slots_enu_m) == {1, 2}
    assert sorted(slots_enu_m.values()) == sorted(named_slots("line", 2, 4.0, 0.0))
    change = change_to(slots_enu_m, only_1, fleet.slot_speed_m_s)
    assert change.absent == (2,)
    assert change_to(slots_enu_m, flying(FlightPhase.FORMATION), fleet.slot_speed_m_s).absent == ()


def test_of_a_vehicle_that_does_not_report_the_slot_in_the_fleet_file_counts() -> None:
    fleet = load_fleet(Path(PAIR))
    only_1 = [status for status in flying(FlightPhase.FORMATION) if status.agent.vehicle_id == 1]
    slots_enu_m = resolve_slots(FormationRequest(None, None, None, 0.0, 2.0), only_1, fleet)
    of_2 = next(member.slot_enu_m for member in fleet.vehicles if member.id == 2)
    assert slots_enu_m == {
        1: tuple(2.0 * x for x in FLOWN[1]),
        2: tuple(2.0 * x for x in of_2),
    }
