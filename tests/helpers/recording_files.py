"""Writes recordings as an agent does, and damages them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from companion.recording.codec import encode, encode_inbox, encode_outbox, log_time_ns, metadata_of
from companion.recording.records import FORMAT, INBOX, MESSAGE_ENCODING, OUTBOX, SCHEMA_ENCODING, TYPES, Header, schema
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
