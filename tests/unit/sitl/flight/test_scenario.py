"""Scenario files: refusals with their field, and the overrides of --set."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common import ROOT
from companion.config.file import ConfigError, read_yaml
from companion.config.fleet import EdgeNeighbours, RangeNeighbours
from companion.config.named_files import law_override
from companion.tools.subject import load_subject
from companion.types.values import quoted
from sitl.flight.scenario import load_scenario, scenario_from
from tests.helpers.bad_laws import BAD_LAWS, write_law

SCENARIOS = ROOT / "config" / "scenarios"
PLATOON = SCENARIOS / "platoon.yaml"


def error_of(*overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_scenario(PLATOON, overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def error_of_file(change: Any) -> str:
    """`change` damages the platoon's plain content."""
    data = read_yaml(PLATOON)
    change(data)
    with pytest.raises(ConfigError) as caught:
        scenario_from(Path("s.yaml"), data)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_scenario_loads(path: Path) -> None:
    assert load_scenario(path).description


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_scenario_file_written_by_a_flight_loads(path: Path, tmp_path: Path) -> None:
    scenario = load_scenario(path, ["stand_in.seed=7"])
    again = tmp_path / "scenario.yaml"
    again.write_text(yaml.safe_dump(msgspec.to_builtins(scenario, builtin_types=()), sort_keys=False), encoding="utf-8")
    assert load_scenario(again) == scenario


# ---------------------------------------------------------------- another law


@pytest.mark.parametrize("read", [load_scenario, load_subject])
@pytest.mark.parametrize("name", list(BAD_LAWS))
def test_an_error_of_a_law_file_names_its_option_and_the_path_as_given(
    name: str, read: Callable[..., object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_law(tmp_path, name, BAD_LAWS[name])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        read(PLATOON, [law_override(file.name), "fleet.takeoff_height_m=2.5"])
    (line,) = caught.value.lines
    assert line.startswith(f"--law: {file.name}: ")


def test_an_error_beside_a_good_law_names_set() -> None:
    line = error_of(law_override("average_22"), "fleet.law.parameters.exponent=1")
    assert (
        line
        == "--set: fleet.law.parameters.exponent: unknown key; expected one of position_gain_1_s2, velocity_gain_1_s"
    )


def test_a_fleet_file_takes_a_law() -> None:
    assert load_subject(ROOT / "config" / "fleets" / "pair.yaml", [law_override("trimmed")]).fleet.law.name == "trimmed"


# ---------------------------------------------------------------- files


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^nowhere\.yaml: cannot be read: No such file"):
        load_scenario(Path("nowhere.yaml"))


def test_a_wrong_type_is_refused() -> None:
    message = error_of_file(lambda d: d["fleet"].update(takeoff_height_m="high"))
    assert message == "s.yaml: fleet.takeoff_height_m: 'high': expected a number"


def test_an_unknown_key_names_the_nearest_one() -> None:
    message = error_of_file(lambda d: d["fleet"]["law"].update(exponnent=2))
    assert message == "s.yaml: fleet.law.exponnent: unknown key; take it out"


def test_an_unknown_key_of_a_step_names_the_nearest_one() -> None:
    message = error_of_file(lambda d: d["timeline"][3].update(fors=2))
    assert message == 's.yaml: timeline[3].fors: unknown key; did you mean "for_s"?'


def test_a_gain_out_of_bounds_is_refused() -> None:
    message = error_of_file(lambda d: d["fleet"]["law"].update(parameters={"position_gain_1_s2": -1.0}))
    assert message == "s.yaml: fleet.law.parameters.position_gain_1_s2: -1.0: expected a number > 0.0"


RING = SCENARIOS / "ring_figure_8.yaml"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "timeline[4].leaders=[3]",
            "timeline[4].leaders: [3]: vehicle 3 may not lead; expected some of 1, 2, or may_lead: true",
        ),
        ("timeline[4].leaders=[9]", "timeline[4].leaders: [9]: vehicle 9 may not lead; expected some of 1, 2"),
        ("timeline[4].leaders=[]", "timeline[4].leaders: missing; lead needs the ids of the new leaders, some of 1, 2"),
        ("timeline[3].leaders=[1]", "timeline[3].leaders: [1]: form takes no leaders; take it out"),
        ("reference.period_s=5", "reference.period_s: 5 s with ramp_s 8 asks for"),
        ("reference.width_m=0", "reference.width_m: 0: expected a number >= 0.01"),
        ("reference.hight_m=3", 'reference.hight_m: unknown key; did you mean "height_m"?'),
        ("reference.kind=ring", "reference.kind"),
        (
            "timeline[3].reference={kind: point, point_enu_m: [0, 0, 2]}",
            "timeline[3].reference: goes with command: reference",
        ),
        ("timeline[4]={command: reference}", "timeline[4].reference: goes with command: reference, and with no other"),
        (
            "timeline[4]={command: reference, reference: {kind: waypoints, points_enu_m: [[0, 0, 2], [0, 101, 2]]}}",
            "timeline[4].reference.points_enu_m: puts vehicle 1 at y = 102 m, outside the fence",
        ),
        (
            "timeline[4]={command: reference, reference: {kind: waypoints, points_enu_m: []}}",
            "timeline[4].reference.points_enu_m",
        ),
        (
            "targets=[{name: a/b, path: {kind: point, point_enu_m: [0, 0, 0]}}]",
            "targets[0].name: 'a/b': expected at most 41",
        ),
        (
            "targets=[{path: {kind: target, start_enu_m: [0, 0, 0]}}]",
            "targets[0].path.kind: 'target': expected one of circle",
        ),
        (
            "targets=[{path: {kind: point, point_enu_m: [0, 0, 0]}}, {path: {kind: point, point_enu_m: [0, 0, 0]}}]",
            'targets[1].name: "main" is used twice',
        ),
    ],
)
def test_a_reference_or_leader_change_that_cannot_be_flown_is_refused(override: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(RING, [override])
    line = str(caught.value)
    assert line.startswith("--set: ")
    assert words in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ("[{vehicle: 9, at_s: 5}]", "agent_ends[0].vehicle: no vehicle 9 in the fleet"),
        ("[{vehicle: 1, at_s: 5, restarts_after_s: 0}]", "agent_ends[0].restarts_after_s: 0"),
        ("[{vehicle: 1, at_s: 5}, {vehicle: 1, at_s: 8}]", "agent_ends[1].at_s: the agent of vehicle 1 ended at 5 s"),
        (
            "[{vehicle: 1, at_s: 8}, {vehicle: 1, at_s: 5, restarts_after_s: 3}]",
            "agent_ends[0].at_s: the agent of vehicle 1 ended at 5 s and starts again at 8 s",
        ),
    ],
)
def test_an_agent_that_does_not_run_cannot_end(ends: str, words: str) -> None:
    assert words in error_of(f"agent_ends={ends}")


