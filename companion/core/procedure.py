"""One thing asked of the autopilot: repeated until the autopilot's own truth shows it, or given up with the reason.

Acknowledgements are not believed (PX4 first accepts a mode change and then refuses it); they only say why.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from math import inf

from companion.types import AckSample, AutopilotRequest, Telemetry, TextSample, VehicleState

TEXTS_KEPT = 3

Truth = Callable[[VehicleState], bool]


class Progress(Enum):
    PENDING = "pending"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Procedure:
    """`taken` ends the repeating, `done` ends the procedure. The first request goes out after `delay_s`, whatever `taken` says.

    `done` is not believed before `settle_s` (a request on its way may still change what already looks right), nor from a
    truth that is older than the first request: `truth_time` says of when it is. Where `acceptance_counts`, an accepted
    answer ends the repeating, too. What is not `taken` within `taken_within_s` has failed, however long it may last.
    """

    request: AutopilotRequest
    taken: Truth
    done: Truth
    truth_time: Callable[[VehicleState], float]
    timeout_s: float
    delay_s: float = 0.0
    settle_s: float = 0.0
    repeat_s: float = 0.5
    acceptance_counts: bool = False
    taken_within_s: float = inf


@dataclass(slots=True)
class RunningProcedure:
    """A procedure on its way."""

    procedure: Procedure
    started_s: float
    _next_s: float = field(init=False)
    _sent_s: float | None = None
    _accepted: bool = False
    _refusal: str = ""  # of the last answer that was one
    _texts: tuple[str, ...] = ()  # what the autopilot said meanwhile, newest last

    def __post_init__(self) -> None:
        self._next_s = self.started_s + self.procedure.delay_s

    @property
    def reason(self) -> str:
        """Why it was refused, in the autopilot's words: its answer, and what it said beside."""
        return ": ".join(filter(None, (self._refusal, "; ".join(self._texts)))) or "no answer from the autopilot"

    def hear(self, telemetry: Iterable[Telemetry]) -> None:
        for sample in telemetry:
            if isinstance(sample, AckSample) and isinstance(self.procedure.request, sample.answers):
                self._accepted = sample.accepted
                if not sample.accepted:
                    self._refusal = sample.reason
            elif isinstance(sample, TextSample) and sample.severity <= 4:  # MAV_SEVERITY_WARNING and worse
                others = [text for text in self._texts if text != sample.text]
                self._texts = (*others, sample.text)[-TEXTS_KEPT:]

    def progress(self, now_s: float, vehicle: VehicleState) -> Progress:
        elapsed_s = now_s - self.started_s
        new = self._sent_s is not None and self.procedure.truth_time(vehicle) > self._sent_s
        if new and elapsed_s >= self.procedure.settle_s and self.procedure.done(vehicle):
            return Progress.DONE
        refused = elapsed_s > self.procedure.taken_within_s and not self.procedure.taken(vehicle)
        return Progress.FAILED if refused or elapsed_s > self.procedure.timeout_s else Progress.PENDING

    def due(self, now_s: float, vehicle: VehicleState) -> tuple[AutopilotRequest, ...]:
        """The request, whenever it is time to send it (again)."""
        if now_s < self._next_s or (self._sent_s is not None and self._needs_no_repeat(vehicle)):
            return ()
        self._sent_s = now_s if self._sent_s is None else self._sent_s
        self._next_s = now_s + self.procedure.repeat_s
        return (self.procedure.request,)

    def _needs_no_repeat(self, vehicle: VehicleState) -> bool:
        return self.procedure.taken(vehicle) or (self._accepted and self.procedure.acceptance_counts)
