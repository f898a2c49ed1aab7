"""Autopilots that another program has started: the file with their MAVLink endpoints, and their readiness before a flight."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import combinations
from math import hypot
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.file import ConfigError, convert, read_as
from companion.config.fleet import FleetConfig, GeodeticOrigin
from companion.config.validation import Problem
from companion.config.values import Drag, HoverThrust, Section, VehicleId
from companion.config.vehicle import MavlinkEndpoint
from companion.geometry.frames import geodetic_from_enu
from companion.ground.answers import id_list
from companion.types.autopilot import AutopilotKind
from companion.types.flight import WITHOUT_LEADER
from companion.types.status import Status
from companion.types.values import Vector3
from sitl.flight.scenario import Scenario
from sitl.flight.watch import reasons_in_words

READY_WITHIN_S = 120.0  # an ArduCopter can be armed 42 s after its start; the rest is for slow machines
READY_FOR_S = 2.0  # without interruption: a fresh estimate may still jump
FAR_M = 10.0  # from its start: it was started elsewhere, or has another origin. A shorter distance is from an earlier flight
HEIGHT_M = 1.0  # above or below its start: the height of the formation would have the same error
CLOSEST_M = 1.0  # two vehicles nearer than this, and than half their starts' distance, are at the same position


class ReachedVehicle(Section, frozen=True):
    """How the agent of one vehicle reaches its autopilot, with the keys of a vehicle file.

    autopilot: required autopilot; without a value the one of its HEARTBEAT
    """

    id: VehicleId
    mavlink: MavlinkEndpoint
    hover_thrust_norm: HoverThrust
    drag_1_s: Drag = 0.25
    autopilot: AutopilotKind | None = None


class ExternalFile(Section, frozen=True):
    """The file of `sitl fly --external`.

    external_vehicles: the vehicles; more than the scenario has is allowed
    """

    external_vehicles: Annotated[tuple[ReachedVehicle, ...], Meta(min_length=1)]


def load_external(path: Path) -> tuple[ReachedVehicle, ...]:
    """The vehicles of the file. Raises ConfigError."""
    return convert(path, read_as(path, "external"), ExternalFile, _problems).external_vehicles


def _problems(file: ExternalFile) -> Iterator[Problem]:
    """Ids and endpoints must be unique."""
    for index, vehicle in enumerate(file.external_vehicles):
        for other_index, other in enumerate(file.external_vehicles[:index]):
            where, its = f"external_vehicles[{index}]", f"external_vehicles[{other_index}]"
            if vehicle.id == other.id:
                yield Problem(f"{where}.id", f"{vehicle.id} is used twice; {its} has it")
            if vehicle.mavlink == other.mavlink:
                problem = f'"{vehicle.mavlink}" is also that of vehicle {other.id}; each needs an endpoint of its own'
                yield Problem(f"{where}.mavlink", problem)


def vehicles_of(path: Path, vehicles: Sequence[ReachedVehicle], fleet: FleetConfig) -> dict[int, ReachedVehicle]:
    """The vehicles of this fleet by id; `path` names their file in errors. Raises ConfigError."""
    known = {vehicle.id: vehicle for vehicle in vehicles}
    for member in fleet.vehicles:
        if member.id not in known:
            ids = ", ".join(str(i) for i in sorted(known))
            raise ConfigError(
                path, "external_vehicles", f"no vehicle {member.id}, which fleet {fleet.name} has; found {ids}"
            )
    return {member.id: known[member.id] for member in fleet.vehicles}


class Readiness:
    """Readiness of the vehicles of one scenario; `is_reached` is to be called repeatedly.

    They may have flown before and be where they landed, but apart from each other.
    """

    def __init__(self, scenario: Scenario) -> None:
        origin = scenario.fleet.place
        assert origin is not None  # scenario_from accepts no other
        self._origin, self._starts_enu_m = origin, scenario.starts_enu_m
        self._ready_since_s: float | None = None
        self.lacking = ""  # what prevents the flight at present

    def is_reached(self, statuses: Callable[[int], Status | None], now_s: float) -> bool:
        """Whether all have been ready for READY_FOR_S without interruption."""
        known = {vehicle_id: statuses(vehicle_id) for vehicle_id in sorted(self._starts_enu_m)}
        lacking = {i: self._lacks(i, status) for i, status in known.items()}
        if not any(lacking.values()):
            lacking = self._at_same_position({i: status.motion.position_enu_m for i, status in known.items() if status})
        self.lacking = reasons_in_words({i: reason for i, reason in lacking.items() if reason})
        if self.lacking:
            self._ready_since_s = None
            return False
        if self._ready_since_s is None:
            self._ready_since_s = now_s
        return now_s - self._ready_since_s >= READY_FOR_S

    def _at_same_position(self, positions_enu_m: Mapping[int, Vector3]) -> dict[int, str]:
        """Vehicles at the position of another one, with texts; separate simulations do not collide."""
        found = {}
        for i, j in combinations(sorted(positions_enu_m), 2):
            apart_m = _level_m(positions_enu_m[i], positions_enu_m[j])
            if apart_m < min(CLOSEST_M, 0.5 * _level_m(self._starts_enu_m[i], self._starts_enu_m[j])):
                start_it = _start_it(self._starts_enu_m[j], self._origin)
                found[j] = f"is {apart_m:.1f} m from vehicle {i}; {start_it} its starts_enu_m"
        return found

    def _lacks(self, vehicle_id: int, status: Status | None) -> str:
        """What a vehicle on the ground lacks before a formation from its start; "" for nothing."""
        if status is None:
            return "no status from its agent yet"
        missing = [
            *(flag for flag in status.safety.flags if flag not in WITHOUT_LEADER),
            *map(str, status.safety.lacks),
        ]
        if missing:
            return "; ".join(missing)
        return _away(status.motion.position_enu_m, self._starts_enu_m[vehicle_id], self._origin)


def armed_already(statuses: Collection[Status]) -> str:
    """Vehicles that are armed already, in one line; they must not be commanded. "" if there are none."""
    armed = sorted(status.agent.vehicle_id for status in statuses if status.autopilot.armed)
    if not armed:
        return ""
    return f"{id_list(armed)} armed before the flight; land and disarm first"


def _away(position_enu_m: Vector3, start_enu_m: Vector3, origin: GeodeticOrigin) -> str:
    z, z0 = position_enu_m[2], start_enu_m[2]
    away_m = _level_m(position_enu_m, start_enu_m)
    if away_m > FAR_M:
        return (
            f"is {away_m:.0f} m from its starts_enu_m; {_start_it(start_enu_m, origin)}"
            " or correct fleet.origin or starts_enu_m"
        )
    if abs(z - z0) > HEIGHT_M:
        return (
            f"is at a height of {z:.1f} m, its starts_enu_m at {z0:.1f} m; {_start_it(start_enu_m, origin)}"
            " or correct fleet.origin, or count heights from the ground: fleet.altitude_source=takeoff"
        )
    return ""


def _level_m(one_enu_m: Vector3, other_enu_m: Vector3) -> float:
    return hypot(one_enu_m[0] - other_enu_m[0], one_enu_m[1] - other_enu_m[1])


def _start_it(start_enu_m: Vector3, origin: GeodeticOrigin) -> str:
    latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(start_enu_m, origin.as_tuple())
    return f"start it at {latitude_deg:.7f}, {longitude_deg:.7f}, {altitude_m:.1f} m,"