def test_an_agent_may_end_again_after_it_started_again() -> None:
    ends = "{vehicle: 1, at_s: 8}, {vehicle: 2, at_s: 6}, {vehicle: 1, at_s: 5, restarts_after_s: 2}"
    assert len(load_scenario(PLATOON, [f"agent_ends=[{ends}]"]).agent_ends) == 3


def test_an_id_that_is_used_twice_is_refused() -> None:
    message = error_of_file(lambda d: d["fleet"]["vehicles"][2].update(id=2))
    assert message.startswith("s.yaml: fleet.vehicles[2].id: 2 is used twice")


def test_an_edge_to_an_unknown_vehicle_is_refused() -> None:
    message = error_of_file(lambda d: d["fleet"]["neighbours"]["edges"].append([4, 9]))
    assert message.startswith("s.yaml: fleet.neighbours.edges[3]: [4, 9] names vehicle 9, which is not in the fleet")


def test_a_vehicle_without_a_slot_is_refused() -> None:
    message = error_of_file(lambda d: d["fleet"]["vehicles"][1].pop("slot_enu_m"))
    assert message == "s.yaml: fleet.vehicles[1].slot_enu_m: missing; this key is required"


def test_a_fleet_without_a_leader_is_refused() -> None:
    message = error_of_file(lambda d: d["fleet"]["vehicles"][0].update(role="follower"))
    assert message.startswith("s.yaml: fleet.vehicles: no vehicle leads; set role: leader")


