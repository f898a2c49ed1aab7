"""A file of slots: a formation that is no named shape, for `companion fleet formation --slots`."""

from __future__ import annotations

from pathlib import Path

from companion.config.fleet import FleetConfig
from companion.config.kind import read_as
from companion.config.values import PositionM, Section, VehicleId
from companion.config_file import ConfigError, convert
from companion.types import Vector3


class SlotsSection(Section, frozen=True):
    """d_i0 of eq. 12 for every vehicle."""

    slots_enu_m: dict[VehicleId, PositionM]


def load_slots(path: Path, fleet: FleetConfig) -> dict[int, Vector3]:
    """Raises ConfigError, also where a vehicle of the fleet has none, or one has that is not of the fleet."""
    slots_enu_m = convert(path, read_as(path, "slots"), SlotsSection).slots_enu_m
    ids = {member.id for member in fleet.vehicles}
    known = ", ".join(str(i) for i in sorted(ids))
    for vehicle_id in sorted(ids ^ slots_enu_m.keys()):
        problem = "missing" if vehicle_id in ids else "no such vehicle in the fleet"
        raise ConfigError(path, f"slots_enu_m.{vehicle_id}", f"{problem}; expected a slot for each of {known}")
    return dict(slots_enu_m)
