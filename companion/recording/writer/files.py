"""The files of one flight: parts of limited size, each valid up to its last whole piece."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from companion.recording.writer.folder import FlightFiles

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
        self._number = 0  # of the last part
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
