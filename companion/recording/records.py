"""The topics of a recording, their messages, how a decision becomes one, and their JSON Schemas for other programs.

One MCAP file has one start of one agent, or a part of it. Messages are JSON. `/inbox` and `/outbox` are exact: fed to the same
agent again, the inputs give the same outputs. What is only to be looked at (`/decision`, `/timing`) is rounded. Times without
other words are of the vehicle's monotonic clock.

The schemas are made from the types. Foxglove, Lichtblick and PlotJuggler read objects, arrays of numbers, texts or objects, and
plain values; nothing else. So None is not in a schema (null is accepted anyway), and what is of no fixed form is left out: it
is in the messages all the same.
"""

from __future__ import annotations

from functools import cache
from math import degrees, inf
from types import NoneType
from typing import Any, Literal, get_args, get_origin

import msgspec
from msgspec import Struct
from msgspec.structs import fields

from companion import __version__
from companion.config.validation import alternatives
from companion.core.report import Decision
from companion.geometry.vectors import rounded
from companion.laws import Law
from companion.types.commands import Command, CommandReply
from companion.types.flight import Role
from companion.types.notices import Notice
from companion.types.values import Vector3
from companion.wire.messages import FlatReport
from companion.wire.rounding import ACCELERATION, LENGTH, VELOCITY

FORMAT = "formation-companion"
FORMAT_VERSION = 1
SOFTWARE = f"formation-companion {__version__}"

INBOX, OUTBOX = "/inbox", "/outbox"  # one message for each tick, in this order
DECISION, TIMING = "/decision", "/timing"  # one message for each tick
STATUS = "/status"  # as published to the ground: five a second, and all with an event
EVENT, COMMAND, REPLY = "/event", "/command", "/reply"  # as they occur
GROUND_STATUS, GROUND_COMMAND = "/ground/status", "/ground/command"  # only in a recording made on the ground


class Header(Struct, frozen=True, kw_only=True):
    """Metadata of a recording. `unix_s` and `monotonic_s` are the same moment on the two clocks of the vehicle.

    `fleet_file` and `vehicle_file` are the configuration as JSON, for a replay.
    """

    format: str = FORMAT
    version: int = FORMAT_VERSION
    software: str
    fleet: str
    vehicle_id: int  # 0: the ground
    session: int
    part: int  # 1, 2, ... of the files of one start
    unix_s: float
    monotonic_s: float
    fleet_file: str
    vehicle_file: str


class DecisionRecord(Struct, frozen=True, kw_only=True):
    """What was decided in one tick and from what, flat, for plots."""

    now_s: float
    phase: str
    role: str
    leader_id: int | None
    epoch: int
    prc: int
    position_enu_m: Vector3 | None  # None before there is one in the fleet frame, like the velocity
    velocity_enu_m_s: Vector3 | None
    slot_offset_enu_m: Vector3  # turned to the heading of the formation
    reference_enu_m: Vector3 | None  # leaders only
    neighbours: tuple[int, ...]
    weights: tuple[float, ...]  # w_ij of the neighbours, in their order; empty where the law does not use them
    peer_ages_s: tuple[float, ...]  # age of each neighbour's packet, in their order
    acceleration_enu_m_s2: Vector3
    roll_deg: float | None  # commanded roll, rounded (exact in /outbox); None without a setpoint
    pitch_deg: float | None
    yaw_deg: float | None
    thrust_norm: float | None
    nearest: str
    nearest_m: float | None
    required_m: float | None
    filter_changed_m_s2: float
    wind_acceleration_enu_m_s2: Vector3
    hover_thrust_norm: float
    battery_percent: float | None
    flags: tuple[str, ...]


class TimingRecord(Struct, frozen=True):
    """`late_us`: how late the tick began; `decide_us`: until the setpoint was sent; `whole_us`: until the end of the tick."""

    now_s: float
    late_us: int
    decide_us: int
    whole_us: int
    telemetry_to_command_us: int | None


SCHEMA_ENCODING = "jsonschema"  # how MCAP names the kind of the schemas
MESSAGE_ENCODING = "json"
Schema = dict[str, Any]


class _InboxShown(Struct):
    """What of /inbox has a fixed form."""

    now_s: float
    late_s: float
    stopping: bool
    prepared_s: float
    early: int


class _OutboxShown(Struct):
    """What of /outbox has a fixed form: roll, pitch, yaw (rad) and thrust."""

    now_s: float
    attitude_target: tuple[float, float, float, float]


