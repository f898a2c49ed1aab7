"""Mixed fleets: `stand_in.vehicles` of a scenario, and all that it reaches."""

import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common import ROOT
from companion.config.file import ConfigError, read_yaml
from companion.config.named_files import carried
from companion.config.values import overlaid
from companion.tools.analysis import analyse
from companion.tools.analysis_report import report
from companion.tools.subject import load_subject
from companion.types.autopilot import AutopilotKind
from sitl.batch.columns import columns_of
from sitl.compare.options import CompareOptions
from sitl.compare.plan import plan_of
from sitl.flight.files import autopilot_file, autopilots_of, reached_stand_in, vehicle_file
from sitl.flight.flights import DivergesError, check_convergence, kinds_of
from sitl.flight.scenario import Scenario, load_scenario, scenario_from
from sitl.links.free_ports import PortInUseError, reserved_ports
from sitl.links.ports import ports_of
from sitl.vehicle.config import Airframe, StandIn

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
MIXED = ROOT / "config" / "scenarios" / "mixed_platoon.yaml"
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


def with_vehicles(vehicles: object, **common: object) -> Scenario:
    """The platoon with these keys of single vehicles, and of all."""
    data = read_yaml(PLATOON)
    data["stand_in"] |= {"vehicles": vehicles} | common
    return scenario_from(Path("s.yaml"), data)


def error_of(vehicles: object, **common: object) -> str:
    with pytest.raises(ConfigError) as caught:
        with_vehicles(vehicles, **common)
    (line,) = caught.value.lines
    return line


# ---------------------------------------------------------------- the keys of one vehicle


@pytest.mark.parametrize(
    ("vehicles", "expected"),
    [
        ({3: {"airframe": {"mass_kg": "heavy"}}}, "3.airframe.mass_kg: 'heavy': expected a number"),
        ({3: {"airframe": {"mass_kg": -1.0}}}, "3.airframe.mass_kg: -1.0: expected a number > 0.0"),
        ({3: {"airframe": {"mas_kg": 2.1}}}, '3.airframe.mas_kg: unknown key; did you mean "mass_kg"?'),
        ({3: {"airframe": None}}, "3.airframe: empty: expected a section with keys"),
        ({3: {"autopilot": "arducopter"}}, "3.autopilot: 'arducopter': expected one of ardupilot, px4"),
        ({3: {"sensors": "bad"}}, "3.sensors: 'bad': expected one of ardupilot_sitl, default, ideal, px4_sih"),
        ({3: {"seed": 2}}, "3.seed: unknown key; take it out"),
        ({3: {"vehicles": {}}}, "3.vehicles: unknown key; take it out"),
        (
            {3: {"parameters": {"GUID_OPTIONS": 0}}},
            "3.parameters.GUID_OPTIONS: the stand-in (px4) has no such parameter",
        ),
        ({5: {}}, "5: no vehicle 5 in the fleet; expected one of 1, 2, 3, 4"),
        ({0: {}}, "0: the key 0: expected a whole number >= 1"),
        ({"3": {}}, "3: the key '3': expected a whole number; a number has no quotes"),
        ({3: None}, "3: empty: expected a section with keys"),
        ({3: {1: 2}}, "3.1: the key 1: expected text; put it in quotes"),
    ],
)
def test_what_is_wrong_is_named(vehicles: object, expected: str) -> None:
    assert error_of(vehicles).startswith(f"s.yaml: stand_in.vehicles.{expected}")


def test_the_whole_must_be_a_mapping() -> None:
    assert error_of(None) == "s.yaml: stand_in.vehicles: empty: expected a section with keys"
    assert error_of([3]) == "s.yaml: stand_in.vehicles: expected a section with keys, got a list"


def test_all_errors_are_found_beside_one_of_the_whole_fleet() -> None:
    with pytest.raises(ConfigError) as caught:
        with_vehicles({3: {"airframe": {"mass_kg": 0}}, 4: {"sensor": "ideal"}}, autopilot="none")
    assert {line.split(": ")[1] for line in caught.value.lines} == {
        "stand_in.autopilot",
        "stand_in.vehicles.3.airframe.mass_kg",
        "stand_in.vehicles.4.sensor",
    }