def test_a_vehicle_without_a_start_is_refused() -> None:
    message = error_of_file(lambda d: d["starts_enu_m"].pop(3))
    assert message == "s.yaml: starts_enu_m.3: missing; every vehicle needs a position to start from"


def test_starts_that_are_too_close_are_refused() -> None:
    message = error_of("starts_enu_m.3=[-1.5, 0.2, 0.0]", "starts_enu_m.2=[-1.5, 0.0, 0.0]")
    assert message == (
        "--set: starts_enu_m.3: [-1.5, 0.2, 0.0] is 0.20 m from the start of vehicle 2; expected at least 0.3 m"
    )


def test_a_fleet_file_is_refused_as_a_scenario() -> None:
    fleet = SCENARIOS.parent / "fleets" / "pair.yaml"
    with pytest.raises(
        ConfigError, match=r"pair\.yaml: this is a fleet file; a scenario is expected: this file under `fleet`"
    ):
        load_scenario(fleet)


def test_a_start_of_an_unknown_vehicle_is_refused() -> None:
    message = error_of_file(lambda d: d["starts_enu_m"].update({7: [0, 0, 0]}))
    assert message == "s.yaml: starts_enu_m.7: no such vehicle in the fleet; expected 1, 2, 3, 4"


def test_an_unknown_command_names_the_known_ones() -> None:
    message = error_of_file(lambda d: d["timeline"][2].update(command="take_off"))
    assert message.startswith("s.yaml: timeline[2].command: 'take_off': expected one of abort, arm, disarm, form")
    assert 'did you mean "takeoff"?' in message


def test_an_unknown_parameter_an_empty_timeline_and_an_indoor_origin_are_refused() -> None:
    parameters = error_of_file(lambda d: d["stand_in"].update(parameters={"COM_OF_LOS_T": 1.0}))
    assert "stand_in.parameters.COM_OF_LOS_T" in parameters
    assert "COM_OF_LOSS_T" in parameters
    assert "timeline: is empty" in error_of_file(lambda d: d.update(timeline=[]))
    assert "fleet.origin" in error_of_file(lambda d: d["fleet"].update(origin="indoor"))


# ---------------------------------------------------------------- --set


def test_overrides_are_yaml_values_at_their_keys() -> None:
    scenario = load_scenario(
        PLATOON,
        [
            "stand_in.sensors=default",
            "stand_in.airframe.attitude=instant",
            "stand_in.wind.mean_enu_m_s=[1.0, 0, 0]",
            "fleet.law.name=average_26",
            "timeline[3].for_s=20",
            "starts_enu_m.2=[-2.0, 0, 0]",
            "stand_in.parameters.COM_OF_LOSS_T=0.5",
        ],
    )
    assert scenario.stand_in.sensors == "default"
    assert scenario.stand_in.airframe.attitude == "instant"
    assert scenario.stand_in.airframe.drag_n_per_m_s == 0.0  # the keys beside it stay
    assert scenario.stand_in.wind.mean_enu_m_s == (1.0, 0.0, 0.0)
    assert scenario.fleet.law.name == "average_26"
    assert scenario.timeline[3].for_s == 20.0
    assert scenario.starts_enu_m[2] == (-2.0, 0.0, 0.0)
    assert scenario.stand_in.parameters == {"COM_OF_LOSS_T": 0.5}


def test_a_reference_of_a_fleet_whose_turning_slots_need_all_tilt_is_refused_in_words() -> None:
    circle = "{kind: circle, centre_enu_m: [0, 0, 3], radius_m: 10, clockwise: false, period_s: 600, ramp_s: 60}"
    text = error_of("fleet.formation_heading=course", "fleet.envelope.max_tilt_deg=5", f"reference={circle}")
    assert "fleet.envelope.max_tilt_deg: 5 is no more than what slots need that turn" in text


