"""The timeline of a flight: commands in order, with their vehicles, contents and times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

from msgspec import Meta, field

from companion.assembly import flyable_problems
from companion.config.fleet import FleetConfig
from companion.config.planned_flight import HeadingDeg, ShapeName, SpacingM
from companion.config.reference import Reference
from companion.config.validation import Problem, each
from companion.config.values import PositionM, Section, VehicleId
from companion.types.commands import CommandName

OPERATORS_ONLY = (CommandName.TAKE, CommandName.ABORT)  # they lead to no phase that could be waited for
TO_ALL = (CommandName.LEAD, CommandName.FORMATION, CommandName.REFERENCE)  # they concern the whole fleet
DONE_WITHIN_S, RETURNED_WITHIN_S = 30.0, 300.0


class FormationStep(Section, frozen=True, kw_only=True):
    """The formation of `command: formation`: a slot for each vehicle, or a shape, whose slots are assigned on command."""

    shape: Annotated[ShapeName, Meta(description="name of the shape")] | None = None
    spacing_m: SpacingM | None = None
    heading_deg: HeadingDeg = 0.0
    slots_enu_m: Annotated[
        dict[VehicleId, PositionM], Meta(description="the slot of every vehicle by id, instead of a shape")
    ] = field(default_factory=dict)
    speed_m_s: Annotated[float, Meta(gt=0, le=50, description="speed of the fastest slot half way")] = 1.0


class TimelineStep(Section, frozen=True, kw_only=True):
    """One command: it is sent, the vehicles carry it out, then they stay so for `for_s`."""

    command: Annotated[CommandName, Meta(description="the command; `take` and `abort` are for operators only")]
    vehicles: Annotated[tuple[VehicleId, ...], Meta(description="ids of the vehicles; without any, all")] = ()
    at_s: (
        Annotated[
            float,
            Meta(
                ge=0, le=36_000, description="earliest time of the flight; without a value right after the step before"
            ),
        ]
        | None
    ) = None
    leaders: Annotated[tuple[VehicleId, ...], Meta(description="the new leaders, for `command: lead`")] = ()
    formation: Annotated[FormationStep, Meta(description="the new slots, for `command: formation`")] | None = None
    reference: Annotated[Reference, Meta(description="the new reference, for `command: reference`")] | None = None
    for_s: Annotated[
        float, Meta(ge=0, le=3600, description="time before the next step, once all have done this one")
    ] = 0.0
    timeout_s: (
        Annotated[
            float,
            Meta(gt=0, le=600, description="time in which all must have done it; by default 30 s, `return` 300 s"),
        ]
        | None
    ) = None

    may_fail: Annotated[
        bool, Meta(description="`true`: the flight goes on when vehicles have answered, or refused until `timeout_s`")
    ] = False

    @property
    def patience_s(self) -> float:
        """Time in which all vehicles must have done it. A return takes a climb, the way home and a landing."""
        if self.timeout_s is not None:
            return self.timeout_s
        return RETURNED_WITHIN_S if self.command is CommandName.RETURN else DONE_WITHIN_S

    def in_words(self) -> str:
        """The command with its content: "land 3", "lead 2", "formation circle", "reference target"."""
        kind = self.reference.__struct_config__.tag if self.reference else ""
        shape = (self.formation.shape or "slots") if self.formation else ""
        return " ".join([self.command, *map(str, self.vehicles or self.leaders), *filter(None, (shape, str(kind)))])


STANDARD_TIMELINE = (
    TimelineStep(command=CommandName.PREPARE),
    TimelineStep(command=CommandName.ARM),
    TimelineStep(command=CommandName.TAKEOFF, for_s=3.0),
    TimelineStep(command=CommandName.FORM, for_s=60.0),
    TimelineStep(command=CommandName.HOLD, for_s=2.0),
    TimelineStep(command=CommandName.LAND),
)


def timeline_problems(fleet: FleetConfig, timeline: Sequence[TimelineStep]) -> Iterator[Problem]:
    """All that is wrong between the fields of the steps, and with the order of their times."""
    if not len(timeline):
        yield Problem("timeline", "is empty; list at least one step with a command")
    for index, step in enumerate(timeline):
        where = f"timeline[{index}]"
        yield from each(
            _command(step, where),
            _vehicles(step, fleet, f"{where}.vehicles"),
            _leaders(step, fleet, f"{where}.leaders"),
            _contents(step, where),
            () if step.formation is None else _formation(step.formation, fleet, f"{where}.formation"),
            () if step.reference is None else flyable_problems(fleet, step.reference, f"{where}.reference"),
        )
    yield from each(_order(timeline))


def _command(step: TimelineStep, where: str) -> Iterator[Problem]:
    if step.command in OPERATORS_ONLY:
        expected = ", ".join(name for name in CommandName if name not in OPERATORS_ONLY)
        yield Problem(f"{where}.command", f"{step.command} is an operator's; expected {expected}")


def _contents(step: TimelineStep, where: str) -> Iterator[Problem]:
    if (step.command == CommandName.FORMATION) is (step.formation is None):
        yield Problem(f"{where}.formation", "goes with command: formation, and with no other")
    if (step.command == CommandName.REFERENCE) is (step.reference is None):
        yield Problem(f"{where}.reference", "goes with command: reference, and with no other")


def _formation(step: FormationStep, fleet: FleetConfig, where: str) -> Iterator[Problem]:
    if (step.shape is None) is not bool(step.slots_enu_m):
        yield Problem(where, "expected either a shape with its spacing_m, or slots_enu_m")
    elif step.shape is not None and step.spacing_m is None:
        yield Problem(f"{where}.spacing_m", f"missing; {step.shape} needs it")
    ids = {member.id for member in fleet.vehicles}
    if step.slots_enu_m and (unequal := sorted(ids ^ step.slots_enu_m.keys())):
        known = ", ".join(str(i) for i in sorted(ids))
        yield Problem(f"{where}.slots_enu_m.{unequal[0]}", f"expected a slot for each of {known}, and no other")


def _order(timeline: Sequence[TimelineStep]) -> Iterator[Problem]:
    begun_s = 0.0
    for index, step in enumerate(timeline):
        if step.at_s is not None and step.at_s < begun_s:
            problem = f"{step.at_s:g}: expected at least {begun_s:g}, when a step before begins"
            yield Problem(f"timeline[{index}].at_s", problem)
        begun_s = step.at_s if step.at_s is not None else begun_s


def _vehicles(step: TimelineStep, fleet: FleetConfig, where: str) -> Iterator[Problem]:
    if step.vehicles and step.command in TO_ALL:
        yield Problem(where, f"{step.command} is for the whole fleet; take it out")
    for vehicle_id in step.vehicles:
        if fleet.member(vehicle_id) is None:
            known = ", ".join(str(member.id) for member in fleet.vehicles)
            yield Problem(where, f"no vehicle {vehicle_id} in the fleet; expected some of {known}")


def _leaders(step: TimelineStep, fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """Only `lead` names leaders, and only vehicles that may lead."""
    if step.command != CommandName.LEAD:
        if step.leaders:
            yield Problem(where, f"{list(step.leaders)}: {step.command} takes no leaders; take it out")
        return
    may_lead = sorted(member.id for member in fleet.vehicles if member.can_lead)
    expected = ", ".join(str(i) for i in may_lead)
    if not step.leaders:
        yield Problem(where, f"missing; lead needs the ids of the new leaders, some of {expected}")
    for vehicle_id in step.leaders:
        if vehicle_id not in may_lead:
            hint = "" if fleet.member(vehicle_id) is None else f", or may_lead: true for vehicle {vehicle_id}"
            yield Problem(
                where, f"{list(step.leaders)}: vehicle {vehicle_id} may not lead; expected some of {expected}{hint}"
            )
