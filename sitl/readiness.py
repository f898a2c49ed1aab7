"""Are the vehicles that something else has started ready to be flown? Judged by what their agents report. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import dist

from companion.config.fleet import GeodeticOrigin
from companion.frames import geodetic_from_enu
from companion.types import HealthFlag, Status, Vector3
from sitl.scenario import Scenario

READY_WITHIN_S = 120.0  # an ArduCopter may be armed 42 s after its start; so much more for a slow machine
READY_FOR_S = 2.0  # without a break: an estimator that has just begun still changes its mind
AT_START_M = 1.0  # so far from its start a vehicle may stand: what GPS and an estimator's first minute make of it


class Readiness:
    """Of one scenario's vehicles. Give it what is known of them and the time, again and again."""

    def __init__(self, scenario: Scenario) -> None:
        origin = scenario.fleet.origin
        assert isinstance(origin, GeodeticOrigin)  # scenario_from refuses any other
        self._origin, self._starts_enu_m = origin, scenario.starts_enu_m
        self._ready_since_s: float | None = None
        self.lacking = ""  # what forbids the flight just now

    def is_reached(self, statuses: Callable[[int], Status | None], now_s: float) -> bool:
        """Have all been ready without a break for a while?"""
        known = {vehicle_id: statuses(vehicle_id) for vehicle_id in sorted(self._starts_enu_m)}
        lacking = {i: self._lacks(i, status) for i, status in known.items()}
        self.lacking = _by_reason({i: words for i, words in lacking.items() if words})
        if self.lacking:
            self._ready_since_s = None
            return False
        if self._ready_since_s is None:
            self._ready_since_s = now_s
        return now_s - self._ready_since_s >= READY_FOR_S

    def _lacks(self, vehicle_id: int, status: Status | None) -> str:
        """In words; "" where a vehicle on the ground lacks nothing to be flown in formation from its start."""
        if status is None:
            return "nothing heard from the agent yet"
        missing = [*(flag for flag in status.flags if flag is not HealthFlag.LEADER_LOST), *status.lacks]
        if missing:
            return "; ".join(missing)
        return _away(status.position_enu_m, self._starts_enu_m[vehicle_id], self._origin)


def somebody_flies(statuses: Collection[Status]) -> str:
    """Which vehicles are flown already, so that nothing may be asked of them; "" where none is."""
    armed = sorted(status.vehicle_id for status in statuses if status.armed)
    if not armed:
        return ""
    return f"{_vehicles(armed)} armed before the flight: somebody else flies; land and disarm first"


def _away(position_enu_m: Vector3, start_enu_m: Vector3, origin: GeodeticOrigin) -> str:
    away_m = dist(position_enu_m, start_enu_m)
    if away_m <= AT_START_M:
        return ""
    place = ", ".join(f"{coordinate:z.1f}" for coordinate in position_enu_m)
    latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(start_enu_m, origin.as_tuple())
    return (
        f"stands at {place} m east, north, up of fleet.origin, {away_m:.1f} m from its starts_enu_m {list(start_enu_m)}:"
        f" start it at {latitude_deg:.7f}, {longitude_deg:.7f}, {altitude_m:.1f} m, or correct fleet.origin or starts_enu_m"
        " (where only the height differs, fleet.altitude_source=takeoff)"
    )


def _by_reason(lacking: dict[int, str]) -> str:
    """One reason once, with all vehicles that have it."""
    vehicles: dict[str, list[int]] = {}
    for vehicle_id, words in lacking.items():
        vehicles.setdefault(words, []).append(vehicle_id)
    return "; ".join(f"{_vehicles(ids)}: {words}" for words, ids in vehicles.items())


def _vehicles(ids: Collection[int]) -> str:
    return f"vehicle{'s' if len(ids) > 1 else ''} {', '.join(map(str, ids))}"
