"""The configuration of an agent in the header of its recording: fleet file and vehicle file as JSON, with all defaults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from companion.config.file import SET, ConfigError, convert, overridden
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import fleet_problems
from companion.config.validation import Problem, each
from companion.config.values import Section
from companion.config.vehicle import AgentConfig, VehicleConfig, membership_problems
from companion.recording.codec import DECODE_ERRORS
from companion.recording.records import Header

EXAMPLE = "fleet.law.name=average_22 or vehicle.drag_1_s=0.3"


class _Files(Section, frozen=True):
    fleet: FleetConfig
    vehicle: VehicleConfig


def as_json(file: FleetConfig | VehicleConfig) -> str:
    """For a header. The paths in a vehicle file are part of it; nothing that they name is."""
    return msgspec.json.encode(file).decode()


def recorded_fleet(path: Path, header: Header) -> FleetConfig:
    """The fleet file of a recording; `path` names the recording in errors. Raises ConfigError."""
    return convert(path, _plain(path, header.fleet_file, "fleet file"), FleetConfig, fleet_problems)


def recorded_config(path: Path, header: Header, overrides: Sequence[str] = ()) -> AgentConfig:
    """The configuration of a recorded agent, with overrides "fleet.KEY=VALUE" and "vehicle.KEY=VALUE".

    `path` names the recording in errors. Nothing that a vehicle file names is opened. Raises ConfigError.
    """
    files = {
        "fleet": _plain(path, header.fleet_file, "fleet file"),
        "vehicle": _plain(path, header.vehicle_file, "vehicle file"),
    }
    config = _checked(path, files, header.vehicle_id)
    if not overrides:
        return config
    return _checked(SET, overridden(files, overrides, EXAMPLE), header.vehicle_id)


def _plain(path: Path, text: str, what: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except DECODE_ERRORS as error:
        raise ConfigError(path, "", f"its {what} is not valid JSON") from error


def _checked(path: Path, files: dict[str, Any], vehicle_id: int) -> AgentConfig:
    def problems(read: _Files) -> Iterator[Problem]:
        yield from fleet_problems(read.fleet, "fleet.")
        yield from each(_of_vehicle(read.vehicle, read.fleet, vehicle_id))

    read = convert(path, files, _Files, problems)
    member = read.fleet.member(vehicle_id)
    assert member is not None, "a vehicle without a slot is a problem of its file"
    return AgentConfig(read.vehicle, read.fleet, member)


def _of_vehicle(vehicle: VehicleConfig, fleet: FleetConfig, vehicle_id: int) -> Iterator[Problem]:
    if vehicle.id != vehicle_id:
        yield Problem("vehicle.id", f"{vehicle.id} is not the vehicle that was recorded; expected {vehicle_id}")
    for problem in membership_problems(vehicle, fleet, Path("fleet")):
        yield Problem(f"vehicle.{problem.field}", problem.text)
