"""Where the pieces of a recording are written: in a thread, so that no disk delays a tick, or at once in virtual time.

What is lost is counted, and reported where losses begin and end.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from companion.recording.files import PartFiles, Piece
from companion.types.notices import Code, Notice
from companion.types.status import RecordingState

WAITING = 16  # pieces; eight seconds of a recording with a .tlog
RETRY_S = 5.0  # after an error
CLOSE_WITHIN_S = 2.0
NICENESS = 10  # low priority of the writing thread, so that a due tick comes first


class Writing(Protocol):
    """Takes pieces for files. `dropped` counts the records that were lost, `problem` is why the last ones were."""

    @property
    def dropped(self) -> int: ...

    @property
    def problem(self) -> str: ...

    def put(self, files: PartFiles[Piece], piece: Piece, records: int) -> None:
        """Write a piece of so many records, or drop it."""

    def drop(self, records: int, problem: str) -> None:
        """Count records that are in no piece."""

    def close(self) -> None:
        """End all files."""


class WritingThread:
    """Writes in a thread of its own, and waits there after each piece until the disk has it. `put` never waits.

    A piece that finds WAITING others is dropped: the disk is slow. After an error, like that of a full disk, pieces are dropped
    for RETRY_S; then another part is begun.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self.problem = ""
        self._clock_s = clock_s
        self._refused = 0  # records that found the queue full, or are in no piece
        self._failed = 0  # records that could not be written; counted by the thread
        self._retry_s = float("-inf")
        self._pieces: queue.Queue[tuple[PartFiles[Any], Any, int] | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Records that were lost since the start."""
        return self._refused + self._failed

    @property
    def waiting(self) -> int:
        """Pieces that are not written yet."""
        return self._pieces.unfinished_tasks

    def put(self, files: PartFiles[Piece], piece: Piece, records: int) -> None:
        """Hand a piece to the thread, or drop it."""
        try:
            self._pieces.put_nowait((files, piece, records))
        except queue.Full:
            self.drop(records, "the disk is too slow")

    def drop(self, records: int, problem: str) -> None:
        """Count records that are in no piece."""
        self._refused += records
        self.problem = problem

    def close(self) -> None:
        """End the files. Waits for CLOSE_WITHIN_S: a disk that hangs does not keep the process."""
        with contextlib.suppress(queue.Full):
            self._pieces.put(None, timeout=CLOSE_WITHIN_S)
            self._thread.join(CLOSE_WITHIN_S)

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # without the right to it the flight is recorded all the same
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        used: set[PartFiles[Any]] = set()
        while job := self._pieces.get():
            files, piece, records = job
            used.add(files)
            if self._clock_s() < self._retry_s or not self._attempt(lambda: _write(files, piece)):  # noqa: B023 -- at once
                self._failed += records
            self._pieces.task_done()
        for files in used:
            self._attempt(files.close)

    def _attempt(self, action: Callable[[], None]) -> bool:
        """Whether it worked."""
        try:
            action()
        except OSError as error:
            self.problem = _words(error)
        except Exception as error:  # noqa: BLE001 -- a defect here ends a part, never the thread
            self.problem = f"{type(error).__name__}: {error}"
        else:
            return True
        self._retry_s = self._clock_s() + RETRY_S
        return False


class WritingAtOnce:
    """Writes as the pieces come, for virtual time."""

    def __init__(self) -> None:
        self.dropped = 0
        self.problem = ""
        self._used: dict[PartFiles[Any], None] = {}

    def put(self, files: PartFiles[Piece], piece: Piece, records: int) -> None:
        """Write a piece."""
        self._used[files] = None
        try:
            files.write(piece)
        except OSError as error:
            self.drop(records, _words(error))

    def drop(self, records: int, problem: str) -> None:
        """Count records that are in no piece."""
        self.dropped += records
        self.problem = problem

    def close(self) -> None:
        """End the files."""
        for files in self._used:
            with contextlib.suppress(OSError):  # a file without its end is read like that
                files.close()


def _words(error: OSError) -> str:
    return f"{error.filename or 'disk'}: {error.strerror}"


def _write(files: PartFiles[Piece], piece: Piece) -> None:
    files.write(piece)
    files.sync()


QUIET_S = 5.0  # without a lost record until the recording is reported as whole again


class DropReport:
    """Follows the counter of lost records. One notice where losses begin, one where they end."""

    def __init__(self, writing: Writing) -> None:
        self._writing = writing
        self._dropped = 0  # when last looked
        self._before = 0  # when the losses began
        self._lost_s: float | None = None  # when the last record was lost; None while none are

    @property
    def state(self) -> RecordingState:
        """For the status."""
        return RecordingState("dropping" if self._lost_s is not None else "on", self._dropped)

    def step(self, now_s: float) -> Notice | None:
        """Look at the counter."""
        before, self._dropped = self._dropped, self._writing.dropped
        if self._dropped > before:
            begins, self._lost_s = self._lost_s is None, now_s
            if begins:
                self._before = before
                return Notice(Code.RECORDING_DROPS, f"recording loses records: {self._writing.problem}")
        elif self._lost_s is not None and now_s - self._lost_s >= QUIET_S:
            self._lost_s = None
            return Notice(
                Code.RECORDING_RESUMED, f"recording goes on; {self._dropped - self._before} records were lost"
            )
        return None
