"""Scenario files: the fleet, where the vehicles stand, the reference, the world and the timeline of a whole flight."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from msgspec import Meta, field

from companion.assembly import trajectory_of
from companion.config.fleet import FleetConfig, check_fleet, check_starts
from companion.config.kind import read_as
from companion.config.reference import Reference, check_reference
from companion.config.values import Drag, HoverThrust, PositionM, Section, VehicleId
from companion.config_file import ConfigError, StrictLoader, convert
from companion.core.reference import ReferenceTrajectory
from companion.types import CommandName
from sitl.autopilot_file import check_parameters
from sitl.config import Links, StandIn
from sitl.moving_targets import MovingTarget

SET = Path("--set")  # stands where errors name a file
OPERATORS_ONLY = (CommandName.TAKE, CommandName.ABORT)  # they lead to no phase that could be waited for
DONE_WITHIN_S, RETURNED_WITHIN_S = 30.0, 300.0
LONGEST_KEY = 200  # of --set


class NamedFormation(Section, frozen=True, kw_only=True):
    """Slots by the name of a shape; whose is which is chosen when it is commanded. `heading_deg` is 0 to the east, 90 north.

    `speed_m_s` is the fastest slot's, half way.
    """

    shape: Literal["line", "column", "v", "diamond", "rectangle", "circle", "grid", "layers"]
    spacing_m: Annotated[float, Meta(gt=0, le=1000)]
    heading_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 1.0


class TimelineStep(Section, frozen=True, kw_only=True):
    """Give a command to every vehicle, wait until all have done it, then stay so for `for_s`.

    All must have done it within `timeout_s`, by default 30 s, of `return` 300 s.
    `leaders` goes with `command: lead`: who leads from then on. `formation` goes with `command: formation`, `reference` with
    `command: reference`.
    """

    command: CommandName
    leaders: tuple[VehicleId, ...] = ()
    formation: NamedFormation | None = None
    reference: Reference | None = None
    for_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    timeout_s: Annotated[float, Meta(gt=0, le=600)] | None = None

    @property
    def patience_s(self) -> float:
        """How long all vehicles may take for it. To return takes climbing, the way home and landing from there."""
        if self.timeout_s is not None:
            return self.timeout_s
        return RETURNED_WITHIN_S if self.command is CommandName.RETURN else DONE_WITHIN_S

    def in_words(self) -> str:
        """The command with what goes with it: "lead 2", "formation circle", "reference target"."""
        kind = self.reference.__struct_config__.tag if self.reference else ""
        shape = self.formation.shape if self.formation else ""
        return " ".join([self.command, *map(str, self.leaders), *filter(None, (shape, str(kind)))])


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
    if not scenario.timeline:
        raise ConfigError(path, "timeline", "is empty; list at least one step with a command")
    for index, step in enumerate(scenario.timeline):
        if step.command in OPERATORS_ONLY:
            expected = ", ".join(name for name in CommandName if name not in OPERATORS_ONLY)
            raise ConfigError(
                path, f"timeline[{index}].command", f"{step.command} is an operator's; expected {expected}"
            )
        _check_leaders(path, f"timeline[{index}].leaders", step, scenario.fleet)
        if (step.command is CommandName.FORMATION) is (step.formation is None):
            raise ConfigError(path, f"timeline[{index}].formation", "goes with command: formation, and with no other")
        if (step.command is CommandName.REFERENCE) is (step.reference is None):
            raise ConfigError(path, f"timeline[{index}].reference", "goes with command: reference, and with no other")
        if step.reference is not None:
            check_reference(path, scenario.fleet, step.reference, where=f"timeline[{index}].")
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


def _check_leaders(path: Path, where: str, step: TimelineStep, fleet: FleetConfig) -> None:
    """Only `lead` names leaders, and only such as may lead. Raises ConfigError."""
    may_lead = sorted(member.id for member in fleet.vehicles if member.can_lead)
    expected = ", ".join(str(i) for i in may_lead)
    if step.command is not CommandName.LEAD:
        if step.leaders:
            raise ConfigError(path, where, f"{list(step.leaders)}: {step.command} takes no leaders; take it out")
        return
    if not step.leaders:
        raise ConfigError(path, where, f"missing; lead needs the ids of the new leaders, some of {expected}")
    for vehicle_id in step.leaders:
        if vehicle_id not in may_lead:
            hint = "" if fleet.member(vehicle_id) is None else f", or may_lead: true for vehicle {vehicle_id}"
            raise ConfigError(
                path,
                where,
                f"{list(step.leaders)}: vehicle {vehicle_id} may not lead; expected some of {expected}{hint}",
            )


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