TYPES: dict[str, tuple[str, type]] = {  # name of the schema and type of the messages
    INBOX: ("companion.Inbox", _InboxShown),
    OUTBOX: ("companion.Outbox", _OutboxShown),
    DECISION: ("companion.DecisionRecord", DecisionRecord),
    TIMING: ("companion.TimingRecord", TimingRecord),
    STATUS: ("companion.StatusReport", FlatReport),
    EVENT: ("companion.Notice", Notice),
    COMMAND: ("companion.Command", Command),
    REPLY: ("companion.CommandReply", CommandReply),
    GROUND_STATUS: ("companion.StatusReport", FlatReport),
    GROUND_COMMAND: ("companion.Command", Command),
}


@cache
def schema(topic: str) -> tuple[str, bytes]:
    """Name and JSON Schema of the messages of a topic."""
    name, type_ = TYPES[topic]
    return name, msgspec.json.encode({"title": name, **_object(type_)})


def _object(type_: type) -> Schema:
    properties = {field.name: described for field in fields(type_) if (described := _schema(field.type))}
    return {"type": "object", "properties": properties}


def _schema(type_: Any) -> Schema | None:
    """None where the values have no fixed form."""
    inner = [part for part in alternatives(type_) if part is not NoneType]
    if len(inner) != 1:
        return None
    (type_,) = inner
    origin, parts = get_origin(type_), get_args(type_)
    if origin is Literal:
        return _schema(type(parts[0]))
    if origin in (tuple, list):
        return _array([part for part in parts if part is not Ellipsis])
    if not isinstance(type_, type):
        return None
    if issubclass(type_, Struct):
        return _object(type_)
    for base, name in ((bool, "boolean"), (str, "string"), (int, "integer"), (float, "number")):
        if issubclass(type_, base):
            return {"type": name}
    return None


def _array(parts: list[Any]) -> Schema | None:
    items = [_schema(part) for part in parts]
    same = items[0] if items and all(item == items[0] for item in items) else None
    return None if same is None or same["type"] == "array" else {"type": "array", "items": same}


def decision_record(decision: Decision, law: Law) -> DecisionRecord:
    """The record of a decision under this law.

    The own state has as many decimals as in the peer packet: the same text again costs a recording nothing.
    """
    vehicle, consensus, guidance, setpoint = (
        decision.perception.vehicle,
        decision.consensus,
        decision.guidance,
        decision.setpoint,
    )
    target, separation, reference, now_s = setpoint.target, setpoint.separation, guidance.reference, decision.now_s
    nearest, battery_percent = separation.nearest, decision.fitness.battery_percent
    role, leader = consensus.lead.role, consensus.lead.beacon
    ids, located = consensus.neighbours.ids, vehicle.position_time_s > -inf
    return DecisionRecord(
        now_s=round(now_s, 6),
        phase=decision.flight.phase.value,
        role=role.value,
        leader_id=leader.leader_id if leader else None,
        epoch=consensus.lead.term[0],
        prc=consensus.prc,
        position_enu_m=rounded(vehicle.position_enu_m, LENGTH) if located else None,
        velocity_enu_m_s=rounded(vehicle.velocity_enu_m_s, VELOCITY) if located else None,
        slot_offset_enu_m=rounded(guidance.slot.position_enu_m, 3),
        reference_enu_m=rounded(reference.position_enu_m, 3) if reference and role is Role.LEADER else None,
        neighbours=ids,
        weights=tuple([round(w, 4) for w in law.weights(role is Role.LEADER, consensus.neighbours.prcs)]),
        peer_ages_s=tuple([round(now_s - consensus.peers.known[i].measured_s, 3) for i in ids]),
        acceleration_enu_m_s2=rounded(setpoint.acceleration_enu_m_s2, ACCELERATION),
        roll_deg=round(degrees(target.roll_rad), 1) if target else None,
        pitch_deg=round(degrees(target.pitch_rad), 1) if target else None,
        yaw_deg=round(degrees(target.yaw_rad), 1) if target else None,
        thrust_norm=round(target.thrust_norm, 3) if target else None,
        nearest=nearest.name if nearest else "",
        nearest_m=round(nearest.distance_m, 2) if nearest else None,
        required_m=round(nearest.required_m, 2) if nearest else None,
        filter_changed_m_s2=round(separation.changed_m_s2, 3),
        wind_acceleration_enu_m_s2=rounded(setpoint.disturbance_enu_m_s2, 2),
        hover_thrust_norm=round(setpoint.hover_thrust_norm, 3),
        battery_percent=battery_percent,
        flags=tuple(sorted(decision.safety.flags)),
    )
