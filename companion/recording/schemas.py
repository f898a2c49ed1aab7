"""JSON Schemas of the topics, made from their types, for programs that show recordings.

Foxglove, Lichtblick and PlotJuggler read objects, arrays of numbers, texts or objects, and plain values; nothing else. So None
is not in a schema (null is accepted anyway), and what is of no fixed form is left out: it is in the messages all the same.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec
from msgspec import Struct
from msgspec.structs import fields

from companion.recording.records import (
    COMMAND,
    DECISION,
    EVENT,
    GROUND_COMMAND,
    GROUND_STATUS,
    INBOX,
    OUTBOX,
    REPLY,
    STATUS,
    TIMING,
    DecisionRecord,
    TimingRecord,
)
from companion.types.commands import Command, CommandReply
from companion.types.notices import Notice
from companion.wire.messages import StatusReport

SCHEMA_ENCODING = "jsonschema"  # of the schemas, as MCAP names it
MESSAGE_ENCODING = "json"
Schema = dict[str, Any]
NoneType = type(None)


class _InboxShown(Struct):
    """What of /inbox has a fixed form."""

    now_s: float
    late_s: float
    stopping: bool


class _OutboxShown(Struct):
    """What of /outbox has a fixed form: roll, pitch, yaw (rad) and thrust."""

    now_s: float
    attitude_target: tuple[float, float, float, float]


TYPES: dict[str, tuple[str, type]] = {  # name of the schema and type of the messages
    INBOX: ("companion.Inbox", _InboxShown),
    OUTBOX: ("companion.Outbox", _OutboxShown),
    DECISION: ("companion.DecisionRecord", DecisionRecord),
    TIMING: ("companion.TimingRecord", TimingRecord),
    STATUS: ("companion.StatusReport", StatusReport),
    EVENT: ("companion.Notice", Notice),
    COMMAND: ("companion.Command", Command),
    REPLY: ("companion.CommandReply", CommandReply),
    GROUND_STATUS: ("companion.StatusReport", StatusReport),
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
    origin, parts = get_origin(type_), get_args(type_)
    if origin is Annotated:
        return _schema(parts[0])
    if origin is Literal:
        return _schema(type(parts[0]))
    if origin in (tuple, list):
        return _array([part for part in parts if part is not Ellipsis])
    if origin is Union or type_.__class__.__name__ == "UnionType":
        inner = [part for part in parts if part is not NoneType]
        return _schema(inner[0]) if len(inner) == 1 else None
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
