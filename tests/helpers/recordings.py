"""Writes recordings as an agent does, damages them, and draws everything that a tick can have."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import msgspec
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from msgspec import Struct
from msgspec.structs import fields

from companion.recording.codec import encode, encode_inbox, encode_outbox, log_time_ns, metadata_of
from companion.recording.records import FORMAT, INBOX, MESSAGE_ENCODING, OUTBOX, SCHEMA_ENCODING, TYPES, Header, schema
from companion.types.autopilot import AutopilotRequest
from companion.types.tick import Inbox, Outbox

HEADER = Header(
    software="1.2",
    fleet="pair",
    vehicle_id=1,
    session=7,
    part=1,
    unix_s=1_700_000_000.0,
    monotonic_s=100.0,
    fleet_file="{}",
    vehicle_file="{}",
)
TICK_S = 0.02


class RecordingFile:
    """An open file. `chunk_bytes`: of a chunk before it is compressed."""

    def __init__(self, path: Path, header: Header = HEADER, chunk_bytes: int = 4000) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._header = header
        self._writer = Writer(str(path), chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(library="test")
        self._writer.add_metadata(FORMAT, metadata_of(header))
        self._channels = {}
        for topic in TYPES:
            name, text = schema(topic)
            schema_id = self._writer.register_schema(name, SCHEMA_ENCODING, text)
            self._channels[topic] = self._writer.register_channel(topic, MESSAGE_ENCODING, schema_id)

    def write(self, topic: str, now_s: float, message: Any, number: int = 0) -> None:
        """A message of any topic but /inbox and /outbox."""
        self._add(topic, now_s, encode(message), number)

    def tick(self, number: int, now_s: float, inbox: Inbox, outbox: Outbox | None) -> None:
        self._add(INBOX, now_s, encode_inbox(now_s, inbox), number)
        if outbox is not None:
            self._add(OUTBOX, now_s, encode_outbox(now_s, outbox), number)

    def raw(self, topic: str, now_s: float, data: bytes, number: int = 0) -> None:
        self._add(topic, now_s, data, number)

    def close(self) -> None:
        self._writer.finish()

    def _add(self, topic: str, now_s: float, data: bytes, number: int) -> None:
        time_ns = log_time_ns(self._header, now_s)
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, number)


def write_ticks(path: Path, numbers: Iterable[int], header: Header = HEADER) -> Path:
    """A file with ticks of these numbers, without input; tick 1 begins at `monotonic_s` of the standard header."""
    file = RecordingFile(path, header)
    for number in numbers:
        file.tick(number, time_of(number), Inbox(late_s=number / 1e3), Outbox())
    file.close()
    return path


def time_of(number: int) -> float:
    return HEADER.monotonic_s + TICK_S * (number - 1)


REQUESTS = get_args(AutopilotRequest)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(
    ["null", '"not_finite":', "é\n"]
)
FLOATS = st.floats() | st.sampled_from([0.0, -0.0, 1.0, 0.1])


def inboxes() -> st.SearchStrategy[Inbox]:
    return _values(Inbox)


def outboxes() -> st.SearchStrategy[Outbox]:
    return _values(Outbox)


@cache
def _values(type_: Any) -> st.SearchStrategy[Any]:
    origin, parts = get_origin(type_), get_args(type_)
    if origin is Annotated:
        return _bounded(parts[0], parts[1])
    if origin is Union or type_.__class__.__name__ == "UnionType":
        return st.one_of(*map(_values, parts))
    if origin is list or (origin is tuple and parts[-1] is Ellipsis):
        items = st.sampled_from(REQUESTS) if parts[0] is type else _values(parts[0])
        made = st.lists(items, max_size=3)
        return made if origin is list else made.map(tuple)
    if origin is tuple:
        return st.tuples(*map(_values, parts))
    if origin is dict:
        return st.dictionaries(_values(parts[0]), _values(parts[1]), max_size=3)
    if isinstance(type_, type) and issubclass(type_, Struct):
        return st.builds(type_, *(_values(field.type) for field in fields(type_)))
    plain = {float: FLOATS, str: TEXTS, int: st.integers(-(2**63), 2**64 - 1)}
    return plain[type_] if type_ in plain else st.from_type(type_)


def _bounded(type_: Any, bounds: msgspec.Meta) -> st.SearchStrategy[Any]:
    if type_ is int:
        return st.integers(bounds.ge, bounds.le)
    return _values(type_)
