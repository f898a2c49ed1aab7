"""External vehicles: their file, their readiness, and the results of their flight."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from msgspec import structs

from common import ROOT, with_fields
from companion.config.file import ConfigError
from companion.types.autopilot import AutopilotKind, LandedState
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.status import Status
from ground_fleet import WHOLE, DirectedFlight, directed_status
from sitl.cli.flights import FLY, flight_options
from sitl.flight.external import READY_FOR_S, ReachedVehicle, Readiness, load_external, vehicles_of
from sitl.flight.files import estimated_path, write_files
from sitl.flight.flights import FlightEnd, FlightOrder, write_results
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.free_ports import PortInUseError, reserved_ports
from sitl.report.folder import remove_old_run
from sitl.report.metrics import TrackError, read_track, reported_track, write_track
from sitl.report.summary import in_words, read_summary
from sitl.stopping import StopRequest

CONFIG = ROOT / "config"
EXAMPLES = sorted((CONFIG / "external").glob("*.yaml"))
LINE = CONFIG / "scenarios" / "four_in_line.yaml"
SCENARIO = """\
fleet:
  name: pair
  origin: {latitude_deg: 47.0, longitude_deg: 8.0, altitude_amsl_m: 400.0}
  vehicles:
    - {id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}
    - {id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0]}
  neighbours: {kind: edges, edges: [[1, 2]]}
starts_enu_m: {1: [0.0, 0.0, 0.0], 2: [-3.0, 0.0, 0.0]}
reference: {kind: point, point_enu_m: [0.0, 0.0, 3.0]}
timeline: [{command: prepare}]
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    (tmp_path / "pair.yaml").write_text(SCENARIO, encoding="utf-8")
    return load_scenario(tmp_path / "pair.yaml")


def reached(vehicle_id: int, **more: Any) -> dict[str, Any]:
    return {"id": vehicle_id, "mavlink": f"udpin:127.0.0.1:{14539 + vehicle_id}", "hover_thrust_norm": 0.5} | more


def write(tmp_path: Path, *vehicles: dict[str, Any], **more: Any) -> Path:
    path = tmp_path / "external.yaml"
    path.write_text(yaml.safe_dump({"external_vehicles": list(vehicles)} | more), encoding="utf-8")
    return path


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_files_have_all_vehicles_of_the_example_scenario(path: Path) -> None:
    fleet = load_scenario(LINE).fleet
    assert len(vehicles_of(path, load_external(path), fleet)) == 4


@pytest.mark.parametrize(
    ("vehicles", "text"),
    [
        ([], "external_vehicles"),
        ([reached(1), reached(1, mavlink="tcp:a:1")], "external_vehicles[1].id: 1 is used twice; external_vehicles[0]"),
        ([reached(1), reached(2, mavlink="udpin:127.0.0.1:14540")], 'mavlink: "udpin:127.0.0.1:14540" is also that of'),
        ([reached(1, mavlink="udp:127.0.0.1:14540")], "expected udpin:HOST:PORT, tcp:HOST:PORT or serial"),
        ([reached(1, autopilot="betaflight")], "external_vehicles[0].autopilot"),
        ([reached(1, hover_thrust_norm=0.0)], "external_vehicles[0].hover_thrust_norm"),
        ([reached(1, port=14540)], "port"),
    ],
)  # fmt: skip
def test_each_error_of_a_bad_file_is_located(tmp_path: Path, vehicles: list[dict[str, Any]], text: str) -> None:
    path = write(tmp_path, *vehicles)
    with pytest.raises(ConfigError) as caught:
        load_external(path)
    assert str(caught.value).startswith(str(path))
    assert any(text in line for line in caught.value.lines)


def test_another_kind_of_file_and_a_missing_vehicle_are_refused(tmp_path: Path, scenario: Scenario) -> None:
    with pytest.raises(ConfigError, match=r"this is a scenario; a file of external vehicles is expected"):
        load_external(LINE)
    path = write(tmp_path, reached(1), reached(3))
    with pytest.raises(ConfigError, match=r"no vehicle 2, which fleet pair has; found 1, 3"):
        vehicles_of(path, load_external(path), scenario.fleet)


def test_vehicle_files_are_written_without_autopilot_files(tmp_path: Path, scenario: Scenario) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    one = ReachedVehicle(id=1, mavlink="tcp:127.0.0.1:5762", hover_thrust_norm=0.39, autopilot=AutopilotKind.ARDUPILOT)
    two = ReachedVehicle(id=2, mavlink="udpin:127.0.0.1:14541", hover_thrust_norm=0.5, drag_1_s=1.0)
    write_files(scenario, folder, 0, {1: one, 2: two})
    assert sorted(path.name for path in folder.iterdir()) == [
        "fleet.yaml", "scenario.yaml", "vehicle_1.yaml", "vehicle_2.yaml"
    ]  # fmt: skip
    file = yaml.safe_load((folder / "vehicle_1.yaml").read_text(encoding="utf-8"))
    assert (file["mavlink"], file["autopilot"], file["hover_thrust_norm"]) == ("tcp:127.0.0.1:5762", "ardupilot", 0.39)
    file = yaml.safe_load((folder / "vehicle_2.yaml").read_text(encoding="utf-8"))
    assert (file["mavlink"], file["autopilot"], file["drag_1_s"]) == ("udpin:127.0.0.1:14541", None, 1.0)


