"""A file with the slots of a formation that is no named shape, for `companion fleet formation --slots`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.file import convert, refuse
from companion.config.fleet import FleetConfig
from companion.config.kind import read_as
from companion.config.validation import Problem
from companion.config.values import PositionM, Section, VehicleId
from companion.types.values import Vector3


class SlotsSection(Section, frozen=True):
    """The slot of every vehicle of the fleet."""

    slots_enu_m: Annotated[dict[VehicleId, PositionM], Meta(description="d_i0 of eq. 12 by vehicle id")]


def load_slots(path: Path, fleet: FleetConfig) -> dict[int, Vector3]:
    """Slot by vehicle id, one for each vehicle of the fleet. Raises ConfigError."""
    section = convert(path, read_as(path, "slots"), SlotsSection, lambda section: _problems(section.slots_enu_m, fleet))
    return dict(section.slots_enu_m)


def check_slots(source: Path, slots_enu_m: Mapping[int, Vector3], fleet: FleetConfig) -> None:
    """`source` is named in errors. Raises ConfigError."""
    refuse(source, _problems(slots_enu_m, fleet))


def _problems(slots_enu_m: Mapping[int, Vector3], fleet: FleetConfig) -> Iterator[Problem]:
    ids = {member.id for member in fleet.vehicles}
    known = ", ".join(str(i) for i in sorted(ids))
    for vehicle_id in sorted(ids ^ slots_enu_m.keys()):
        problem = "missing" if vehicle_id in ids else "no such vehicle in the fleet"
        yield Problem(f"slots_enu_m.{vehicle_id}", f"{problem}; expected a slot for each of {known}")