def test_a_later_override_wins_and_whole_sections_can_be_set() -> None:
    overrides = ["fleet.neighbours={kind: range, range_m: 3}", "fleet.neighbours.range_m=4"]
    assert load_scenario(PLATOON, overrides).fleet.neighbours == RangeNeighbours(range_m=4.0)
    assert isinstance(load_scenario(PLATOON).fleet.neighbours, EdgeNeighbours)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("fleet.law.nam=weighted", '--set: fleet.law.nam: unknown key; did you mean "name"?'),
        ("fleet.lwa.name=weighted", '--set: fleet.lwa: unknown key; did you mean "law"?'),
        ("stand_in.sensors.x=1", "--set: stand_in.sensors: is 'ideal', which has no keys inside; set it as a whole"),
        ("timeline[9].for_s=1", "--set: timeline[9]: no such item; expected timeline[0] to [4]"),
        ("timeline.form=1", "--set: timeline.form: timeline is a list; expected a number, timeline[0] to [4]"),
        ("timeline[3].for_s=long", "--set: timeline[3].for_s: 'long': expected a number"),
        (
            "origins_enu_m={9: [0, 0, 0]}",
            "--set: origins_enu_m.9: no vehicle 9 in the fleet; expected one of 1, 2, 3, 4",
        ),
        (
            "stand_in.estimator_resets=[{vehicle: 9, at_s: 1, shift_enu_m: [0, 0, 0]}]",
            "--set: stand_in.estimator_resets[0].vehicle: no vehicle 9 in the fleet; expected one of 1, 2, 3, 4",
        ),
        (
            "links.partitions=[{vehicles: [9], from_s: 1, until_s: 2}]",
            "--set: links.partitions[0].vehicles: no vehicle 9 in the fleet; expected one of 1, 2, 3, 4",
        ),
        (
            "stand_in.batteries=[{vehicle: 9, at_s: 1, percent: 9}]",
            "--set: stand_in.batteries[0].vehicle: no vehicle 9 in the fleet; expected one of 1, 2, 3, 4",
        ),
        ("fleet.takeoff_height_m=[", "--set: fleet.takeoff_height_m: '[' is not a YAML value"),
        (
            "fleet.law.parameters.velocity_gain_1_s=11",
            "--set: fleet.law.parameters.velocity_gain_1_s: 11: expected a number <= 10.0",
        ),
        (
            "fleet..law=1",
            "--set: fleet..law=1: expected KEY=VALUE, like fleet.law.name=average_22 or timeline[3].for_s=20",
        ),
    ],
)
def test_a_wrong_override_is_refused_in_one_line(override: str, message: str) -> None:
    assert error_of(override) == message


def test_an_override_without_a_value_is_refused() -> None:
    assert error_of("fleet.law.name").startswith("--set: fleet.law.name: expected KEY=VALUE")


def test_an_override_is_checked_like_the_file() -> None:
    for value in ("2024-13-45", "!!float foo", "&a [*a]", "[" * 3000, "9" * 5000, "{[1, 2], [2, 3]}"):
        assert error_of(f"fleet.name={value}") == f"--set: fleet.name: {quoted(value)} is not a YAML value"
    assert "expected KEY=VALUE" in error_of(f"timeline[{'9' * 5000}].for_s=1")
    assert error_of("fleet.vehicles[1].id=1").startswith("--set: fleet.vehicles[1].id: 1 is used twice")


@given(st.text(max_size=40))
def test_any_override_loads_or_is_refused(text: str) -> None:
    try:
        load_scenario(PLATOON, [text])
    except ConfigError as error:
        assert all(line.startswith("--set: ") for line in error.lines)


def with_steps(*steps: dict[str, object]) -> Any:
    return lambda data: data.update(timeline=list(steps))


def test_a_step_can_have_vehicles_and_a_time() -> None:
    scenario = load_scenario(PLATOON, ["timeline[1].vehicles=[2,3]", "timeline[1].at_s=4"])
    assert scenario.timeline[1].vehicles == (2, 3)
    assert scenario.timeline[1].in_words() == "arm 2 3"


@pytest.mark.parametrize(
    ("step", "error"),
    [
        ({"command": "land", "vehicles": [9]}, "vehicles: no vehicle 9 in the fleet; expected some of 1, 2, 3, 4"),
        ({"command": "lead", "leaders": [1], "vehicles": [2]}, "vehicles: lead is for the whole fleet; take it out"),
        ({"command": "land", "at_s": 1.0}, "at_s: 1: expected at least 2, when a step before begins"),
    ],
)
def test_a_step_that_contradicts_itself_is_refused(step: dict[str, object], error: str) -> None:
    assert error_of_file(with_steps({"command": "prepare", "at_s": 2.0}, step)) == f"s.yaml: timeline[1].{error}"