def test_stand_ins_and_external_vehicles_exclude_each_other() -> None:
    parser = argparse.ArgumentParser()
    FLY.add_arguments(parser)
    with pytest.raises(ConfigError, match=r"^--autopilot: .*--external starts none; give one of the two"):
        flight_options(parser.parse_args(["s.yaml", "--external", "e.yaml", "--autopilot", "px4"]))


def test_only_the_agents_ports_must_be_free() -> None:
    with reserved_ports(dict.fromkeys([1, 2]), 2400):
        pass
    with pytest.raises(PortInUseError, match=r"TCP port 9848"):
        import socket

        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as taken:
            taken.bind(("127.0.0.1", 9848))
            taken.listen()
            with reserved_ports(dict.fromkeys([1]), 2400):
                pass


# ---------------------------------------------------------------- ready


def known(*statuses: Status) -> Callable[[int], Status | None]:
    return {status.agent.vehicle_id: status for status in statuses}.get


READY_1, READY_2 = directed_status(1), with_fields(directed_status(2), position_enu_m=(-3.0, 0.0, 0.0))


def test_readiness_requires_all_vehicles_ready_for_some_time(scenario: Scenario) -> None:
    readiness, both = Readiness(scenario), known(READY_1, READY_2)
    assert not readiness.is_reached(both, 0.0)
    assert readiness.lacking == ""
    assert not readiness.is_reached(known(READY_1, with_fields(READY_2, flags=(HealthFlag.POSITION_STALE,))), 1.0)
    assert readiness.lacking == "vehicle 2: POSITION_STALE"
    assert not readiness.is_reached(both, 1.5)
    assert not readiness.is_reached(both, READY_FOR_S + 1.4)
    assert readiness.is_reached(both, READY_FOR_S + 1.5)


def test_each_reason_is_reported_once(scenario: Scenario) -> None:
    readiness = Readiness(scenario)
    readiness.is_reached(known(), 0.0)
    assert readiness.lacking == "vehicles 1, 2: no status from its agent yet"
    readiness.is_reached(known(with_fields(READY_1, lacks=("this", "that")), READY_2), 0.0)
    assert readiness.lacking == "vehicle 1: this; that"


def test_a_missing_leader_beacon_does_not_delay_readiness(scenario: Scenario) -> None:
    readiness = Readiness(scenario)
    readiness.is_reached(known(READY_1, with_fields(READY_2, flags=(HealthFlag.LEADER_LOST,))), 0.0)
    assert readiness.lacking == ""


@pytest.mark.parametrize(
    ("position_enu_m", "text"),
    [
        ((-8.0, 6.0, 0.9), ""),  # where an earlier flight left it
        ((-3.0, 11.0, 0.0), "is 11 m from its starts_enu_m; start it at 47.0000000, 7.9999606, 400.0 m, or correct"),
        ((-3.0, 0.0, 1.4), "is at a height of 1.4 m, its starts_enu_m at 0.0 m; start it at 47.0000000, 7.9999606, 400.0"),
        ((-0.3, 0.0, 0.0), "is 0.3 m from vehicle 1; start it at 47.0000000, 7.9999606, 400.0 m, its starts_enu_m"),
    ],
)  # fmt: skip
def test_a_vehicle_away_from_its_start_is_reported(
    scenario: Scenario, position_enu_m: tuple[float, float, float], text: str
) -> None:
    readiness = Readiness(scenario)
    readiness.is_reached(known(READY_1, with_fields(READY_2, position_enu_m=position_enu_m)), 0.0)
    assert readiness.lacking.startswith(f"vehicle 2: {text}" if text else "")
    assert bool(readiness.lacking) is bool(text)


def test_the_director_waits_without_commands_until_all_are_ready(scenario: Scenario) -> None:
    flight = DirectedFlight()
    flight.vehicles.change(2, position_enu_m=(-3.0, 0.0, 0.0))
    assert flight.director.wait_for(Readiness(scenario)) == []
    assert flight.vehicles.received == []


def test_a_vehicle_that_is_already_armed_ends_the_wait(scenario: Scenario) -> None:
    flight = DirectedFlight()
    flight.vehicles.change(2, armed=True)
    failures = flight.director.wait_for(Readiness(scenario))
    assert failures == ["vehicle 2 armed before the flight; land and disarm first"]
    assert flight.vehicles.received == []


