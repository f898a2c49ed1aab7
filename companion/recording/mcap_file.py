"""Reads one MCAP file: damaged, truncated or hostile ones as far as possible, with a bounded amount of memory.

The library's own stream reader trusts all lengths in a file, and stops at the first damage. So the framing is read here.
"""

from __future__ import annotations

import contextlib
import os
import stat
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata

from companion.recording.mcap_part import FRAME, MAGIC
from companion.types.errors import CompanionError
from companion.types.values import printable

Warn = Callable[[str], None]

MAX_RECORD = 8 * 2**20  # bytes of a record in the file, and of a chunk when decompressed
MAX_MESSAGE = 2**20
_SEARCHED = 2**20  # bytes at once, for the next chunk after damage
_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_FOOTER = struct.Struct("<QQI")  # where the summary begins, where its offsets begin, check sum
_CONTENT = struct.calcsize("<HIQQ")
_COMPRESSION = b"\x04\x00\x00\x00zstd"
_BEFORE_COMPRESSION = struct.calcsize("<BQQQQI")  # bytes of a chunk record before the name of its compression
_KNOWN = frozenset(Opcode)
_PARSE_ERRORS = (McapError, struct.error, UnicodeDecodeError, OverflowError, ValueError)


class UnusableFileError(CompanionError):
    """A file that is no MCAP file, or cannot be read at all. str() is the reason."""


class RawMessage(NamedTuple):
    """A message as stored. `sequence` is given by the writer."""

    topic: str
    sequence: int
    log_time_ns: int
    data: bytes


class _DamagedError(CompanionError):
    pass


class McapFile:
    """One file. Each call of a method reads it again from its beginning."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def metadata(self, name: str) -> dict[str, str]:
        """The metadata record with this name, which is before the first message. Raises UnusableFileError."""
        try:
            with self._opened() as stream:
                for opcode, payload in _Records(stream).all():
                    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                        break
                    if opcode == Opcode.METADATA:
                        metadata = Metadata.read(ReadDataStream(BytesIO(payload)))
                        if metadata.name == name:
                            return dict(metadata.metadata)
        except _PARSE_ERRORS as error:
            raise UnusableFileError("its header is damaged") from error
        except OSError as error:
            raise _unreadable(error) from error
        raise UnusableFileError("not a recording of an agent: it has no header of one")

    def messages(self, topics: Collection[str], warn: Warn) -> Iterator[RawMessage]:
        """The messages of these topics, in the order of the file. At its end one line for `warn` if anything was damaged.

        Raises UnusableFileError, where the file cannot be opened any more, or the disk fails.
        """
        try:
            yield from self._messages(topics, warn)
        except OSError as error:
            raise _unreadable(error) from error

    def _messages(self, topics: Collection[str], warn: Warn) -> Iterator[RawMessage]:
        """Raises UnusableFileError and OSError."""
        with self._opened() as stream:
            records, channels = _Records(stream), _Channels(topics)
            for payload in records.summary(Opcode.CHANNEL):
                with contextlib.suppress(_DamagedError):
                    channels.add(payload)
            for opcode, payload in records.all():
                try:
                    if opcode == Opcode.CHUNK:
                        yield from channels.messages(_unpacked(payload))
                    elif opcode == Opcode.CHANNEL:
                        channels.add(payload)
                except _DamagedError:
                    records.skip()
            if line := " and ".join(filter(None, (records.damage(), channels.damage()))):
                warn(f"{printable(str(self.path))}: {line}; read as far as possible")

    def _opened(self) -> BinaryIO:
        """Raises UnusableFileError and OSError. A pipe or device is not opened: it may never end."""
        descriptor = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise UnusableFileError("cannot be read: not a regular file")
        stream = os.fdopen(descriptor, "rb")
        if stream.read(len(MAGIC)) != MAGIC:
            stream.close()
            raise UnusableFileError("not an MCAP file")
        return stream


def _unreadable(error: OSError) -> UnusableFileError:
    return UnusableFileError(f"cannot be read: {error.strerror}")


class _Records:
    """The records of a file in order. After damage it goes on behind it."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._size = os.fstat(stream.fileno()).st_size
        self._record_at = self._next_at = len(MAGIC)
        self._damages = self._first_damage_at = 0
        self._ended = False

    def all(self) -> Iterator[tuple[int, bytes]]:
        """Opcode and content."""
        while not self._ended and self._next_at < self._size:
            self._record_at = self._next_at
            if self._is_record(self._record_at):
                opcode, length = self._head(self._record_at)
                self._next_at = self._record_at + _HEAD.size + length
                self._ended = opcode == Opcode.FOOTER
                yield opcode, self._stream.read(length)
            else:
                self._next_at = self._next_chunk()
                if self._next_at < self._size:  # else it is the end that is missing
                    self._damaged()

    def summary(self, wanted: int) -> Iterator[bytes]:
        """Contents of the records of this kind behind the messages. They repeat what a damaged chunk may have had."""
        footer_at = self._size - _HEAD.size - _FOOTER.size - len(MAGIC)
        if footer_at < len(MAGIC) or self._head(footer_at) != (Opcode.FOOTER, _FOOTER.size):
            return
        at, _, _ = _FOOTER.unpack(self._stream.read(_FOOTER.size))
        while len(MAGIC) <= at < footer_at and self._is_record(at):
            opcode, length = self._head(at)
            if opcode == wanted:
                yield self._stream.read(length)
            at += _HEAD.size + length

    def skip(self) -> None:
        """The content of the present record is damaged. Its length may be, too."""
        self._damaged()
        if not self._is_record(self._next_at):
            self._next_at = self._next_chunk()

    def _damaged(self) -> None:
        self._first_damage_at = self._first_damage_at or self._record_at
        self._damages += 1

    def _head(self, at: int) -> tuple[int, int]:
        """Opcode and length of the record there; (0, 0), which no record has, where the file ends before."""
        self._stream.seek(at)
        head = self._stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        return opcode, length

    def _is_record(self, at: int) -> bool:
        opcode, length = self._head(at)
        return opcode in _KNOWN and length <= MAX_RECORD and at + _HEAD.size + length <= self._size

    def _next_chunk(self) -> int:
        """Where the next chunk begins, after the beginning of the present record; the size of the file if there is none."""
        begin = self._record_at + 1
        while begin < self._size:
            self._stream.seek(begin)
            part = self._stream.read(_SEARCHED + _BEFORE_COMPRESSION + len(_COMPRESSION))
            found = part.find(_COMPRESSION, _BEFORE_COMPRESSION)
            while found >= 0:
                at = begin + found - _BEFORE_COMPRESSION
                if self._head(at)[0] == Opcode.CHUNK and self._is_record(at):
                    return at
                found = part.find(_COMPRESSION, found + 1)
            begin += _SEARCHED
        return self._size

    def damage(self) -> str:
        """What is wrong with the file, after all records were read; "" if nothing."""
        places = f"damaged in {self._damages} places, the first at byte {self._first_damage_at}"
        inside = [places] if self._damages else []
        end = [] if self._ended else ["without its end, as after a loss of power or while it is written"]
        return " and ".join(inside + end)


