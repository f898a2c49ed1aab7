"""What is reported of a recording: whether it loses records, why, and when it goes on."""

from __future__ import annotations

from companion.recording.writer.writing import Writing
from companion.types.notices import Code, Notice
from companion.types.status import RecordingState

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
