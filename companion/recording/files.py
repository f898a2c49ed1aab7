"""The files of one flight: parts of limited size, each valid up to its last whole piece, and the folder that they are in.

A flight is one start of one agent, or of one program on the ground. Its files are `vehicle_3_0042_001.mcap`: the source, the
number of the flight, and the part. The number counts on from the flights in the folder, because a clock on board may be wrong.
The folder may use a limited part of the disk: the oldest whole flights make room.

A .tlog has each MAVLink packet after its time, 8 bytes of microseconds of Unix time, the most significant first.
QGroundControl, Mission Planner and pymavlink write and read such files.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import struct
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from companion.config.vehicle import RecordingSettings

Piece = TypeVar("Piece")
Taken = TypeVar("Taken", contravariant=True)


class PartFormat(Protocol[Taken]):
    """The bytes of one file, in order: `opening`, any number of pieces, `closing`."""

    def opening(self) -> bytes: ...

    def piece(self, piece: Taken) -> bytes: ...

    def closing(self, offset: int) -> bytes:
        """The end of a file that has `offset` bytes so far."""


class PartFile:
    """One file. It only grows by whole pieces: one for which the disk has no room is taken back."""

    def __init__(self, path: Path) -> None:
        """Make a new file. Raises OSError, and FileExistsError."""
        self.bytes = 0
        self._path = path
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640)

    def append(self, data: bytes) -> None:
        """Write all of it, or nothing. Raises OSError."""
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._descriptor, left) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self.bytes)
            raise
        self.bytes += len(data)

    def sync(self) -> None:
        """Wait until all of it is on the disk. Raises OSError, also where the file was removed."""
        os.fdatasync(self._descriptor)
        if os.fstat(self._descriptor).st_nlink == 0:
            raise OSError(errno.ENOENT, "removed while it was written", str(self._path))

    def close(self) -> None:
        """Close it. An error here changes nothing."""
        with contextlib.suppress(OSError):
            os.close(self._descriptor)


class PartFiles(Generic[Piece]):
    """The files of one kind: a new one at the first piece, after `part_bytes`, and after an error.

    `part_of` makes the content of the part with this number, from 1.
    """

    def __init__(
        self, flight: FlightFiles, kind: str, part_bytes: int, part_of: Callable[[int], PartFormat[Piece]]
    ) -> None:
        self._flight, self._kind, self._part_bytes, self._part_of = flight, kind, part_bytes, part_of
        self._number = 0  # number of the last part
        self._open: tuple[PartFormat[Piece], PartFile] | None = None

    def write(self, piece: Piece) -> None:
        """Append a piece. Raises OSError; then nothing of the piece is in a file, and the next one begins a part."""
        if self._open and self._open[1].bytes >= self._part_bytes:
            self.close()
        try:
            if self._open:
                part, file = self._open
                file.append(part.piece(piece))
            else:
                self._begin(piece)
        except OSError:
            self._leave()
            raise

    def sync(self) -> None:
        """Wait until all is on the disk. Raises OSError; then the next piece begins a part."""
        if self._open:
            try:
                self._open[1].sync()
            except OSError:
                self._leave()
                raise

    def close(self) -> None:
        """End the present part. Raises OSError; then the part has no end, as after a power loss, and is read like that."""
        if self._open:
            part, file = self._open
            try:
                file.append(part.closing(file.bytes))
                file.sync()
            finally:
                self._leave()

    def _leave(self) -> None:
        if self._open:
            self._open[1].close()
        self._open = None

    def _begin(self, piece: Piece) -> None:
        """Begin a part with this piece. Raises OSError; then there is no file of it."""
        number = self._number + 1
        path = self._flight.path(number, self._kind)
        self._flight.make_room(self._part_bytes)
        file = PartFile(path)
        try:
            part = self._part_of(number)
            file.append(part.opening() + part.piece(piece))
        except OSError:
            file.close()
            path.unlink(missing_ok=True)
            raise
        self._number, self._open = number, (part, file)


MCAP, TLOG = "mcap", "tlog"
GROUND = "ground"
MB = 1_000_000
NAME = re.compile(rf"(?P<source>{GROUND}|vehicle_\d{{1,3}})_(?P<flight>\d{{4,9}})_(?P<part>\d{{3,9}})\.({MCAP}|{TLOG})")
IN_USE_S = 60.0  # a file that was written so recently belongs to a flight that still goes on
STATE_FOLDER = "recordings"  # in the state folder of systemd


def recordings_folder(vehicle_file: Path, recording: RecordingSettings, environment: Mapping[str, str]) -> Path | None:
    """Where an agent records; None where it does not. Without a configured folder it is in the unit's state folder."""
    if not recording.enabled:
        return None
    if recording.folder is not None:
        return vehicle_file.parent / recording.folder
    state, _, _ = environment.get("STATE_DIRECTORY", "").partition(":")
    return Path(state) / STATE_FOLDER if state else None


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """One file of a flight. `written_s` is its last change by the clock of the file system."""

    path: Path
    source: str
    flight: int
    part: int
    bytes: int
    written_s: float


