"""Vehicles that something else has started: the file that says where each is reached."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.fleet import FleetConfig
from companion.config.kind import read_as
from companion.config.values import Drag, HoverThrust, Section, VehicleId
from companion.config.vehicle import MavlinkEndpoint
from companion.config_file import ConfigError, convert
from companion.types import AutopilotKind


class ReachedVehicle(Section, frozen=True):
    """One vehicle as its agent reaches it, in the words of a vehicle file."""

    id: VehicleId
    mavlink: MavlinkEndpoint
    hover_thrust_norm: HoverThrust
    drag_1_s: Drag = 0.25
    autopilot: AutopilotKind | None = None


class ExternalFile(Section, frozen=True):
    external_vehicles: Annotated[tuple[ReachedVehicle, ...], Meta(min_length=1)]


def load_external(path: Path) -> tuple[ReachedVehicle, ...]:
    """Raises ConfigError."""
    vehicles = convert(path, read_as(path, "external"), ExternalFile).external_vehicles
    for index, vehicle in enumerate(vehicles):
        for other_index, other in enumerate(vehicles[:index]):
            where, its = f"external_vehicles[{index}]", f"external_vehicles[{other_index}]"
            if vehicle.id == other.id:
                raise ConfigError(path, f"{where}.id", f"{vehicle.id} is used twice; {its} has it")
            if vehicle.mavlink == other.mavlink:
                raise ConfigError(
                    path,
                    f"{where}.mavlink",
                    f'"{vehicle.mavlink}" is also that of vehicle {other.id}; each needs an endpoint of its own',
                )
    return vehicles


def vehicles_of(path: Path, vehicles: Sequence[ReachedVehicle], fleet: FleetConfig) -> dict[int, ReachedVehicle]:
    """Those of this fleet by id; `path` names their file in errors, which may hold more. Raises ConfigError."""
    known = {vehicle.id: vehicle for vehicle in vehicles}
    for member in fleet.vehicles:
        if member.id not in known:
            ids = ", ".join(str(i) for i in sorted(known))
            raise ConfigError(
                path, "external_vehicles", f"no vehicle {member.id}, which fleet {fleet.name} has; found {ids}"
            )
    return {member.id: known[member.id] for member in fleet.vehicles}
