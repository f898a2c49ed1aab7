"""Vehicles that another program has started: the file with the MAVLink endpoint of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.file import ConfigError, convert, read_as
from companion.config.fleet import FleetConfig
from companion.config.validation import Problem
from companion.config.values import Drag, HoverThrust, Section, VehicleId
from companion.config.vehicle import MavlinkEndpoint
from companion.types.autopilot import AutopilotKind


class ReachedVehicle(Section, frozen=True):
    """How the agent of one vehicle reaches its autopilot, with the keys of a vehicle file."""

    id: VehicleId
    mavlink: MavlinkEndpoint
    hover_thrust_norm: HoverThrust
    drag_1_s: Drag = 0.25
    autopilot: (
        Annotated[AutopilotKind, Meta(description="required autopilot; without a value the one of its HEARTBEAT")]
        | None
    ) = None


class ExternalFile(Section, frozen=True):
    """The file of `sitl fly --external`."""

    external_vehicles: Annotated[
        tuple[ReachedVehicle, ...],
        Meta(min_length=1, description="the vehicles; more than the scenario has is allowed"),
    ]


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
