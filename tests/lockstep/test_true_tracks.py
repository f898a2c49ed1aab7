"""Every shipped scenario flies the same true tracks, to the last bit, with both autopilot types.

A change that must not alter a flight keeps these hashes. One that means to alter flights writes them again and says why:

    .venv/bin/python tests/lockstep/test_true_tracks.py
"""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from itertools import product
from pathlib import Path

import pytest

from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress

SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"
HASHES = Path(__file__).with_name("true_tracks.json")
AUTOPILOTS = ("ardupilot", "px4")
IN_MAKE_TEST = {("exchange", "px4"), ("ring_figure_8", "px4"), ("platoon", "ardupilot")}


def track_hash(scenario_name: str, autopilot: str) -> str:
    """SHA-256 of the times and true positions of all vehicles in the order of their ids, as doubles."""
    path = SCENARIOS / f"{scenario_name}.yaml"
    scenario = load_scenario(path, [f"stand_in.autopilot={autopilot}"])
    flown = fly_in_virtual_time(scenario, FlightProgress(scenario_name, True, 0.0))
    digest = sha256(str(flown.failure).encode())
    for vehicle_id, track in sorted(flown.tracks().items()):
        digest.update(str(vehicle_id).encode() + track.time_s.tobytes() + track.position_enu_m.tobytes())
    return digest.hexdigest()


def _flights() -> list[tuple[str, str]]:
    return list(product(sorted(path.stem for path in SCENARIOS.glob("*.yaml")), AUTOPILOTS))


@pytest.mark.parametrize(
    ("scenario_name", "autopilot"),
    [pytest.param(*flight, marks=() if flight in IN_MAKE_TEST else pytest.mark.long) for flight in _flights()],
)
def test_a_shipped_scenario_flies_the_same_true_tracks(scenario_name: str, autopilot: str) -> None:
    assert track_hash(scenario_name, autopilot) == json.loads(HASHES.read_text())[scenario_name][autopilot]


def _write_hashes() -> None:
    with ProcessPoolExecutor(2) as pool:
        hashes = list(pool.map(track_hash, *zip(*_flights(), strict=True)))
    table: dict[str, dict[str, str]] = {}
    for (scenario_name, autopilot), value in zip(_flights(), hashes, strict=True):
        table.setdefault(scenario_name, {})[autopilot] = value
    HASHES.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    _write_hashes()