class _Channels:
    """Which channels have the wanted topics, as the file defines them."""

    def __init__(self, topics: Collection[str]) -> None:
        self._wanted = frozenset(topics)
        self._topics: dict[int, str] = {}  # wanted topics by channel id
        self._known: set[int] = set()
        self._unknown = 0

    def add(self, content: bytes) -> None:
        """Raises _DamagedError."""
        try:
            channel = Channel.read(ReadDataStream(BytesIO(content)))
        except _PARSE_ERRORS as error:
            raise _DamagedError from error
        self._known.add(channel.id)
        if channel.topic in self._wanted:
            self._topics[channel.id] = channel.topic

    def messages(self, chunk: bytes) -> Iterator[RawMessage]:
        """Those of the wanted topics. Raises _DamagedError."""
        at, end, unpack = 0, len(chunk), FRAME.unpack_from
        chunk += bytes(FRAME.size)  # a record at the end may be shorter than a message
        while at < end:
            opcode, length, channel, sequence, log_time_ns, _ = unpack(chunk, at)
            content, at = at + _HEAD.size, at + _HEAD.size + length
            if at > end:
                raise _DamagedError
            if opcode == Opcode.MESSAGE:
                if channel in self._topics:
                    if not _CONTENT <= length <= MAX_MESSAGE:
                        raise _DamagedError
                    yield RawMessage(self._topics[channel], sequence, log_time_ns, chunk[content + _CONTENT : at])
                elif channel not in self._known:
                    self._unknown += 1
            elif opcode == Opcode.CHANNEL:
                self.add(chunk[content:at])

    def damage(self) -> str:
        return f"with {self._unknown} messages of unknown topics" if self._unknown else ""


def _unpacked(content: bytes) -> bytes:
    """The records in a chunk. Raises _DamagedError."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        if chunk.uncompressed_size > MAX_RECORD:
            raise _DamagedError
        data = chunk.data if chunk.compression == "" else _decompressed(chunk)
    except _PARSE_ERRORS as error:
        raise _DamagedError from error
    if len(data) != chunk.uncompressed_size or zlib.crc32(data) != (chunk.uncompressed_crc or zlib.crc32(data)):
        raise _DamagedError
    return data


def _decompressed(chunk: Chunk) -> bytes:
    """At most one byte more than the chunk claims to have: what a frame claims of itself is not used."""
    if chunk.compression != "zstd":
        raise _DamagedError
    try:
        decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_RECORD)
        with decompressor.stream_reader(chunk.data) as reader:
            data: bytes = reader.read(chunk.uncompressed_size + 1)
    except zstandard.ZstdError as error:
        raise _DamagedError from error
    return data
