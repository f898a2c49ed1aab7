"""Scenario files: the fleet, its starts, the reference, the simulated world and the timeline of commands of a whole flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, field
from msgspec.structs import replace

from companion.assembly import flyable_problems, trajectory_of
from companion.config.file import convert, read_as
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import checkable
from companion.config.law import LawName
from companion.config.named_files import changed, read_named
from companion.config.planned_flight import (
    HeadingDeg,
    PlannedFlight,
    ShapeName,
    SpacingM,
    fleet_of,
    planned_problems,
    starts_of,
)
from companion.config.reference import KnownReference, Reference, command_problems
from companion.config.shipped import scenario_file
from companion.config.validation import Problem, each, examine, unless_invalid
from companion.config.values import Drag, HoverThrust, Name, PositionM, Section, VehicleId
from companion.core.reference.blend import ReferenceTrajectory
from companion.types.commands import CommandName
from sitl.autopilots.types import parameter_problems
from sitl.vehicle.config import Links, OwnStandIn, StandIn, StandIns

OPERATORS_ONLY = (CommandName.TAKE, CommandName.ABORT)  # they lead to no phase that could be waited for
TO_ALL = (CommandName.LEAD, CommandName.FORMATION, CommandName.REFERENCE)  # they concern the whole fleet
DONE_WITHIN_S, RETURNED_WITHIN_S = 30.0, 300.0


class FormationStep(Section, frozen=True, kw_only=True):
    """The formation of `command: formation`: a slot for each vehicle, or a shape, whose slots are assigned on command.

    shape: name of the shape
    slots_enu_m: the slot of every vehicle by id, instead of a shape
    speed_m_s: speed of the fastest slot half way
    """

    shape: ShapeName | None = None
    spacing_m: SpacingM | None = None
    heading_deg: HeadingDeg = 0.0
    slots_enu_m: dict[VehicleId, PositionM] = field(default_factory=dict)
    speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 1.0


class TimelineStep(Section, frozen=True, kw_only=True):
    """One command: it is sent, the vehicles carry it out, then they stay so for `for_s`.

    command: the command; `take` and `abort` are for operators only
    vehicles: ids of the vehicles; without any, all
    at_s: earliest time of the flight; without a value right after the step before
    leaders: the new leaders, for `command: lead`
    formation: the new slots, for `command: formation`
    reference: the new reference, for `command: reference`
    for_s: time before the next step, once all have done this one
    timeout_s: time in which all must have done it; by default 30 s, `return` 300 s
    may_fail: `true`: the flight goes on when vehicles have answered, or refused until `timeout_s`
    """

    command: CommandName
    vehicles: tuple[VehicleId, ...] = ()
    at_s: Annotated[float, Meta(ge=0, le=36_000)] | None = None
    leaders: tuple[VehicleId, ...] = ()
    formation: FormationStep | None = None
    reference: Reference | None = None
    for_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    timeout_s: Annotated[float, Meta(gt=0, le=600)] | None = None

    may_fail: bool = False

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
            () if step.reference is None else _reference(step.reference, fleet, f"{where}.reference"),
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


def _reference(reference: Reference, fleet: FleetConfig, where: str) -> Iterator[Problem]:
    refused = list(command_problems(reference, where))
    yield from refused or flyable_problems(fleet, reference, where)


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


class Assumed(Section, frozen=True, kw_only=True):
    """Values in the vehicle files, and the hover thrust in the autopilots, where they differ from the true airframe."""

    hover_thrust_norm: HoverThrust | None = None
    drag_1_s: Drag | None = None


class MovingTarget(Section, frozen=True, kw_only=True):
    """A target that moves along a curve and publishes its position and velocity, for a reference that follows it.

    name: name of the target, as a reference names it
    path: the curve
    begins_s: time of the flight at which it begins to move and publish
    ends_s: time of the flight after which it no longer publishes
    """

    name: Name = "main"
    path: KnownReference
    begins_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    ends_s: Annotated[float, Meta(gt=0, le=3600)] = 3600.0


class AgentEnd(Section, frozen=True, kw_only=True):
    """The process of one agent ends: it neither sends nor receives.

    A new one may start, as systemd starts it. It has a new session, knows the height of its take-off alone, and observes.

    at_s: time of the flight
    restarts_after_s: time after the end at which a new agent starts; without it none does
    """

    vehicle: VehicleId
    at_s: Annotated[float, Meta(ge=0, le=36_000)]
    restarts_after_s: Annotated[float, Meta(gt=0, le=36_000)] | None = None

    @property
    def until_s(self) -> float:
        """When the new agent starts; infinity without one."""
        return inf if self.restarts_after_s is None else self.at_s + self.restarts_after_s


class ScenarioFile(PlannedFlight, frozen=True, kw_only=True):
    """A scenario file. Only `fleet.vehicles` (with their slots) and `reference` are required.

    origins_enu_m: origin of the estimator of single stand-ins by id; the default is where each starts
    reference: the trajectory of the formation (RFT); vehicles that may lead get it
    targets: moving targets, for a reference of `kind: target`
    agent_ends: agents whose processes end in flight, and may start again; in virtual time (`sitl run`)
    timeline: the commands in order; the default is prepare, arm, takeoff, form for 60 s, hold, land
    """

    origins_enu_m: dict[VehicleId, PositionM] = field(default_factory=dict)
    reference: Reference
    stand_in: StandIns = StandIns()
    assumed: Assumed = Assumed()
    targets: tuple[MovingTarget, ...] = ()
    links: Links = Links()
    agent_ends: tuple[AgentEnd, ...] = ()
    timeline: tuple[TimelineStep, ...] = STANDARD_TIMELINE


class Scenario(Section, frozen=True, kw_only=True):
    """A scenario with all defaults filled in. Its fields are those of `ScenarioFile`."""

    description: str = ""
    fleet: FleetConfig
    starts_enu_m: Mapping[VehicleId, PositionM]
    origins_enu_m: dict[VehicleId, PositionM] = field(default_factory=dict)
    reference: Reference
    stand_in: StandIns = StandIns()
    assumed: Assumed = Assumed()
    targets: tuple[MovingTarget, ...] = ()
    links: Links = Links()
    agent_ends: tuple[AgentEnd, ...] = ()
    timeline: tuple[TimelineStep, ...]

    def stand_in_of(self, vehicle_id: int) -> StandIn:
        """The stand-in of one vehicle: what all have, with its own keys. `stand_in` alone holds for seed and wind only."""
        return self.stand_in.of(vehicle_id)


def load_scenario(path: Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario file, or a shipped one by its name, and apply overrides "KEY.PATH=VALUE" (a YAML value).

    Raises ConfigError.
    """
    path = scenario_file(path)
    data = read_as(path, "scenario")
    # The file must be valid by itself, so that an error below is an override's.
    scenario = scenario_from(path, read_named(data, path))
    if not overrides:
        return scenario
    example = "fleet.law.name=average_22 or timeline[3].for_s=20"
    return changed(data, overrides, example, lambda named, content: scenario_from(named, read_named(content, path)))


