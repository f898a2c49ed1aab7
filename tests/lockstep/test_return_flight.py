"""Agents leave in formation and return, all or some, with both makes of autopilots, to their starts and with separation."""

from itertools import combinations
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common import ROOT
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag, Role
from lockstep_fleet import CommandedFlight
from sitl.flight.scenario import scenario_from
from sitl.flight.virtual_flight import Flown, fly_in_virtual_time
from sitl.report.progress import FlightProgress

STARTS: dict[int, tuple[float, float, float]] = {
    1: (0.0, 0.0, 0.0),
    2: (-3.0, 0.0, 0.0),
    3: (-6.0, 0.0, 0.0),
    4: (-9.0, 0.0, 0.0),
}
EAST, NORTH = (12.0, 0.0), (0.0, 12.0)
DOWN_WITHIN_M = 0.7  # drift of the estimators
HIGHEST_M = {"px4": 30.0, "ardupilot": 15.0}  # RTL_RETURN_ALT, RTL_ALT

COLUMN = ROOT / "config" / "scenarios" / "leaving.yaml"
THERE_AND_BACK = (
    "reference={kind: waypoints, points_enu_m: [[0, 0, 2], [0, 9, 2], [0, 0, 2], [0, 9, 2]],"
    " max_speed_m_s: 1.0, max_acceleration_m_s2: 0.5}"
)
ON_THE_WAY_BACK_S, DOWN_AFTER_S = 13.0, {"px4": 30.0, "ardupilot": 45.0}


def flown(tmp_path: Path, make: str, way: tuple[float, float], **last_step: float) -> Flown:
    """Fly a line from west to east to a distance of 12 m, and return."""
    vehicles = [
        {"id": i, "role": "leader" if i == 1 else "follower", "slot_enu_m": list(start)} for i, start in STARTS.items()
    ]
    data: dict[str, Any] = {
        "fleet": {
            "name": "home",
            "origin": {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_amsl_m": 488.0},
            "vehicles": vehicles,
            "neighbours": {"kind": "edges", "edges": [[1, 2], [2, 3], [3, 4]]},
            "law": {"name": "cooperative"},
        },
        "starts_enu_m": {i: list(start) for i, start in STARTS.items()},
        "reference": {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 2.5], [*way, 2.5]]},
        "stand_in": {"sensors": "default", "autopilot": make},
        "timeline": [
            {"command": "prepare"},
            {"command": "arm"},
            {"command": "takeoff"},
            {"command": "form", "for_s": 20.0},
            {"command": "return", **last_step},
        ],
    }
    scenario = scenario_from(tmp_path / "scenario.yaml", data)
    return fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0))


@pytest.mark.parametrize("make", ["px4", pytest.param("ardupilot", marks=pytest.mark.long)])
def test_all_vehicles_return_at_once_and_land_at_their_starts(tmp_path: Path, make: str) -> None:
    flight = flown(tmp_path, make, NORTH)
    assert flight.failure is None
    tracks = flight.tracks()
    times_s = np.arange(0.0, min(track.time_s[-1] for track in tracks.values()), 0.1)
    at = {i: track.at(times_s) for i, track in tracks.items()}
    assert max(float(positions[:, 1].max()) for positions in at.values()) > 11.0
    for vehicle_id, positions in at.items():
        assert float(positions[:, 2].max()) == pytest.approx(HIGHEST_M[make], abs=1.0)
        assert dist(positions[-1][:2], STARTS[vehicle_id][:2]) < DOWN_WITHIN_M
        status = flight.watch.status(vehicle_id)
        assert status is not None
        assert not status.autopilot.armed
    apart_m = min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))
    assert apart_m > 2.0


def test_a_return_with_crossing_paths_is_refused_with_the_reason(tmp_path: Path) -> None:
    """Each path home passes over the positions of other vehicles."""
    flight = flown(tmp_path, "px4", EAST, timeout_s=2.0)
    assert flight.failure is not None
    assert "return not done within 2 s" in flight.failure
    assert "RETURN_PATH_TOO_CLOSE" in flight.failure
    assert "expected at least separation_m, 1 m; land instead" in flight.failure
    assert all(not status.autopilot.armed for i in STARTS if (status := flight.watch.status(i)))
    ends_m = {i: track.at(track.time_s[-1:])[0] for i, track in flight.tracks().items()}
    assert all(ends_m[i][0] - start[0] > 11.0 for i, start in STARTS.items())


def returned_alone(make: str, *ids: int) -> CommandedFlight:
    """Five in a column fly north and back over their starts; only these vehicles are told to return, on the way back."""
    flight = CommandedFlight(COLUMN, THERE_AND_BACK, f"stand_in.autopilot={make}")
    flight.go_on(ON_THE_WAY_BACK_S)
    since_s = flight.lockstep.now_s()
    flight.give(CommandName.RETURN, *ids)
    flight.go_on(DOWN_AFTER_S[make])
    assert flight.smallest_m(since_s) >= flight.scenario.fleet.separation_m
    for vehicle_id in ids:
        status = flight.newest[vehicle_id]
        assert not status.autopilot.armed
        assert dist(status.motion.position_enu_m[:2], flight.scenario.starts_enu_m[vehicle_id][:2]) < DOWN_WITHIN_M
    return flight


def phases_of(flight: CommandedFlight, *ids: int) -> dict[int, FlightPhase]:
    return {i: flight.newest[i].phase for i in ids}


@pytest.mark.parametrize("make", ["px4", pytest.param("ardupilot", marks=pytest.mark.long)])
def test_a_leader_that_returns_alone_is_replaced_and_the_others_fly_past_it(make: str) -> None:
    """With PX4 they come back over its start while it lands there, and stop before it."""
    flight = returned_alone(make, 1)
    assert phases_of(flight, 2, 3, 4, 5) == dict.fromkeys((2, 3, 4, 5), FlightPhase.FORMATION)
    assert {i for i in (2, 3, 4, 5) if flight.newest[i].leadership.role is Role.LEADER} == {2}
    assert max(flight.errors_m().values()) < 0.1


def test_followers_whose_leader_and_successor_return_hold() -> None:
    flight = returned_alone("px4", 1, 2)
    assert phases_of(flight, 3, 4, 5) == dict.fromkeys((3, 4, 5), FlightPhase.HOLD)
    assert all(HealthFlag.LEADER_LOST in flight.newest[i].safety.flags for i in (3, 4, 5))


def test_a_follower_whose_neighbours_return_holds_and_the_others_fly_on() -> None:
    flight = returned_alone("px4", 3, 4)
    assert phases_of(flight, 1, 2, 5) == {1: FlightPhase.FORMATION, 2: FlightPhase.FORMATION, 5: FlightPhase.HOLD}
    assert HealthFlag.LEADER_LOST in flight.newest[5].safety.flags
    assert max(flight.errors_m().values()) < 0.1
