"""The agent's door to the audit: it reads the parameters that matter, and refuses formation in the audit's words.

It only ever reads. Setting is the doctor's, on the ground and after showing it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from math import inf

from companion.core.audit import Facts, Finding, Verdict, audit, parameter_names
from companion.core.disturbance import HOVER_PARAMETERS, DisturbanceObserver
from companion.core.survey import Survey
from companion.types import AutopilotKind, ParameterSample, RequestParameter, Telemetry

ASK_PERIOD_S = 0.05  # while some have yet to be answered
REFRESH_PERIOD_S = 0.5  # afterwards, in turn: a pilot may correct one at any time
CHECKS_UNTOLD = "the autopilot has not told yet whether its own checks pass"
TRIES = 8  # an autopilot says nothing of a parameter that it does not have


class Preflight:
    """What is known of the vehicle's fitness. `events` gets each finding that is not in order, once, when all is read."""

    def __init__(self, observer: DisturbanceObserver) -> None:
        self._observer = observer  # begins with the autopilot's hover thrust once that is read
        self._hover_thrust_norm = observer.hover_thrust_norm  # of the vehicle file
        self._autopilot: AutopilotKind | None = None
        self._names: deque[str] = deque()  # in the order in which they are asked for next
        self._survey = Survey()
        self._values: dict[str, float] = {}
        self._asked: Counter[str] = Counter()
        self._asked_s = -inf
        self._told = False
        self.events: list[str] = []

    def hear(self, now_s: float, telemetry: Sequence[Telemetry], autopilot: AutopilotKind | None) -> None:
        """Everything that came in this tick, from an autopilot of this make."""
        self._survey.hear(now_s, telemetry)
        if autopilot is not self._autopilot and autopilot is not None:
            self._autopilot, self._names = autopilot, deque(parameter_names(autopilot))
        for sample in telemetry:
            if isinstance(sample, ParameterSample) and sample.name in self._names:
                self._values[sample.name] = sample.value
                if sample.name in HOVER_PARAMETERS:
                    self._observer.start_from(sample.value)
        if not self._told and self._names and not self._unread():
            self._told = True
            findings = [finding for finding in self._findings() if finding.verdict is not Verdict.OK]
            self.events += [f"{finding.verdict}: {finding}" for finding in findings]

    def ask(self, now_s: float) -> tuple[RequestParameter, ...]:
        """The next parameter to be read, whenever it is time: first those that have not answered."""
        if not self._names or now_s - self._asked_s < ASK_PERIOD_S:
            return ()
        unread = self._unread()
        if not unread and now_s - self._asked_s < REFRESH_PERIOD_S:
            return ()
        self._asked_s = now_s
        while unread and self._names[0] not in unread:
            self._names.rotate(-1)
        name = self._names[0]
        self._names.rotate(-1)
        self._asked[name] += 1
        return (RequestParameter(name),)

    @property
    def battery_percent(self) -> float | None:
        """None where the autopilot does not know."""
        percent = self._survey.battery_percent
        return percent if percent is not None and percent >= 0.0 else None

    def refusal(self) -> str:
        """Why the vehicle must not fly in formation; "" where it may. What was not answered counts as not found."""
        if self._autopilot is None:
            return "the autopilot has not said yet what it is"
        return "; ".join(str(finding) for finding in self._findings() if finding.verdict is Verdict.REFUSAL)

    def lacks(self) -> tuple[str, ...]:
        """What the vehicle, on the ground, lacks to be flown in formation: the reasons of a refusal, and its own checks."""
        if self._autopilot is None:
            return ("the autopilot has not said yet what it is",)
        if unread := self._unread():
            return (f"not read yet: {', '.join(unread)}",)
        refusals = [str(finding) for finding in self._findings() if finding.verdict is Verdict.REFUSAL]
        match self._survey.checks_lack:
            case None:
                return (CHECKS_UNTOLD, *refusals)
            case "":
                return tuple(refusals)
            case words:
                return (f"cannot be armed: {words}", *refusals)

    def _unread(self) -> list[str]:
        """Those that were neither answered nor asked for often enough."""
        return sorted(name for name in self._names if name not in self._values and self._asked[name] < TRIES)

    def _findings(self) -> tuple[Finding, ...]:
        assert self._autopilot is not None
        values = {name: self._values.get(name) for name in parameter_names(self._autopilot)}
        survey = self._survey
        facts = Facts(
            self._autopilot,
            values,
            self._hover_thrust_norm,
            rates_hz=survey.rates_hz,
            battery_percent=survey.battery_percent,
        )
        return audit(facts)