def test_the_reason_for_the_end_of_the_wait_is_reported(scenario: Scenario) -> None:
    flight = DirectedFlight()
    flight.checks.append("agent 2 ended with exit code 3: why")
    assert flight.director.wait_for(Readiness(scenario)) == ["agent 2 ended with exit code 3: why"]


def test_a_vehicle_that_never_becomes_ready_is_named(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.flight.director.READY_WITHIN_S", 0.3)
    flight = DirectedFlight()
    flight.vehicles.change(2, position_enu_m=(-3.0, 0.0, 0.0), lacks=("GUID_OPTIONS: 0",))
    assert flight.director.wait_for(Readiness(scenario)) == ["not ready within 0.3 s: vehicle 2: GUID_OPTIONS: 0"]
    assert "  vehicles 1, 2: no status from its agent yet\n" in flight.shown.getvalue()


def test_a_vehicle_that_flies_without_a_command_gets_none() -> None:
    flight = DirectedFlight()
    flight.vehicles.change(1, armed=True, landed=LandedState.IN_AIR, phase=FlightPhase.FORMATION)
    flight.vehicles.change(2, armed=True, landed=LandedState.IN_AIR)
    for report in flight.vehicles.drain():
        flight.watch.receive(report, time.monotonic())
    assert flight.watch.flown_by_others() == {2}
    flight.lost |= flight.watch.flown_by_others()
    flight.director.land_all()
    assert {ids for _, ids in flight.vehicles.received} == {(1,)}


# ---------------------------------------------------------------- results


def test_a_track_holds_the_positions_reported_in_flight(tmp_path: Path) -> None:
    flight = DirectedFlight()
    for now_s, armed, age_s, x_m in (
        (0.0, False, inf, 9.0),
        (1.0, True, 0.02, 1.0),
        (1.1, True, 0.12, 1.0),  # of the same position as before
        (1.2, True, 0.0, 1.5),
    ):
        flight.vehicles.change(1, armed=armed, state_age_s=age_s, position_enu_m=(x_m, 0.0, 2.0))
        for report in flight.vehicles.drain():
            flight.watch.receive(report, now_s)
    track = reported_track(1, flight.watch.reported[1])
    assert track.time_s.tolist() == pytest.approx([0.98, 1.2])
    path = estimated_path(tmp_path, 1)
    write_track(path, track)
    again = read_track(path)
    assert again.at(np.array([1.2])).tolist() == [[1.5, 0.0, 2.0]]
    with pytest.raises(TrackError, match=r"vehicle 2 reported no position in flight"):
        reported_track(2, flight.watch.reported[2])


def test_the_summary_states_the_source_of_the_positions(tmp_path: Path, scenario: Scenario) -> None:
    flight = DirectedFlight()
    flight.fly(*WHOLE)
    tracks = {i: reported_track(i, flight.watch.reported[i]) for i in (1, 2)}
    order = FlightOrder(scenario, "pair", tmp_path, StopRequest("stopped"))
    end = FlightEnd(failure=None, flight_s=1.0, source="estimated")
    result = write_results(order, flight.watch, tracks, end)
    summary = read_summary(tmp_path / "summary.json")
    assert (summary.tracks, summary.sensors, summary.seed) == ("estimated", None, None)
    assert "  positions         as estimated by the vehicles" in in_words(result.summary)
    assert (tmp_path / "figure_5.png").stat().st_size > 0


def test_the_summary_states_that_the_autopilots_were_real(tmp_path: Path, scenario: Scenario) -> None:
    flight = DirectedFlight()
    flight.fly(*WHOLE)
    tracks = {i: reported_track(i, flight.watch.reported[i]) for i in (1, 2)}
    order = FlightOrder(scenario, "pair", tmp_path, StopRequest("stopped"))
    kinds = dict.fromkeys((1, 2), AutopilotKind.ARDUPILOT)
    result = write_results(order, flight.watch, tracks, FlightEnd(failure=None, flight_s=1.0, real_autopilots=kinds))
    summary = read_summary(tmp_path / "summary.json")
    assert (summary.tracks, summary.sensors, summary.seed) == ("true", None, None)
    assert [vehicle.autopilot for vehicle in summary.vehicles] == list(kinds.values())
    words = in_words(structs.replace(result.summary, overload="9 ms"))
    assert "  autopilots        ardupilot 1, 2   (real ones, in their own simulation)\n" in words
    assert words.endswith("  the machine or the autopilots were too slow for real time: 9 ms")


def test_a_run_removes_the_files_of_the_run_before(tmp_path: Path) -> None:
    for name in ("scenario.yaml", "estimated_1.csv", "own.txt"):
        (tmp_path / name).write_text("", encoding="utf-8")
    remove_old_run(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["own.txt"]
