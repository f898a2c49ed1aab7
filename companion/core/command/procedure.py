"""A request to the autopilot, repeated until telemetry shows its effect, or given up with the reason.

A COMMAND_ACK is no proof (PX4 may accept a mode change and then refuse it); it only gives the reason of a failure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from math import inf

from companion.types.autopilot import AckSample, AutopilotRequest, Telemetry, TextSample, VehicleState

TEXTS_KEPT = 3

Truth = Callable[[VehicleState], bool]


class Progress(Enum):
    PENDING = "pending"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Procedure:
    """`taken` ends the repetition, `done` ends the procedure. The first request is sent after `delay_s` in any case.

    `done` counts only after `settle_s`, as a request under way may still change the state, and only from telemetry newer than
    the first request (`truth_time`). With `acceptance_counts` an accepted COMMAND_ACK ends the repetition, too. A request that
    is not `taken` within `taken_within_s` has failed, before `timeout_s`.
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
    """A procedure under way: what was sent and what the autopilot answered."""

    procedure: Procedure
    started_s: float
    _next_s: float = field(init=False)
    _sent_s: float | None = None
    _accepted: bool = False
    _refusal: str = ""  # text of the last refusing COMMAND_ACK
    _texts: tuple[str, ...] = ()  # STATUSTEXT received meanwhile, newest last

    def __post_init__(self) -> None:
        self._next_s = self.started_s + self.procedure.delay_s

    @property
    def reason(self) -> str:
        """The autopilot's reason for a failure: its COMMAND_ACK and STATUSTEXT."""
        return ": ".join(filter(None, (self._refusal, "; ".join(self._texts)))) or "no answer from the autopilot"

    def receive(self, telemetry: Iterable[Telemetry]) -> None:
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
        """The request, when it is time to send or repeat it."""
        if now_s < self._next_s or (self._sent_s is not None and self._needs_no_repeat(vehicle)):
            return ()
        self._sent_s = now_s if self._sent_s is None else self._sent_s
        self._next_s = now_s + self.procedure.repeat_s
        return (self.procedure.request,)

    def _needs_no_repeat(self, vehicle: VehicleState) -> bool:
        return self.procedure.taken(vehicle) or (self._accepted and self.procedure.acceptance_counts)
