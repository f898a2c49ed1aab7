"""A flight's commands, in turn: to whom, what goes with them, and when."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from companion.config.fleet import FleetConfig
from companion.config.reference import Reference, check_reference
from companion.config.values import Section, VehicleId
from companion.config_file import ConfigError
from companion.types import CommandName

OPERATORS_ONLY = (CommandName.TAKE, CommandName.ABORT)  # they lead to no phase that could be waited for
TO_ALL = (CommandName.LEAD, CommandName.FORMATION, CommandName.REFERENCE)  # they mean the whole fleet
DONE_WITHIN_S, RETURNED_WITHIN_S = 30.0, 300.0


class NamedFormation(Section, frozen=True, kw_only=True):
    """Slots by the name of a shape; whose is which is chosen when it is commanded. `heading_deg` is 0 to the east, 90 north.

    `speed_m_s` is the fastest slot's, half way.
    """

    shape: Literal["line", "column", "v", "diamond", "rectangle", "circle", "grid", "layers"]
    spacing_m: Annotated[float, Meta(gt=0, le=1000)]
    heading_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 1.0


class TimelineStep(Section, frozen=True, kw_only=True):
    """Give a command to every vehicle, or to `vehicles` alone, wait until they have done it, then stay so for `for_s`.

    With `at_s` it is given at that time of the flight, at the earliest, and else when the step before has stayed its time.
    They must have done it within `timeout_s`, by default 30 s, of `return` 300 s.
    `leaders` goes with `command: lead`: who leads from then on. `formation` goes with `command: formation`, `reference` with
    `command: reference`.
    """

    command: CommandName
    vehicles: tuple[VehicleId, ...] = ()
    at_s: Annotated[float, Meta(ge=0, le=36_000)] | None = None
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
        """The command with what goes with it: "land 3", "lead 2", "formation circle", "reference target"."""
        kind = self.reference.__struct_config__.tag if self.reference else ""
        shape = self.formation.shape if self.formation else ""
        return " ".join([self.command, *map(str, self.vehicles or self.leaders), *filter(None, (shape, str(kind)))])


def check_timeline(path: Path, fleet: FleetConfig, timeline: Sequence[TimelineStep]) -> None:
    """What no single field can say. Raises ConfigError."""
    if not timeline:
        raise ConfigError(path, "timeline", "is empty; list at least one step with a command")
    begun_s = 0.0
    for index, step in enumerate(timeline):
        where = f"timeline[{index}]"
        if step.command in OPERATORS_ONLY:
            expected = ", ".join(name for name in CommandName if name not in OPERATORS_ONLY)
            raise ConfigError(path, f"{where}.command", f"{step.command} is an operator's; expected {expected}")
        _check_vehicles(path, f"{where}.vehicles", step, fleet)
        _check_leaders(path, f"{where}.leaders", step, fleet)
        if (step.command is CommandName.FORMATION) is (step.formation is None):
            raise ConfigError(path, f"{where}.formation", "goes with command: formation, and with no other")
        if (step.command is CommandName.REFERENCE) is (step.reference is None):
            raise ConfigError(path, f"{where}.reference", "goes with command: reference, and with no other")
        if step.reference is not None:
            check_reference(path, fleet, step.reference, where=f"{where}.")
        if step.at_s is not None and step.at_s < begun_s:
            raise ConfigError(
                path, f"{where}.at_s", f"{step.at_s:g}: expected at least {begun_s:g}, when a step before begins"
            )
        begun_s = step.at_s if step.at_s is not None else begun_s


def _check_vehicles(path: Path, where: str, step: TimelineStep, fleet: FleetConfig) -> None:
    if step.vehicles and step.command in TO_ALL:
        raise ConfigError(path, where, f"{step.command} is for the whole fleet; take it out")
    for vehicle_id in step.vehicles:
        if fleet.member(vehicle_id) is None:
            known = ", ".join(str(member.id) for member in fleet.vehicles)
            raise ConfigError(path, where, f"no vehicle {vehicle_id} in the fleet; expected some of {known}")


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