def reference_of(scenario: Scenario) -> ReferenceTrajectory:
    """The RFT as the leaders fly it: seconds since the leader entered formation -> R and r''."""
    return trajectory_of(scenario.reference)


def with_law(scenario: Scenario, law: LawName) -> Scenario:
    """The same scenario under another law."""
    return replace(scenario, fleet=replace(scenario.fleet, law=scenario.fleet.law.with_name(law)))


def scenario_from(path: Path, data: object) -> Scenario:
    """Plain content of a scenario file -> checked scenario; `path` names the file in errors. Raises ConfigError."""
    return _with_defaults(convert(path, data, ScenarioFile, _problems))


def _with_defaults(file: ScenarioFile) -> Scenario:
    fleet = fleet_of(file.fleet)
    starts_enu_m = unless_invalid(lambda: starts_of(file, fleet, file.reference.start_enu_m))
    given = {name: getattr(file, name) for name in ScenarioFile.__struct_fields__}
    return Scenario(**given | {"fleet": fleet, "starts_enu_m": starts_enu_m})


def _problems(file: ScenarioFile) -> Iterator[Problem]:
    scenario = _with_defaults(file)
    yield from planned_problems(file, scenario.fleet, scenario.starts_enu_m)
    scenario = replace(scenario, fleet=checkable(scenario.fleet))
    yield from each(
        _origin(scenario),
        _vehicles_named(scenario),
        _stand_ins(scenario),
        flyable_problems(scenario.fleet, scenario.reference),
        _transport(scenario),
        _target_names(scenario),
        _agent_ends(scenario),
        timeline_problems(scenario.fleet, scenario.timeline),
    )
    yield from _lies(scenario)


def _origin(scenario: Scenario) -> Iterator[Problem]:
    if scenario.fleet.place is None:
        problem = '"indoor" without fleet.external_vision.place; stand-ins need latitude, longitude, altitude'
        yield Problem("fleet.origin", problem)


