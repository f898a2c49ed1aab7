"""The recordings in a folder: files of several vehicles and starts, in order, and what is in them.

Files are read piece by piece, each time again: a flight of hours needs no more memory than one of a minute.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

from companion.recording.codec import RecordError, TopicDecoder, decode_inbox, decode_outbox, header_of, monotonic_s
from companion.recording.mcap_file import McapFile, RawMessage, UnusableFileError, Warn
from companion.recording.records import FORMAT, INBOX, OUTBOX, TYPES, Header
from companion.types.errors import CompanionError, UnusableError
from companion.types.tick import Inbox, Outbox
from companion.types.values import printable

MAX_FILES = 10_000

_DECODE: dict[str, Callable[[bytes], Any]] = {topic: TopicDecoder(type_).decode for topic, (_, type_) in TYPES.items()}
_DECODE |= {INBOX: decode_inbox, OUTBOX: decode_outbox}


class RecordingError(UnusableError):
    """A folder without any recording that can be used. str() is one line."""


class MissingTicksError(CompanionError):
    """A tick is not recorded. str() says which."""


class Recorded(NamedTuple):
    """A message: `now_s` of the vehicle's monotonic clock, and the value of the type that `records.py` names.

    That of /inbox and /outbox is their pair (now_s, value), exact; here `now_s` is to the nanosecond.
    """

    topic: str
    now_s: float
    value: Any


class RecordedTick(NamedTuple):
    """`number`: from 1 in a start, without gaps. `output` is the message of /outbox, b"" where there is none of the tick."""

    number: int
    now_s: float
    inbox: Inbox
    output: bytes

    def outbox(self) -> Outbox:
        """The recorded output. Raises RecordError."""
        return decode_outbox(self.output)[1]


@dataclass(frozen=True, slots=True)
class RecordedPart:
    """One file."""

    path: Path
    header: Header


@dataclass(frozen=True, slots=True)
class Recording:
    """What one start of one agent recorded, or one start on the ground (vehicle 0). Parts are in order, of one at least."""

    parts: tuple[RecordedPart, ...]

    @property
    def header(self) -> Header:
        """That of the first part here."""
        return self.parts[0].header

    @property
    def vehicle_id(self) -> int:
        return self.header.vehicle_id

    @property
    def name(self) -> str:
        """For messages."""
        return f"vehicle {self.vehicle_id}" if self.vehicle_id else "ground"

    @property
    def missing_parts(self) -> tuple[str, ...]:
        """A sentence for each gap before the last part that is here, however wide: a header may claim any number."""
        here = [0, *(part.header.part for part in self.parts)]
        gaps = [(before + 1, after - 1) for before, after in pairwise(here) if after > before + 1]
        return tuple(
            f"part {first} of the recording is not here"
            if first == last
            else f"parts {first} to {last} of the recording are not here"
            for first, last in gaps
        )

    def undecoded(self, topics: Collection[str], warn: Warn) -> Iterator[RawMessage]:
        """The messages of these topics as stored. `warn` gets one line for each file with damage, after its messages."""
        for part in self.parts:
            yield from _messages(part, topics, warn)

    def read(self, topics: Collection[str], warn: Warn) -> Iterator[Recorded]:
        """The messages of these topics. `warn` gets one line for each file with damage, after its messages."""
        for part in self.parts:
            unreadable, first = 0, ""
            for topic, _, time_ns, data in _messages(part, topics, warn):
                try:
                    value = _DECODE[topic](data)
                except RecordError as error:
                    unreadable, first = unreadable + 1, first or f"{topic}: {error}"
                    continue
                yield Recorded(topic, monotonic_s(part.header, time_ns), value)
            if unreadable:
                warn(f"{_shown(part.path)}: {unreadable} messages cannot be read, the first of {printable(first)}")

    def ticks(self, warn: Warn) -> Iterator[RecordedTick]:
        """All ticks, from the first of the start on. `warn` as for `read`.

        Raises MissingTicksError at a tick that is not recorded: those after it depend on it.
        """
        if self.missing_parts:
            raise MissingTicksError(self.missing_parts[0])
        number, pending = 0, None
        for part in self.parts:
            for topic, sequence, _, data in _messages(part, (INBOX, OUTBOX), warn):
                try:
                    if topic == INBOX:
                        if pending:
                            yield pending
                        if sequence != number + 1:
                            raise MissingTicksError(_not_recorded(number, sequence))
                        number, pending = sequence, RecordedTick(sequence, *decode_inbox(data), b"")
                    elif pending and sequence == number:
                        yield pending._replace(output=data)
                        pending = None
                except RecordError as error:
                    raise MissingTicksError(f"tick {sequence} cannot be read: {error}") from error
        if pending:
            yield pending


def recordings(folder: Path, warn: Warn) -> list[Recording]:
    """The recordings in a folder and the folders inside it, or in one file; by vehicle, then by time.

    `warn` gets a line for each file that cannot be used. Raises RecordingError where none can.
    """
    files = _files(folder)
    parts = [part for path in files if (part := _part(path, warn))]
    if not parts:
        raise RecordingError(f"{_shown(folder)}: {_nothing_usable(folder, files)}")
    starts: dict[tuple[str, int, int, float], dict[int, RecordedPart]] = {}
    for part in parts:
        header = part.header
        of_start = starts.setdefault((header.fleet, header.vehicle_id, header.session, header.unix_s), {})
        if (first := of_start.setdefault(header.part, part)) is not part:
            warn(f"{_shown(part.path)}: the same part of the same start as {_shown(first.path)}; not used")
    found = [Recording(tuple(part for _, part in sorted(of_start.items()))) for of_start in starts.values()]
    return sorted(found, key=lambda one: (one.header.fleet, one.vehicle_id, one.header.unix_s))


def _files(folder: Path) -> list[Path]:
    """Raises RecordingError."""
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise RecordingError(f"{_shown(folder)}: no such folder; expected one with recordings (*.mcap)")
    files = list(islice(folder.rglob("*.mcap"), MAX_FILES + 1))
    if len(files) > MAX_FILES:
        raise RecordingError(f"{_shown(folder)}: more than {MAX_FILES} recordings; choose a folder inside")
    return sorted(files)


def _nothing_usable(folder: Path, files: list[Path]) -> str:
    if folder.is_file():
        return "no recording of an agent; give a file *.mcap of a flight, or the folder of the flight"
    if files:
        return f"none of its {len(files)} files *.mcap is a recording that can be used"
    return "no recordings here; expected files *.mcap of agents, also in folders inside"


def _part(path: Path, warn: Warn) -> RecordedPart | None:
    """None with a line for `warn` where the file is no recording that can be used."""
    try:
        return RecordedPart(path, header_of(McapFile(path).metadata(FORMAT)))
    except (UnusableFileError, RecordError) as error:
        warn(f"{_shown(path)}: {printable(str(error))}")
        return None


def _messages(part: RecordedPart, topics: Collection[str], warn: Warn) -> Iterator[RawMessage]:
    """A file that was there before may be gone."""
    try:
        yield from McapFile(part.path).messages(topics, warn)
    except UnusableFileError as error:
        warn(f"{_shown(part.path)}: {error}")


def _not_recorded(last: int, found: int) -> str:
    if found <= last:
        return f"tick {found} comes after tick {last}"
    return (
        f"tick {last + 1} is not recorded" if found == last + 2 else f"ticks {last + 1} to {found - 1} are not recorded"
    )


def _shown(path: Path) -> str:
    return printable(str(path))
