"""The input of `companion analyze`: what of a scenario file or a fleet file the analysis reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, field, structs

from companion.analysis.pace import unreached
from companion.analysis.response import (
    AUTOPILOT_STEP_S,
    ON_BOARD_S,
    SPARE_S,
    TICK_S,
    USUAL_DRAG_1_S,
    USUAL_LINK_S,
    LinearModel,
    VehicleKind,
    flown_model,
)
from companion.assembly import flyable_problems
from companion.config.degrees import degree_notices
from companion.config.file import convert, kind_of_file, read_as
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import fleet_problems
from companion.config.named_files import changed, read_named
from companion.config.planned_flight import PlannedFlight, fleet_of, planned_problems, starts_of
from companion.config.reference import Reference
from companion.config.validation import INVALID, Problem, each, examine, unless_invalid
from companion.config.values import VehicleId, overlaid
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Notice
from companion.types.values import ZERO3, Vector3

# Sections of a scenario that are not read, as they are named: of two some keys are read.
NOT_READ = {
    "origins_enu_m": "origins_enu_m",
    "stand_in": "stand_in but its autopilot, mass and drag",
    "assumed": "assumed",
    "targets": "targets",
    "links": "links but their delays and peer_loss",
    "timeline": "timeline",
    "agent_ends": "agent_ends",
}
USUAL_KIND = VehicleKind(AutopilotKind.PX4, USUAL_DRAG_1_S)
STEP_M = 1.0  # step of the reference that is predicted for a fleet file, which has no start positions
DelaySeconds = Annotated[float, Meta(ge=0, le=1)]


class _OfLinks(Struct, frozen=True):
    telemetry_delay_s: DelaySeconds = 0.0003
    setpoint_delay_s: DelaySeconds = 0.0005
    peer_delay_s: DelaySeconds = USUAL_LINK_S
    peer_jitter_s: DelaySeconds = 0.0
    peer_loss: Annotated[float, Meta(ge=0, lt=1)] = 0.0

    @property
    def link_s(self) -> float:
        """On average."""
        return self.peer_delay_s + 0.5 * self.peer_jitter_s

    @property
    def pass_on_s(self) -> float:
        """From a motion of a vehicle to the tick in which its neighbours know of it, on average."""
        return self.link_s + TICK_S * (0.5 + self.peer_loss / (1.0 - self.peer_loss))

    @property
    def on_board_s(self) -> float:
        return AUTOPILOT_STEP_S + self.telemetry_delay_s + self.setpoint_delay_s


class _OfAirframe(Struct, frozen=True):
    mass_kg: Annotated[float, Meta(gt=0)] = 1.0
    drag_n_per_m_s: Annotated[float, Meta(ge=0)] = USUAL_DRAG_1_S


class _OfStandIn(Struct, frozen=True):
    autopilot: AutopilotKind = AutopilotKind.PX4
    vehicles: dict[VehicleId, dict[str, Any]] = {}


class _ScenarioPart(PlannedFlight, frozen=True, kw_only=True):
    """A scenario. The fields of type Any belong to the flight; `_parts` reads some keys of two of them."""

    reference: Reference | None = None
    origins_enu_m: Any = None
    stand_in: Any = None
    assumed: Any = None
    targets: Any = None
    links: Any = None
    timeline: Any = None
    agent_ends: Any = None


class Subject(Struct, frozen=True, kw_only=True):
    """Input of the analysis: a fleet, its start positions and the position of its reference.

    `kinds`: the kinds of its vehicles, each with the lowest id of one. The analysis is of a fleet of the first.
    `looks_wrong`: what of the file is probably meant otherwise.
    """

    file: Path
    fleet: FleetConfig
    starts_enu_m: Mapping[int, Vector3]
    reference_enu_m: Vector3
    reference_moves: bool = False
    link_s: float = USUAL_LINK_S  # between its agents
    pass_on_s: float = USUAL_LINK_S + 0.5 * TICK_S  # and until a motion is known one hop further
    on_board_s: float = ON_BOARD_S
    kinds: dict[VehicleKind, int] = field(default_factory=lambda: {USUAL_KIND: 1})
    not_read: Sequence[str] = ()
    settings: Sequence[str] = ()
    looks_wrong: Sequence[Notice] = ()

    @property
    def kind(self) -> VehicleKind:
        """That of all vehicles, as they are analysed."""
        return next(iter(self.kinds))

    @property
    def flying_enu_m(self) -> dict[int, Vector3]:
        """Positions at the beginning of the formation."""
        return _flying_at(self.starts_enu_m, self.fleet)

    def model(self, link_s: float) -> LinearModel:
        """The model of its vehicles with this link."""
        return flown_model(self.kind.autopilot, link_s, self.kind.drag_1_s, self.on_board_s)

    @property
    def least_margin_s(self) -> float:
        """The delay margin that its law must have."""
        return self.model(self.link_s).delay_s + SPARE_S


def load_subject(path: Path, overrides: Sequence[str] = ()) -> Subject:
    """The subject of a scenario file, or of a fleet file, with overrides "KEY.PATH=VALUE" (a YAML value).

    In a fleet file the vehicles start in formation, STEP_M behind the reference. Raises ConfigError.
    """
    data = read_as(path, "scenario", "fleet")
    # The file must be valid by itself, so that an error below is an override's.
    subject = subject_of(path, read_named(data, path))
    if not overrides:
        return subject
    example = "fleet.law.name=average_22, or law.name=average_22 in a fleet file"
    subject = changed(data, overrides, example, lambda named, content: subject_of(named, read_named(content, path)))
    return structs.replace(subject, file=path, settings=tuple(overrides))


def subject_of(path: Path, data: Any) -> Subject:
    """The subject of the content of a file. `path` names it in errors. Raises ConfigError."""
    if kind_of_file(data) != "scenario" and not (isinstance(data, dict) and "fleet" in data):
        fleet = convert(path, data, FleetConfig, fleet_problems)
        starts = {member.id: member.slot_enu_m for member in fleet.vehicles}
        reference_enu_m, not_read = _a_step(fleet), _not_read(data, fleet, "")
        return Subject(
            file=path,
            fleet=fleet,
            starts_enu_m=starts,
            reference_enu_m=reference_enu_m,
            not_read=not_read,
            looks_wrong=list(degree_notices(fleet.origin, fleet)),
        )
    part = convert(path, data, _ScenarioPart, _problems)
    fleet, links = fleet_of(part.fleet), _read(part.links, _OfLinks, "links")[0]
    places = {"fleet": fleet, "starts_enu_m": part.starts_enu_m, "reference": part.reference}
    return Subject(
        file=path,
        fleet=fleet,
        starts_enu_m=_starts(part, fleet),
        reference_enu_m=part.reference.start_enu_m if part.reference else _a_step(fleet),
        reference_moves=part.reference is not None and part.reference.MOVES,
        link_s=links.link_s,
        pass_on_s=links.pass_on_s,
        on_board_s=links.on_board_s,
        kinds=_kinds(part, fleet),
        not_read=_not_read(data, fleet, "fleet."),
        looks_wrong=list(degree_notices(fleet.origin, places)),
    )


def _kinds(part: _ScenarioPart, fleet: FleetConfig) -> dict[VehicleKind, int]:
    """What its checked stand-ins are like, each with the lowest id of one."""
    own = _read(part.stand_in, _OfStandIn, "")[0].vehicles
    kinds: dict[VehicleKind, int] = {}
    for vehicle_id in sorted(member.id for member in fleet.vehicles):
        section = overlaid(part.stand_in or {}, own.get(vehicle_id, {}))
        autopilot = _read(section, _OfStandIn, "")[0].autopilot
        airframe = _read(section.get("airframe"), _OfAirframe, "")[0]
        kinds.setdefault(VehicleKind(autopilot, airframe.drag_n_per_m_s / airframe.mass_kg), vehicle_id)
    return kinds


def _stand_in_problems(section: Any, where: str) -> Iterator[Problem]:
    """What is wrong with what is read of the stand-ins, or of one."""
    stand_in, problems = _read(section, _OfStandIn, where)
    yield from problems
    if isinstance(section, dict):
        yield from _read(section.get("airframe"), _OfAirframe, f"{where}.airframe")[1]
    for vehicle_id, own in stand_in.vehicles.items():
        yield from _stand_in_problems(own, f"{where}.vehicles.{vehicle_id}")


def _read(section: Any, type_: type[Struct], where: str) -> tuple[Any, list[Problem]]:
    """The keys of this type; other keys belong to the flight. Its defaults where there is no section."""
    if isinstance(section, dict):
        section = {key: value for key, value in section.items() if key in type_.__struct_fields__}
    return examine({} if section is None else section, type_, where)


def _starts(part: _ScenarioPart, fleet: FleetConfig) -> Mapping[int, Vector3]:
    return starts_of(part, fleet, part.reference.start_enu_m if part.reference else ZERO3)


def _problems(part: _ScenarioPart) -> Iterator[Problem]:
    yield from _read(part.links, _OfLinks, "links")[1]
    yield from each(_stand_in_problems(part.stand_in, "stand_in"))
    fleet = fleet_of(part.fleet)
    yield from planned_problems(part, fleet, unless_invalid(lambda: _starts(part, fleet)))
    # What no leader reaches follows no reference: then the verdict is about the graph.
    lost = unless_invalid(lambda: unreached(fleet, _flying_at(_starts(part, fleet), fleet)))
    if part.reference and (lost is INVALID or not lost):
        yield from each(flyable_problems(fleet, part.reference))


def _flying_at(starts_enu_m: Mapping[int, Vector3], fleet: FleetConfig) -> dict[int, Vector3]:
    """Above the start positions."""
    return {i: (x, y, z + fleet.takeoff_height_m) for i, (x, y, z) in starts_enu_m.items()}


def _not_read(data: Any, fleet: FleetConfig, where: str) -> list[str]:
    """Keys of the file that the analysis does not use; it keeps the heading of the start."""
    named = [name for section, name in NOT_READ.items() if section in data]
    return named + [f"{where}formation_heading"] * fleet.slots_turn


def _a_step(fleet: FleetConfig) -> Vector3:
    """Reference position STEP_M ahead of vehicles that took off at their slots."""
    return (STEP_M, 0.0, fleet.takeoff_height_m)
