"""A CommandRequest of the interface -> the FleetRequest of `companion fleet`, checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct

from companion.config.file import ConfigError, convert
from companion.config.fleet import FleetConfig
from companion.config.planned_flight import ShapeName
from companion.config.reference import Reference, ReferenceSection
from companion.config.slots import check_slots
from companion.config.values import PositionM
from companion.ground.requests import FleetRequest, FormationRequest, ReferenceRequest
from companion.monitor.api import CommandRequest
from companion.types.values import VehicleId

WAIT_S = 3.0  # for reports and replies, as `companion fleet` does
ABORT, DOCTOR, HOLD, LAND = "abort", "doctor", "hold", "land"
SIMPLE = ("arm", "takeoff", "form", HOLD, LAND, "return", "disarm", "take")
CHANGES = ("leader", "formation", "reference")
ACTIONS = (*SIMPLE, ABORT, DOCTOR, *CHANGES)
REQUEST = Path("request")  # named in an error in place of a file

T = TypeVar("T", bound=Struct)


class RequestError(Exception):
    """A request that cannot be used; nothing was sent. str() is one line: field, and what was expected."""


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


def fleet_request(request: CommandRequest, fleet: FleetConfig) -> FleetRequest:
    """Raises RequestError."""
    if request.fleet != fleet.name:
        raise RequestError(f"fleet: {request.fleet!r} is not commanded here; expected {fleet.name!r}")
    if request.name not in ACTIONS:
        raise RequestError(f"name: {request.name!r} is no action; expected one of {', '.join(ACTIONS)}")
    known = [member.id for member in fleet.vehicles]
    _check_ids("vehicle_ids", request.vehicle_ids, known)
    if request.name in CHANGES and set(request.vehicle_ids) not in (set(), set(known)):
        raise RequestError(f"vehicle_ids: {request.name} is for the whole fleet; expected all vehicles, or none listed")
    if request.name not in CHANGES and request.content:
        raise RequestError(f"content: {request.name} has none; expected {{}}")
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
    return FleetRequest(
        action=request.name,
        fleet=REQUEST,
        connect=(),
        operator="",
        only=() if request.name in CHANGES else request.vehicle_ids,
        wait_s=WAIT_S,
        as_json=False,
        wait=False,
        leaders=leaders,
        formation=formation,
        reference=reference,
    )


def _check_ids(field: str, ids: tuple[int, ...], known: list[int]) -> None:
    for vehicle_id in ids:
        if vehicle_id not in known:
            expected = ", ".join(map(str, known))
            raise RequestError(f"{field}: vehicle {vehicle_id} is not in the fleet; expected some of {expected}")


def _content(content: Mapping[str, Any], type_: type[T]) -> T:
    try:
        # From JSON keys are texts: the ids of slots as well.
        return msgspec.convert(content, type_, strict=True, str_keys=True)
    except msgspec.ValidationError as error:
        raise RequestError(f"content: {error}") from error


def formation_request(content: FormationContent, fleet: FleetConfig) -> FormationRequest:
    """Raises RequestError for slots that are incomplete, and for a choice that is none."""
    if content.shape is not None and content.slots_enu_m is not None:
        raise RequestError("content: shape and slots_enu_m are two formations; expected one of them")
    if (content.shape is None) is not (content.spacing_m is None):
        raise RequestError("content.spacing_m: belongs to a shape; expected both or neither")
    if content.slots_enu_m is not None:
        try:
            check_slots(REQUEST, content.slots_enu_m, fleet)
        except ConfigError as error:
            raise RequestError(_one_line(error)) from error
    if content.shape is None and content.slots_enu_m is None and content.scale == 1.0 and content.heading_deg == 0.0:
        raise RequestError("content: is empty; expected shape, slots_enu_m, scale or heading_deg")
    return FormationRequest(
        content.shape, None, content.spacing_m, content.heading_deg, content.scale, content.slots_enu_m
    )


def reference_of(content: Mapping[str, Any]) -> Reference:
    """As in a vehicle file. Raises RequestError."""
    try:
        return convert(REQUEST, {"reference": dict(content)}, ReferenceSection).reference
    except ConfigError as error:
        raise RequestError(_one_line(error)) from error


def _one_line(error: ConfigError) -> str:
    return "; ".join(line.removeprefix(f"{REQUEST}: ") for line in error.lines)
