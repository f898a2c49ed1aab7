"""A request of the live page: checked, as a request of `companion fleet`, and what it would do before anything is sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import ceil, inf
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct, structs

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import check_slots
from companion.config.planned_flight import ShapeName
from companion.config.reference import PLACED, Asked, Reference, commanded
from companion.config.reference_check import accepted_values, reference_problems
from companion.config.validation import in_plain_words
from companion.config.values import PositionM
from companion.geometry.formations import ROUNDING_M, closest_approach, to_separation_metric, turned_slot
from companion.geometry.vectors import mean, minus, rounded
from companion.ground.belief import Belief, believed
from companion.ground.changes import (
    FleetAction,
    FormationRequest,
    ReferenceRequest,
    change_to,
    flown_reference_enu_m,
    flown_slots_enu_m,
    refusal_of,
    resolve_reference_now,
    resolve_slots,
)
from companion.ground.commands import OperateError
from companion.ground.fleet_state import slot_position
from companion.monitor.api import CommandRequest, PathView, Preview
from companion.types.formation import FlownSlot
from companion.types.status import Status
from companion.types.values import Vector3, VehicleId

WAIT_S = 3.0  # for reports and replies, as `companion fleet` does
ABORT, DOCTOR, HOLD, LAND = "abort", "doctor", "hold", "land"
SIMPLE = ("arm", "takeoff", "form", HOLD, LAND, "return", "disarm", "take")
CHANGES = ("leader", "formation", "reference")
ACTIONS = (*SIMPLE, ABORT, DOCTOR, *CHANGES)
UNITS = {"_m_s2": "m/s²", "_m_s": "m/s", "_m": "m", "_s": "s"}  # by the end of a key
ROUNDED = 1e-6  # of a product that is a round number
REQUEST = Path("request")  # named in an error in place of a file

T = TypeVar("T", bound=Struct)


class _Content(Struct, frozen=True, forbid_unknown_fields=True):
    pass


class LeaderContent(_Content, frozen=True):
    leader_ids: Annotated[tuple[VehicleId, ...], Meta(min_length=1, max_length=250)]


class FormationContent(_Content, frozen=True):
    """A shape with its spacing, or slots, or neither: the present slots, rotated and scaled."""

    shape: ShapeName | None = None
    spacing_m: Annotated[float, Meta(gt=0, le=1000)] | None = None
    heading_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    scale: Annotated[float, Meta(ge=0.01, le=100)] = 1.0
    slots_enu_m: dict[VehicleId, PositionM] | None = None


def fleet_action(request: CommandRequest, fleet: FleetConfig) -> FleetAction:
    """Raises OperateError."""
    if request.fleet != fleet.name:
        raise OperateError(f"fleet: {request.fleet!r} is not commanded here; expected {fleet.name!r}")
    if request.name not in ACTIONS:
        raise OperateError(f"name: {request.name!r} is no action; expected one of {', '.join(ACTIONS)}")
    known = [member.id for member in fleet.vehicles]
    _check_ids("vehicle_ids", request.vehicle_ids, known)
    if request.name in CHANGES and set(request.vehicle_ids) not in (set(), set(known)):
        raise OperateError(f"vehicle_ids: {request.name} is for the whole fleet; expected all vehicles, or none listed")
    if request.name not in CHANGES and request.content:
        raise OperateError(f"content: {request.name} has none; expected {{}}")
    leaders: tuple[int, ...] = ()
    formation: FormationRequest | None = None
    reference: ReferenceRequest | None = None
    match request.name:
        case "leader":
            leaders = _content(request.content, LeaderContent).leader_ids
            _check_ids("content.leader_ids", leaders, known)
        case "formation":
            formation = formation_request(_content(request.content, FormationContent), fleet)
        case "reference":
            reference = ReferenceRequest(None, {}, (), reference_of(request.content))
    only = () if request.name in CHANGES else request.vehicle_ids
    return FleetAction(request.name, only, leaders, formation, reference)


def _check_ids(field: str, ids: tuple[int, ...], known: list[int]) -> None:
    for vehicle_id in ids:
        if vehicle_id not in known:
            expected = ", ".join(map(str, known))
            raise OperateError(f"{field}: vehicle {vehicle_id} is not in the fleet; expected some of {expected}")


def _content(content: Mapping[str, Any], type_: type[T]) -> T:
    try:
        # From JSON keys are texts: the ids of slots as well.
        return msgspec.convert(content, type_, strict=True, str_keys=True)
    except msgspec.ValidationError as error:
        raise OperateError(f"content: {in_plain_words(error)}") from error


def formation_request(content: FormationContent, fleet: FleetConfig) -> FormationRequest:
    """Raises OperateError for slots that are incomplete, and for a choice that is none."""
    if content.shape is not None and content.slots_enu_m is not None:
        raise OperateError("content: shape and slots_enu_m are two formations; expected one of them")
    if (content.shape is None) is not (content.spacing_m is None):
        raise OperateError("content.spacing_m: belongs to a shape; expected both or neither")
    if content.slots_enu_m is not None:
        try:
            check_slots(REQUEST, content.slots_enu_m, fleet)
        except ConfigError as error:
            raise OperateError(_one_line(error)) from error
    if content.shape is None and content.slots_enu_m is None and content.scale == 1.0 and content.heading_deg == 0.0:
        raise OperateError("content: is empty; expected shape, slots_enu_m, scale or heading_deg")
    return FormationRequest(
        content.shape, None, content.spacing_m, content.heading_deg, content.scale, content.slots_enu_m
    )


def reference_of(content: Mapping[str, Any]) -> Reference:
    """As in a vehicle file. Raises OperateError."""
    try:
        return commanded(REQUEST, {"reference": dict(content)})
    except ConfigError as error:
        raise OperateError(_one_line(error)) from error


def _one_line(error: ConfigError) -> str:
    return "; ".join(line.removeprefix(f"{REQUEST}: ") for line in error.lines)


TRACK_POINTS = 400


def reference_forms() -> list[dict[str, Any]]:
    """The kinds of reference with the inputs that the page shows for each, for `reference_form.js`."""
    return [
        {
            "kind": name,
            "title": kind.TITLE,
            "position": kind.POSITION,
            "place": kind.PLACE,
            "most": kind.MOST_POSITIONS,
            "inputs": [_input(fields[key], asked) for key, asked in kind.ASKED.items() if asked.title],
        }
        for name, kind in PLACED.items()
        for fields in [{field.name: field for field in structs.fields(kind)}]
    ]


def _input(field: structs.FieldInfo, asked: Asked) -> dict[str, Any]:
    accepted = msgspec.inspect.type_info(field.type)
    while isinstance(accepted, msgspec.inspect.Metadata):
        accepted = accepted.type
    shown = {"name": field.name, "title": asked.title, "value": asked.initial or field.default}
    match accepted:
        case msgspec.inspect.FloatType(ge=least, le=most):
            unit = next(unit for suffix, unit in UNITS.items() if field.name.endswith(suffix))
            return shown | {"type": "number", "unit": unit, "min": least, "max": most}
        case msgspec.inspect.StrType(pattern=pattern):
            return shown | {"type": "text", "pattern": (pattern or "").replace("-]", r"\-]")}
    return shown | {"type": "checkbox"}


def preview_of(wanted: FleetAction, fleet: FleetConfig, statuses: Mapping[int, Status]) -> Preview:
    """Of a request with a formation or a reference. Raises ConfigError."""
    if wanted.formation:
        reporting = [statuses[member.id] for member in fleet.vehicles if member.id in statuses]
        if not reporting:
            return Preview(refused="no report of any vehicle")
        return _formation(wanted.formation, fleet, believed(reporting, fleet))
    assert wanted.reference is not None
    reports = believed(statuses.values(), fleet).statuses
    return _reference(resolve_reference_now(wanted.reference, reports), fleet, reports)


def _formation(request: FormationRequest, fleet: FleetConfig, belief: Belief) -> Preview:
    statuses = belief.statuses
    has_height = fleet.law.altitude == "formation"
    slots_enu_m = resolve_slots(request, statuses, fleet, belief.unsure)
    flown_enu_m = flown_slots_enu_m(statuses)
    closest_m, _, _ = closest_approach(
        {i: to_separation_metric(slot, has_height) for i, slot in flown_enu_m.items()},
        {i: to_separation_metric(slots_enu_m[i], has_height) for i in flown_enu_m},
    )
    change = change_to(slots_enu_m, statuses, fleet.slot_speed_m_s, belief.reach_m)
    reference_enu_m = _reference_enu_m(statuses)
    return Preview(
        paths=tuple(
            PathView(
                i,
                _in_fleet_frame(flown_enu_m[i], status, reference_enu_m),
                _in_fleet_frame(slots_enu_m[i], status, reference_enu_m),
            )
            for i, status in zip(flown_enu_m, statuses, strict=True)
        )
        if reference_enu_m
        else (),
        slots_enu_m={i: rounded(slot, 3) for i, slot in slots_enu_m.items()},
        heading_rad=statuses[0].formation.heading.angle_rad,
        smallest_separation_m=round(closest_m, 3) if closest_m < inf else None,
        lasts_s=round(change.lasts_s, 2),
        refused=refusal_of(slots_enu_m, fleet.separation_m, has_height) or "",
        instead=_wide_enough(request, slots_enu_m, fleet.separation_m, has_height),
    )


def _wide_enough(
    request: FormationRequest, slots_enu_m: Mapping[int, Vector3], separation_m: float, has_height: bool
) -> dict[str, float]:
    """The spacing or scale with which these slots keep `separation_m`; empty where they do, and for slots one by one."""
    places = {i: to_separation_metric(slot, has_height) for i, slot in slots_enu_m.items()}
    closest_m, _, _ = closest_approach(places, places)
    if request.slots_enu_m or not 0.0 < closest_m < separation_m - ROUNDING_M:
        return {}
    times = separation_m / closest_m
    if request.spacing_m is not None:
        return {"spacing_m": ceil(request.spacing_m * times * 100.0 - ROUNDED) / 100.0}
    return {"scale": ceil(request.scale * times * 1000.0 - ROUNDED) / 1000.0}


def _reference_enu_m(statuses: Sequence[Status]) -> Vector3 | None:
    """That of a leader; before there is one, the mean position of the vehicles less their slots. None without positions."""
    if flown_enu_m := flown_reference_enu_m(statuses):
        return flown_enu_m
    placed = [status for status in statuses if status.motion.is_known]
    slots = [turned_slot(status.formation.slot, status.formation.heading).position_enu_m for status in placed]
    return (
        mean([minus(s.motion.position_enu_m, slot) for s, slot in zip(placed, slots, strict=True)]) if placed else None
    )


def _in_fleet_frame(slot_enu_m: Vector3, status: Status, reference_enu_m: Vector3) -> Vector3:
    return rounded(slot_position(FlownSlot(slot_enu_m), status.formation.heading, reference_enu_m), 3)


def _reference(reference: Reference, fleet: FleetConfig, statuses: Sequence[Status]) -> Preview:
    """The track of the reference; None as time where it has no end."""
    slots_enu_m = flown_slots_enu_m(statuses)
    problems = list(reference_problems(fleet, reference, "reference", slots_enu_m))
    lasts_s = reference.whole_s()
    return Preview(
        track_enu_m=track_enu_m(reference),
        lasts_s=None if lasts_s is None else float(ceil(lasts_s)),
        refused="; ".join(f"{problem.field}: {problem.text}" for problem in problems),
        instead=dict(accepted_values(reference, problems)),
    )


def track_enu_m(reference: Reference) -> tuple[Vector3, ...]:
    """The line that a reference takes once through; one point where it has no end, as that of a target."""
    if legs := reference.legs_enu_m():
        track = [legs[0][0], *(end for _, end in legs)]
    else:
        curve, whole_s = reference.curve(), reference.whole_s()
        times_s = [whole_s * index / (TRACK_POINTS - 1) for index in range(TRACK_POINTS)] if whole_s else [0.0]
        track = [curve(time_s)[0] for time_s in times_s]
    return tuple(rounded(point, 3) for point in track)


@lru_cache(maxsize=16)
def described_track_enu_m(described_json: bytes) -> tuple[Vector3, ...]:
    """That of a reference as a vehicle describes it, in JSON; empty where the description is none."""
    try:
        return track_enu_m(reference_of(msgspec.json.decode(described_json)))
    except (OperateError, msgspec.DecodeError):
        return ()
