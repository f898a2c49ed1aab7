"""Scenario files: the fleet, where the vehicles stand, the reference, the world and the timeline of a whole flight."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml
from msgspec import field

from companion.assembly import trajectory_of
from companion.config.fleet import FleetConfig, check_fleet, check_starts
from companion.config.kind import read_as
from companion.config.reference import Reference, check_reference
from companion.config.values import Drag, HoverThrust, PositionM, Section, VehicleId
from companion.config_file import ConfigError, StrictLoader, convert
from companion.core.reference import ReferenceTrajectory
from sitl.autopilot_file import check_parameters
from sitl.config import Links, StandIn
from sitl.moving_targets import MovingTarget
from sitl.timeline import TimelineStep, check_timeline

SET = Path("--set")  # stands where errors name a file
LONGEST_KEY = 200  # of --set


class Believed(Section, frozen=True, kw_only=True):
    """What vehicle files say of the airframe, and the autopilot of its hover thrust; None leaves that as it is."""

    hover_thrust_norm: HoverThrust | None = None
    drag_1_s: Drag | None = None


class Scenario(Section, frozen=True, kw_only=True):
    """`fleet` is what a fleet file holds; `reference` (RFT) goes into the files of those that may lead, and into no other.

    `origins_enu_m` puts own origins of stand-ins elsewhere than where they start. `links` is of flights in virtual time; real
    processes have links of their own. `targets` move about and tell of themselves, for a reference that follows one.
    """

    description: str = ""
    fleet: FleetConfig
    starts_enu_m: dict[VehicleId, PositionM]
    origins_enu_m: dict[VehicleId, PositionM] = field(default_factory=dict)
    reference: Reference
    stand_in: StandIn = StandIn()
    believed: Believed = Believed()
    targets: tuple[MovingTarget, ...] = ()
    links: Links = Links()
    timeline: tuple[TimelineStep, ...]


def load_scenario(path: Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario file and put overrides "KEY.PATH=VALUE" (a YAML value) into it. Raises ConfigError."""
    data = read_as(path, "scenario")
    scenario = scenario_from(path, data)  # the file must be right by itself, so that an error below is an override's
    if not overrides:
        return scenario
    data = deepcopy(data)
    for override in overrides:
        _put(data, override)
    return scenario_from(SET, data)


def reference_of(scenario: Scenario) -> ReferenceTrajectory:
    """The RFT as the leaders fly it: seconds since the leader entered formation -> R and r''."""
    return trajectory_of(scenario.reference)


def scenario_from(path: Path, data: object) -> Scenario:
    """Plain content of a scenario file -> checked scenario; `path` names the file in errors. Raises ConfigError."""
    scenario = convert(path, data, Scenario)
    check_fleet(path, scenario.fleet, "fleet.")
    if scenario.fleet.origin == "indoor":
        raise ConfigError(
            path,
            "fleet.origin",
            '"indoor" is for one motion-capture frame; stand-ins need latitude, longitude, altitude',
        )
    check_starts(path, scenario.fleet, scenario.starts_enu_m)
    _check_vehicles_named(path, scenario)
    check_parameters(path, scenario.stand_in)
    check_reference(path, scenario.fleet, scenario.reference)
    names = [target.name for target in scenario.targets]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ConfigError(path, f"targets[{index}].name", f'"{name}" is used twice; give each its own')
    check_timeline(path, scenario.fleet, scenario.timeline)
    return scenario


def _check_vehicles_named(path: Path, scenario: Scenario) -> None:
    """Own origins, resets and batteries are of vehicles of the fleet. Raises ConfigError."""
    named = [(vehicle_id, f"origins_enu_m.{vehicle_id}") for vehicle_id in sorted(scenario.origins_enu_m)]
    for index, reset in enumerate(scenario.stand_in.estimator_resets):
        named.append((reset.vehicle, f"stand_in.estimator_resets[{index}].vehicle"))
    for index, level in enumerate(scenario.stand_in.batteries):
        named.append((level.vehicle, f"stand_in.batteries[{index}].vehicle"))
    for vehicle_id, where in named:
        if scenario.fleet.member(vehicle_id) is None:
            known = ", ".join(str(member.id) for member in scenario.fleet.vehicles)
            raise ConfigError(path, where, f"no vehicle {vehicle_id} in the fleet; expected one of {known}")


def _put(data: Any, override: str) -> None:
    """Set one value in a scenario's plain content; sections that are missing are made. Raises ConfigError."""
    field, equals, text = override.partition("=")
    steps = _steps(field) if len(field) <= LONGEST_KEY else []  # Python refuses to read a number of thousands of digits
    if not equals or not steps:
        raise ConfigError(SET, override, "expected KEY=VALUE, like fleet.law.name=average_22 or timeline[3].for_s=20")
    try:
        value = yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise ConfigError(SET, field, f"{text!r} is not a YAML value") from error
    node, place = data, ""
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        _check_step(node, place, step)
        if following is None:
            node[step] = value
        elif isinstance(node, dict):
            node = node.setdefault(step, {})
        else:
            node = node[step]
        place = f"{place}[{step}]" if isinstance(step, int) else f"{place}.{step}".lstrip(".")


def _steps(field: str) -> list[str | int]:
    """ "timeline[3].for_s" -> ["timeline", 3, "for_s"]; a bare number is a number, too (starts_enu_m.1)."""
    if not re.fullmatch(r"\w+(\.\w+|\[\d+\])*", field):
        return []
    return [int(step) if step.isdecimal() else step for step in re.findall(r"\w+", field)]


def _check_step(node: Any, place: str, step: str | int) -> None:
    if isinstance(node, dict):
        return
    if not isinstance(node, list):
        raise ConfigError(SET, place, f"is {node!r}, which has no keys inside; set it as a whole")
    if not isinstance(step, int):
        raise ConfigError(
            SET, f"{place}.{step}", f"{place} is a list; expected a number, {place}[0] to [{len(node) - 1}]"
        )
    if step >= len(node):
        raise ConfigError(SET, f"{place}[{step}]", f"no such item; expected {place}[0] to [{len(node) - 1}]")
