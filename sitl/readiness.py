"""Are the vehicles that something else has started ready to be flown? Judged by what their agents report. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from itertools import combinations
from math import hypot

from companion.config.fleet import GeodeticOrigin
from companion.frames import geodetic_from_enu
from companion.types import WITHOUT_LEADER, Status, Vector3
from sitl.scenario import Scenario
from sitl.watch import vehicles_in_words

READY_WITHIN_S = 120.0  # an ArduCopter may be armed 42 s after its start; so much more for a slow machine
READY_FOR_S = 2.0  # without a break: an estimator that has just begun still changes its mind
FAR_M = 10.0  # from its start: it was started elsewhere, or the origin is another. Nearer, it was flown before
HEIGHT_M = 1.0  # above or below its start: the formation's height would be as wrong
CLOSEST_M = 1.0  # two that stand nearer, and nearer than half their starts' distance, are on one spot


class Readiness:
    """Of one scenario's vehicles. Give it what is known of them and the time, again and again.

    They may have been flown before, and stand where they landed; but each in a place of its own.
    """

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
        if not any(lacking.values()):
            lacking = self._on_one_spot({i: status.position_enu_m for i, status in known.items() if status})
        self.lacking = _by_reason({i: words for i, words in lacking.items() if words})
        if self.lacking:
            self._ready_since_s = None
            return False
        if self._ready_since_s is None:
            self._ready_since_s = now_s
        return now_s - self._ready_since_s >= READY_FOR_S

    def _on_one_spot(self, positions_enu_m: Mapping[int, Vector3]) -> dict[int, str]:
        """Vehicles that stand where another one does, with words; in simulations of their own they do not feel each other."""
        found = {}
        for i, j in combinations(sorted(positions_enu_m), 2):
            apart_m = _level_m(positions_enu_m[i], positions_enu_m[j])
            if apart_m < min(CLOSEST_M, 0.5 * _level_m(self._starts_enu_m[i], self._starts_enu_m[j])):
                start_it = _start_it(self._starts_enu_m[j], self._origin)
                found[j] = f"stands {apart_m:.1f} m from vehicle {i}; {start_it} its starts_enu_m"
        return found

    def _lacks(self, vehicle_id: int, status: Status | None) -> str:
        """In words; "" where a vehicle on the ground lacks nothing to be flown in formation from its start."""
        if status is None:
            return "nothing heard from the agent yet"
        missing = [*(flag for flag in status.flags if flag not in WITHOUT_LEADER), *status.lacks]
        if missing:
            return "; ".join(missing)
        return _away(status.position_enu_m, self._starts_enu_m[vehicle_id], self._origin)


def somebody_flies(statuses: Collection[Status]) -> str:
    """Which vehicles are flown already, so that nothing may be asked of them; "" where none is."""
    armed = sorted(status.vehicle_id for status in statuses if status.armed)
    if not armed:
        return ""
    return f"{vehicles_in_words(armed)} armed before the flight: somebody else flies; land and disarm first"


def _away(position_enu_m: Vector3, start_enu_m: Vector3, origin: GeodeticOrigin) -> str:
    z, z0 = position_enu_m[2], start_enu_m[2]
    away_m = _level_m(position_enu_m, start_enu_m)
    if away_m > FAR_M:
        return (
            f"stands {away_m:.0f} m from its starts_enu_m; {_start_it(start_enu_m, origin)}"
            " or correct fleet.origin or starts_enu_m"
        )
    if abs(z - z0) > HEIGHT_M:
        return (
            f"stands at a height of {z:.1f} m, its starts_enu_m at {z0:.1f} m; {_start_it(start_enu_m, origin)}"
            " or correct fleet.origin, or count heights from the ground: fleet.altitude_source=takeoff"
        )
    return ""


def _level_m(one_enu_m: Vector3, other_enu_m: Vector3) -> float:
    return hypot(one_enu_m[0] - other_enu_m[0], one_enu_m[1] - other_enu_m[1])


def _start_it(start_enu_m: Vector3, origin: GeodeticOrigin) -> str:
    latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(start_enu_m, origin.as_tuple())
    return f"start it at {latitude_deg:.7f}, {longitude_deg:.7f}, {altitude_m:.1f} m,"


def _by_reason(lacking: dict[int, str]) -> str:
    """One reason once, with all vehicles that have it."""
    vehicles: dict[str, list[int]] = {}
    for vehicle_id, words in lacking.items():
        vehicles.setdefault(words, []).append(vehicle_id)
    return "; ".join(f"{vehicles_in_words(ids)}: {words}" for words, ids in vehicles.items())
