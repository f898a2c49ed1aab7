"""A file with the slots of a formation that is no named shape, for `companion fleet formation --slots`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.file import convert
from companion.config.fleet import FleetConfig
from companion.config.kind import read_as
from companion.config.validation import Problem
from companion.config.values import PositionM, Section, VehicleId
from companion.types.vectors import Vector3


class SlotsSection(Section, frozen=True):
    """The slot of every vehicle of the fleet."""

    slots_enu_m: Annotated[dict[VehicleId, PositionM], Meta(description="d_i0 of eq. 12 by vehicle id")]


def load_slots(path: Path, fleet: FleetConfig) -> dict[int, Vector3]:
    """Slot by vehicle id, one for each vehicle of the fleet. Raises ConfigError."""
    ids = {member.id for member in fleet.vehicles}

    def problems(section: SlotsSection) -> Iterator[Problem]:
        known = ", ".join(str(i) for i in sorted(ids))
        for vehicle_id in sorted(ids ^ section.slots_enu_m.keys()):
            problem = "missing" if vehicle_id in ids else "no such vehicle in the fleet"
            yield Problem(f"slots_enu_m.{vehicle_id}", f"{problem}; expected a slot for each of {known}")

    return dict(convert(path, read_as(path, "slots"), SlotsSection, problems).slots_enu_m)