@pytest.mark.parametrize("vehicles", [{}, {3: {}}])
def test_nothing_of_its_own_is_what_all_have(vehicles: dict[int, Any]) -> None:
    scenario, alike = with_vehicles(vehicles), load_scenario(PLATOON)
    for vehicle_id in (1, 3):
        assert scenario.stand_in_of(vehicle_id) == alike.stand_in_of(vehicle_id)
        assert autopilot_file(scenario, vehicle_id) == autopilot_file(alike, vehicle_id)


def test_set_reaches_single_keys() -> None:
    scenario = load_scenario(
        PLATOON, ["stand_in.vehicles.3.autopilot=ardupilot", "stand_in.vehicles.3.airframe.mass_kg=2"]
    )
    own = scenario.stand_in_of(3)
    assert (own.autopilot, own.airframe) == (ARDUPILOT, Airframe(mass_kg=2.0, drag_n_per_m_s=0.0))
    assert scenario.stand_in_of(2) == load_scenario(PLATOON).stand_in_of(2)
    with pytest.raises(ConfigError, match=r"^--set: stand_in\.vehicles\.9: no vehicle 9 in the fleet; .* 1, 2, 3, 4$"):
        load_scenario(PLATOON, ["stand_in.vehicles.9.autopilot=px4"])


AIRFRAMES = st.fixed_dictionaries(
    {},
    optional={
        "mass_kg": st.floats(0.1, 100.0),
        "hover_thrust_norm": st.none() | st.floats(0.1, 0.9),
        "motor_lag_s": st.floats(0.0, 1.0),
    },
)
SENSORS = st.sampled_from(["ideal", "px4_sih"]) | st.fixed_dictionaries(
    {}, optional={"attitude_sd_deg": st.floats(0.0, 1.0), "velocity_sd_m_s": st.floats(0.0, 1.0)}
)
OWN = st.fixed_dictionaries(
    {},
    optional={
        "armable_after_s": st.none() | st.floats(0.0, 600.0),
        "airframe": AIRFRAMES,
        "sensors": SENSORS,
        "clock_slow_percent": st.floats(-5.0, 5.0),
        "parameters": st.dictionaries(st.sampled_from(["COM_OF_LOSS_T", "COM_OBL_RC_ACT"]), st.floats(0.0, 1.0)),
    },
)