def recorded_files(folder: Path) -> list[RecordedFile]:
    """All files of recordings in a folder; other files are left out. Raises OSError."""
    files = []
    for path in folder.iterdir():
        if match := NAME.fullmatch(path.name):
            try:
                state = path.stat()
            except FileNotFoundError:  # removed by another agent
                continue
            source, flight, part = match["source"], int(match["flight"]), int(match["part"])
            files.append(RecordedFile(path, source, flight, part, state.st_size, state.st_mtime))
    return files


class FlightFiles:
    """The files of one flight that is recorded now, in a folder that may use `keep_bytes`."""

    def __init__(
        self, folder: Path, source: str, keep_bytes: int, system_time_s: Callable[[], float] = time.time
    ) -> None:
        """`source`: `ground`, or `vehicle_3`. Nothing is touched before the first file."""
        self._folder = folder
        self._source = source
        self._keep_bytes = keep_bytes
        self._system_time_s = system_time_s
        self._number: int | None = None

    def path(self, part: int, kind: str) -> Path:
        """Path of a part. Makes the folder where it is missing. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if self._number is None:
            before = [file.flight for file in recorded_files(self._folder) if file.source == self._source]
            self._number = 1 + max(before, default=0)
        return self._folder / f"{self._source}_{self._number:04d}_{part:03d}.{kind}"

    def make_room(self, more_bytes: int) -> None:
        """Remove the oldest whole flights until all files and `more_bytes` fit; then the oldest parts of this flight.

        Flights of others that are being written stay, and the newest part of this one. Raises OSError.
        """
        files = recorded_files(self._folder)
        excess = sum(file.bytes for file in files) + more_bytes - self._keep_bytes
        for group in self._oldest_first(files):
            if excess <= 0:
                return
            for file in group:
                file.path.unlink(missing_ok=True)
                excess -= file.bytes

    def _oldest_first(self, files: list[RecordedFile]) -> list[list[RecordedFile]]:
        """What may be removed: the flights that are over, oldest first, and after them each part of this one."""
        flights: dict[tuple[int, str], list[RecordedFile]] = defaultdict(list)
        for file in files:
            flights[file.flight, file.source].append(file)
        own = flights.pop((self._number or 0, self._source), [])
        now_s = self._system_time_s()
        over = [group for group in flights.values() if all(abs(now_s - file.written_s) > IN_USE_S for file in group)]
        over.sort(key=lambda group: (group[0].flight, max(file.written_s for file in group), group[0].source))
        newest = {file.path.suffix: file.part for file in sorted(own, key=lambda file: file.part)}
        older = [file for file in own if file.part < newest[file.path.suffix]]
        return over + [[file] for file in sorted(older, key=lambda file: file.part)]


_TIME = struct.Struct(">Q")


def stamp(packet: bytes, unix_us: int) -> bytes:
    """A packet with its time, which must not be negative."""
    return _TIME.pack(unix_us) + packet


class TlogPart(PartFormat[bytes]):
    """A file of stamped packets, which has neither beginning nor end."""

    def opening(self) -> bytes:
        """Nothing."""
        return b""

    def piece(self, piece: bytes) -> bytes:
        """Stamped packets as they are."""
        return piece

    def closing(self, _offset: int) -> bytes:
        """Nothing."""
        return b""
