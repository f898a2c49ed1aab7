"""Scenario files: the fleet, where the vehicles stand, the reference, the world and the timeline of a whole flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from companion.config import FleetConfig, PositionM, Reference, VehicleId, check_fleet
from companion.config_file import ConfigError, convert
from companion.types import CommandName
from sitl.config import StandIn


class TimelineStep(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Give a command to every vehicle, wait until all have done it, then stay so for `for_s`."""

    command: CommandName
    for_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    timeout_s: Annotated[float, Meta(gt=0, le=600)] = 30.0


class Scenario(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`fleet` is what a fleet file holds; `reference` (RFT) goes into the leaders' vehicle files alone."""

    description: str = ""
    fleet: FleetConfig
    starts_enu_m: dict[VehicleId, PositionM]
    reference: Reference
    stand_in: StandIn = StandIn()
    timeline: tuple[TimelineStep, ...]


def scenario_from(path: Path, data: object) -> Scenario:
    """Plain content of a scenario file -> checked scenario; `path` names the file in errors. Raises ConfigError."""
    scenario = convert(path, data, Scenario)
    check_fleet(path, scenario.fleet, "fleet.")
    if scenario.fleet.origin == "local":
        raise ConfigError(path, "fleet.origin", '"local" is for one shared indoor frame; stand-ins need latitude, longitude, altitude')
    ids = {member.id for member in scenario.fleet.vehicles}
    for vehicle_id in sorted(ids - scenario.starts_enu_m.keys()):
        raise ConfigError(path, f"starts_enu_m.{vehicle_id}", "missing; every vehicle needs a place to start from")
    for vehicle_id in sorted(scenario.starts_enu_m.keys() - ids):
        known = ", ".join(str(i) for i in sorted(ids))
        raise ConfigError(path, f"starts_enu_m.{vehicle_id}", f"no such vehicle in the fleet; expected {known}")
    if not scenario.timeline:
        raise ConfigError(path, "timeline", "is empty; list at least one step with a command")
    return scenario