def leaves(section: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Every value that is no section, by its path."""
    found: dict[str, Any] = {}
    for key, value in section.items():
        found |= leaves(value, f"{where}{key}.") if isinstance(value, Mapping) else {f"{where}{key}": value}
    return found


@given(common=OWN, own=OWN)
def test_own_keys_replace_the_common_ones_one_by_one(common: dict[str, Any], own: dict[str, Any]) -> None:
    merged, expected = leaves(overlaid(common, own)), leaves(own)
    assert {key: merged[key] for key in expected} == expected
    others = {key: value for key, value in leaves(common).items() if key not in expected}
    if isinstance(own.get("sensors"), str) or isinstance(common.get("sensors"), str):  # replaced as a whole
        others = {key: value for key, value in others.items() if not key.startswith("sensors") or "sensors" not in own}
    assert merged == others | expected
    scenario = with_vehicles({3: own}, **common)
    assert scenario.stand_in_of(3) == msgspec.convert(
        overlaid({"airframe": {"drag_n_per_m_s": 0.0}, "sensors": "ideal"}, overlaid(common, own))
        if "airframe" not in common
        else overlaid({"sensors": "ideal"}, overlaid(common, own)),
        StandIn,
    )


def test_parameters_of_all_are_not_for_another_autopilot() -> None:
    scenario = with_vehicles(
        {3: {"autopilot": "ardupilot"}, 4: {"parameters": {"COM_OBL_RC_ACT": 3}}}, parameters={"COM_OF_LOSS_T": 0.5}
    )
    assert scenario.stand_in_of(3).parameters == {}
    assert scenario.stand_in_of(4).parameters == {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 3.0}


def test_the_file_of_a_flight_has_what_single_vehicles_have(tmp_path: Path) -> None:
    scenario, again = load_scenario(MIXED), tmp_path / "scenario.yaml"
    again.write_text(yaml.safe_dump(carried(msgspec.to_builtins(scenario), tmp_path)), encoding="utf-8")
    assert load_scenario(again) == scenario
    assert load_scenario(again, ["stand_in.sensors=px4_sih"]).stand_in_of(3).sensors == "px4_sih"


# ---------------------------------------------------------------- what it reaches


def test_agents_and_stand_ins_get_their_own() -> None:
    scenario = load_scenario(MIXED)
    assert autopilots_of(scenario) == {1: PX4, 2: PX4, 3: ARDUPILOT, 4: ARDUPILOT}
    agents = {i: vehicle_file(scenario, reached_stand_in(scenario, i, 100), 100) for i in (2, 3)}
    assert (agents[2].mavlink, agents[2].hover_thrust_norm, agents[2].drag_1_s) == ("udpin:127.0.0.1:14641", 0.49, 0.25)
    assert (agents[3].mavlink, agents[3].hover_thrust_norm) == ("tcp:127.0.0.1:5880", 0.42)
    assert agents[3].drag_1_s == pytest.approx(0.6 / 2.1)
    files = {i: autopilot_file(scenario, i).stand_in for i in (2, 3)}
    assert "COM_OBL_RC_ACT" in files[2].parameters and "GUID_OPTIONS" in files[3].parameters
    assert (files[2].airframe.mass_kg, files[3].airframe.mass_kg) == (1.0, 2.1)


def test_the_ports_are_those_of_each_autopilot() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as other:
        other.bind(("127.0.0.1", ports_of(2, 2500).tcp))
        other.listen()
        with reserved_ports({1: ARDUPILOT, 2: PX4}, 2500):
            pass
        with pytest.raises(PortInUseError, match="wanted by autopilot 2"), reserved_ports({1: PX4, 2: ARDUPILOT}, 2500):
            pass


def test_a_mixed_fleet_must_converge_as_each_of_its_kinds() -> None:
    gain = "fleet.law.parameters.velocity_gain_1_s=0.35"  # too little without drag
    damped = [gain, "stand_in.airframe.drag_n_per_m_s=1"]
    check_convergence(load_scenario(PLATOON, damped))
    mixed = [*damped, "stand_in.vehicles.3.airframe.drag_n_per_m_s=0"]
    with pytest.raises(DivergesError, match=r"in a fleet of vehicles like 3, and must"):
        check_convergence(load_scenario(PLATOON, mixed))
    assert analyse(load_subject(PLATOON, damped)).converges
    analysis = analyse(load_subject(PLATOON, mixed))
    assert (analysis.converges, analysis.kinds, analysis.like_vehicle) == (False, 2, 3)
    assert analysis.laws["weighted"] == analyse(load_subject(PLATOON, [gain])).laws["weighted"]
    assert "all figures are of a fleet of vehicles like 3" in report(analysis)


def test_analyze_reads_the_kinds_as_a_flight_does() -> None:
    assert load_subject(MIXED).kinds == kinds_of(load_scenario(MIXED))
    alike = analyse(load_subject(PLATOON, ["stand_in.vehicles.3.sensors=ideal"]))
    assert (alike.kinds, alike.like_vehicle) == (1, None)
    with pytest.raises(
        ConfigError, match=r"^--set: stand_in\.vehicles\.3\.airframe\.mass_kg: 0: expected a number > 0"
    ):
        load_subject(PLATOON, ["stand_in.vehicles.3.airframe.mass_kg=0"])


def test_a_comparison_flies_it_by_agents() -> None:
    plan = plan_of(CompareOptions(scenario=PLATOON, overrides=["stand_in.vehicles.3.sensors=default"], seeds=1), print)
    assert [(flight.by_agents, flight.repeats) for flight in plan.flights] == [(True, False)]
    with pytest.raises(ValueError, match=r"a batch does not model stand_in\.vehicles; use sitl run or sitl fly"):
        columns_of([plan.flights[0].scenario])
