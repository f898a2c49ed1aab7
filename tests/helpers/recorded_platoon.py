"""A short flight of two vehicles in virtual time, recorded by their agents: a leader change and a formation change."""

from __future__ import annotations

from pathlib import Path

from sitl.flight.director import Director
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, scenario_from
from sitl.flight.watch import watch_of
from sitl.report.progress import FlightProgress

PLATOON = {
    "fleet": {
        "name": "platoon",
        "origin": {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_amsl_m": 488.0},
        "vehicles": [
            {"id": 1, "role": "leader", "slot_enu_m": [0.0, 0.0, 0.0]},
            {"id": 2, "role": "follower", "slot_enu_m": [-2.0, 0.0, 0.0], "may_lead": True},
        ],
        "neighbours": {"kind": "edges", "edges": [[1, 2]]},
        "takeoff_height_m": 1.0,
    },
    "starts_enu_m": {1: [0.0, 0.0, 0.0], 2: [-2.0, 0.0, 0.0]},
    "reference": {"kind": "point", "point_enu_m": [0.5, 0.0, 1.0]},
    "stand_in": {"sensors": "default"},
    "timeline": [
        {"command": "prepare"},
        {"command": "arm"},
        {"command": "takeoff"},
        {"command": "form", "for_s": 2.0},
        {"command": "lead", "leaders": [2], "for_s": 1.0},
        {"command": "formation", "formation": {"shape": "line", "spacing_m": 2.5}},
        {"command": "hold"},
        {"command": "land"},
    ],
}


def scenario() -> Scenario:
    return scenario_from(Path("platoon"), PLATOON)


def fly(folder: Path) -> None:
    """Leaves the recordings of both vehicles in the folder."""
    flown = scenario()
    lockstep = Lockstep(flown, folder)
    director = Director(
        lockstep, watch_of(flown, lockstep.now_s()), FlightProgress("test", True, 0.0), lambda: None, tuple, lockstep
    )
    assert not director.fly_and_land(flown.timeline)
    lockstep.close()