def _positioning(scenario: Scenario) -> Iterator[Problem]:
    """Poses for stand-ins come from the fleet's motion-capture system alone."""
    by_vision = scenario.fleet.external_vision is not None
    expected = "external_vision" if by_vision else "gps"
    ids = [member.id for member in scenario.fleet.vehicles]
    if others := [i for i in ids if scenario.stand_in_of(i).positioning != expected]:
        given = "given" if by_vision else "not given"
        problem = (
            f"of vehicle {', '.join(map(str, others))}: expected {expected}, because fleet.external_vision is {given}"
        )
        yield Problem("stand_in.positioning", problem)
    for index, fault in enumerate(scenario.stand_in.capture_faults):
        for key, problem in fault.contradictions():
            yield Problem(f"stand_in.capture_faults[{index}].{key}", problem)
        if fault.other is not None and scenario.fleet.member(fault.other) is None:
            yield Problem(f"stand_in.capture_faults[{index}].other", f"no vehicle {fault.other} in the fleet")


def _transport(scenario: Scenario) -> Iterator[Problem]:
    if scenario.links.peer_transport == "tcp" and scenario.fleet.multicast:
        yield Problem(
            "links.peer_transport", "tcp, but fleet.multicast sends states as datagrams; take one of them out"
        )


def _stand_ins(scenario: Scenario) -> Iterator[Problem]:
    common = scenario.stand_in
    of_keys = each(
        parameter_problems(common.autopilot, common.parameters),
        *(_own_keys(common, own, f"stand_in.vehicles.{i}") for i, own in common.vehicles.items()),
    )
    yield from list(of_keys) or _positioning(scenario)


def _own_keys(common: StandIns, own: dict[str, Any], where: str) -> Iterator[Problem]:
    """Those of a single vehicle are checked as those of the whole fleet."""
    checked, problems = examine(own, OwnStandIn, where)
    yield from problems
    if not problems:
        kind = checked.autopilot if "autopilot" in own else common.autopilot
        yield from parameter_problems(kind, checked.parameters, where)


def _target_names(scenario: Scenario) -> Iterator[Problem]:
    names = [target.name for target in scenario.targets]
    for index, name in enumerate(names):
        if name in names[:index]:
            yield Problem(f"targets[{index}].name", f'"{name}" is used twice; give each its own')


def _agent_ends(scenario: Scenario) -> Iterator[Problem]:
    """An agent can end again only after it has started again."""
    ends = sorted(enumerate(scenario.agent_ends), key=lambda numbered: (numbered[1].vehicle, numbered[1].at_s))
    for (_, before), (index, end) in pairwise(ends):
        if end.vehicle == before.vehicle and end.at_s <= before.until_s:
            starts = "does not start again" if before.until_s == inf else f"starts again at {before.until_s:g} s"
            problem = f"the agent of vehicle {end.vehicle} ended at {before.at_s:g} s and {starts}"
            yield Problem(f"agent_ends[{index}].at_s", problem)


def _lies(scenario: Scenario) -> Iterator[Problem]:
    for index, lie in enumerate(scenario.links.lies):
        for key, problem in lie.contradictions():
            yield Problem(f"links.lies[{index}].{key}", problem)
        if lie.other is not None and scenario.fleet.member(lie.other) is None:
            yield Problem(f"links.lies[{index}].other", f"no vehicle {lie.other} in the fleet")


BY_VEHICLE = (
    "stand_in.estimator_resets",
    "stand_in.batteries",
    "stand_in.pilots",
    "stand_in.refusals",
    "stand_in.position_losses",
    "stand_in.failsafes",
    "stand_in.homes",
    "stand_in.rally_points",
    "stand_in.capture_faults",
    "links.late_telemetry",
    "links.lies",
    "agent_ends",
)


def _vehicles_named(scenario: Scenario) -> Iterator[Problem]:
    """Own origins, estimator resets, pilots and all else by vehicle must be those of vehicles of the fleet."""
    named = [(vehicle_id, f"origins_enu_m.{vehicle_id}") for vehicle_id in sorted(scenario.origins_enu_m)]
    named += [
        (vehicle_id, f"stand_in.vehicles.{vehicle_id}")
        for vehicle_id in unless_invalid(lambda: [*scenario.stand_in.vehicles])
    ]
    for key in BY_VEHICLE:
        named += [(item.vehicle, f"{key}[{index}].vehicle") for index, item in enumerate(attrgetter(key)(scenario))]
    for index, partition in enumerate(scenario.links.partitions):
        named += [(vehicle_id, f"links.partitions[{index}].vehicles") for vehicle_id in partition.vehicles]
    for vehicle_id, where in named:
        if scenario.fleet.member(vehicle_id) is None:
            known = ", ".join(str(member.id) for member in scenario.fleet.vehicles)
            yield Problem(where, f"no vehicle {vehicle_id} in the fleet; expected one of {known}")
