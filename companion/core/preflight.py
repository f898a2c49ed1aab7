"""Preflight: reads the parameters that the audit checks, and refuses formation with the audit's findings.

The agent never sets a parameter. `companion doctor` does, on the ground and after showing the change.
"""

from __future__ import annotations

import dataclasses
from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from math import inf

from msgspec import Struct
from msgspec.structs import replace

from companion.core.autopilot import AutopilotProfile, Profiles
from companion.core.estimation.wind import DisturbanceObserver
from companion.core.safety.audit import AuditFinding, Facts, FleetFence, Verdict, audit
from companion.types.autopilot import (
    AttitudeSample,
    AutopilotKind,
    HeartbeatSample,
    LandedSample,
    ModeSample,
    ParameterSample,
    PositionSample,
    RequestParameter,
    SystemSample,
    Telemetry,
    TextSample,
)
from companion.types.notices import Code, Notice
from companion.types.values import Place

ASK_PERIOD_S = 0.05  # while answers are missing
REFRESH_PERIOD_S = 0.5  # afterwards, in turn: a pilot may correct a parameter at any time
AUTOPILOT_UNKNOWN = Notice(Code.AUTOPILOT_UNKNOWN, "the autopilot has not reported its make yet")
CHECKS_UNKNOWN = Notice(
    Code.ARMING_CHECKS_UNKNOWN, "the autopilot has not reported yet whether its own arming checks pass"
)
TRIES = 8  # an autopilot does not answer for a parameter that it lacks


class Fitness(Struct, frozen=True, gc=False):
    """Result of the audit: `refusal` of a flight in formation, and what a vehicle on the ground lacks for it.

    `warnings` are the findings with which it may fly. `events` report the findings once.
    """

    refusal: Notice | None
    lacks: tuple[Notice, ...]
    battery_percent: float | None
    warnings: tuple[Notice, ...] = ()
    events: tuple[Notice, ...] = ()


class Preflight:
    """Fitness of the vehicle. Findings that are not OK are reported once, when all parameters have been read."""

    def __init__(
        self,
        observer: DisturbanceObserver,
        profiles: Profiles,
        accepts_uncontrolled_descent: bool = False,
        fence: FleetFence | None = None,
    ) -> None:
        self._profiles = profiles
        self._accepts_uncontrolled_descent = accepts_uncontrolled_descent
        self._fence = fence
        self._observer = observer  # begins with the hover thrust of the autopilot, once read
        self._hover_thrust_norm = observer.hover_thrust_norm  # configured in the vehicle file
        self._autopilot: AutopilotKind | None = None
        self._profile: AutopilotProfile | None = None  # profile of that autopilot type
        self._names: deque[str] = deque()  # parameters to request; the first one is next
        self._survey = Survey()
        self._values: dict[str, float] = {}
        self._asked: Counter[str] = Counter()
        self._fitness: Fitness | None = None
        self.returns_elsewhere = AUTOPILOT_UNKNOWN.text  # why a return may not end at home, as judged last
        self._asked_s = -inf
        self._reported = False

    def step(
        self,
        now_s: float,
        telemetry: Sequence[Telemetry],
        autopilot: AutopilotKind | None,
        home_enu_m: Place | None = None,
    ) -> Fitness:
        """Use the telemetry of this tick, from an autopilot of this type and with this home.

        The fitness is judged again when it may differ.
        """
        if self._fence is not None and home_enu_m != self._fence.home_enu_m:
            self._fence, self._fitness = dataclasses.replace(self._fence, home_enu_m=home_enu_m), None
        if self._survey.update(now_s, telemetry):
            self._fitness = None
        if autopilot is not self._autopilot and autopilot is not None:
            self._fitness = None
            self._autopilot, self._profile = autopilot, self._profiles[autopilot]
            self._names = deque(rule.name for rule in self._profile.parameters)
        for sample in telemetry:
            if isinstance(sample, ParameterSample) and sample.name in self._names:
                if self._values.get(sample.name) != sample.value:
                    self._values[sample.name], self._fitness = sample.value, None
                if self._profile and sample.name == self._profile.hover_parameter:
                    self._observer.start_from(sample.value)
        if self._fitness is None:
            self._fitness = self._judged()
        if self._reported or not self._names or self._unread():
            return self._fitness
        self._reported = True
        findings = [finding for finding in self._findings() if finding.verdict is not Verdict.OK]
        return replace(self._fitness, events=tuple(_notice(finding).about(finding.verdict) for finding in findings))

    def ask(self, now_s: float, streams: bool) -> tuple[RequestParameter, ...]:
        """The request for the next parameter, when due: first those without an answer.

        None while setpoints stream: those read before count for the whole formation.
        """
        if streams or not self._names or now_s - self._asked_s < ASK_PERIOD_S:
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
        if unread:
            self._fitness = None
        return (RequestParameter(name),)

    @property
    def battery_percent(self) -> float | None:
        """Battery charge in percent; None where the autopilot does not report it."""
        percent = self._survey.battery_percent
        return percent if percent is not None and percent >= 0.0 else None

    def _judged(self) -> Fitness:
        """A parameter without an answer counts as missing."""
        if self._autopilot is None:
            return Fitness(AUTOPILOT_UNKNOWN, (AUTOPILOT_UNKNOWN,), self.battery_percent)
        findings = self._findings()
        refusals = [_notice(finding) for finding in findings if finding.verdict is Verdict.REFUSAL]
        warnings = [_notice(finding) for finding in findings if finding.verdict is Verdict.WARNING]
        refusal = Notice(Code.AUDIT_REFUSAL, "; ".join(notice.text for notice in refusals)) if refusals else None
        unread = self._unread()
        self.returns_elsewhere = self._returns_elsewhere(findings, unread)
        return Fitness(refusal, self._lacks(refusals), self.battery_percent, () if unread else tuple(warnings))

    def _returns_elsewhere(self, findings: Iterable[AuditFinding], unread: Collection[str]) -> str:
        """By the parameters that select where a return ends."""
        assert self._profile is not None
        deciding = {rule.name for rule in self._profile.parameters if rule.code is Code.RETURNS_ELSEWHERE}
        if waiting := sorted(deciding.intersection(unread)):
            return f"where it returns to is not known yet: {', '.join(waiting)} is not read"
        return next((str(finding) for finding in findings if finding.code is Code.RETURNS_ELSEWHERE), "")

    def _lacks(self, refusals: list[Notice]) -> tuple[Notice, ...]:
        """What the vehicle lacks for a flight in formation, on the ground: refusals of the audit, and failing arming checks."""
        if unread := self._unread():
            return (Notice(Code.PARAMETERS_UNREAD, f"not read yet: {', '.join(unread)}"),)
        match self._survey.failing_checks:
            case None:
                return (CHECKS_UNKNOWN, *refusals)
            case "":
                return tuple(refusals)
            case checks:
                return (Notice(Code.ARMING_CHECKS_FAILED, f"cannot be armed: {checks}"), *refusals)

    def _unread(self) -> list[str]:
        """Names of parameters without an answer that were requested fewer than TRIES times."""
        return sorted(name for name in self._names if name not in self._values and self._asked[name] < TRIES)

    def _findings(self) -> tuple[AuditFinding, ...]:
        assert self._profile is not None
        rules, survey = self._profile.parameters, self._survey
        facts = Facts(
            rules,
            {rule.name: self._values.get(rule.name) for rule in rules},
            self._hover_thrust_norm,
            rates_hz=survey.rates_hz,
            missing=survey.missing,
            messages=self._profile.messages,
            battery_percent=survey.battery_percent,
            accepts_uncontrolled_descent=self._accepts_uncontrolled_descent,
            fence=self._fence,
        )
        return audit(facts)


def _notice(finding: AuditFinding) -> Notice:
    assert finding.code is not None  # never called for findings that are OK
    return Notice(finding.code, str(finding))


WINDOW_S = 2.0  # over which rates are counted
NAMES: Mapping[type[Telemetry], str] = {
    PositionSample: "positions",
    AttitudeSample: "attitudes",
    ModeSample: "modes",
    LandedSample: "landed states",
}
COUNTED = (*NAMES, HeartbeatSample)
WARNING = 4  # MAV_SEVERITY


class Survey:
    """Newest values and message rates. Rates are of the last complete window; None before the first.

    `missing`: names of telemetry of which nothing arrived in that window. A mode in HEARTBEAT is no message of its own.
    """

    def __init__(self) -> None:
        self.rates_hz: Mapping[str, float] | None = None
        self.missing: frozenset[str] = frozenset()
        self.battery_percent: float | None = None
        self.may_arm: bool | None = None
        self.last_warning = ""  # newest STATUSTEXT of severity WARNING or worse
        self._counts: dict[type[Telemetry], int] = dict.fromkeys(COUNTED, 0)
        self._window_since_s: float | None = None

    def update(self, now_s: float, telemetry: Sequence[Telemetry]) -> bool:
        """Add the telemetry since the last call; return whether what is found has changed.

        The telemetry of the first call is older than the window and is not counted.
        """
        changed = False
        if self._window_since_s is None:
            self._window_since_s = now_s
            telemetry = ()
        counts = self._counts
        for sample in telemetry:
            kind = type(sample)
            if kind in counts:
                counts[kind] += 1
            elif isinstance(sample, SystemSample):
                changed |= (self.battery_percent, self.may_arm) != (sample.battery_percent, sample.may_arm)
                self.battery_percent, self.may_arm = sample.battery_percent, sample.may_arm
            elif isinstance(sample, TextSample) and sample.severity <= WARNING:
                changed |= self.last_warning != sample.text
                self.last_warning = sample.text
        elapsed_s = now_s - self._window_since_s
        if elapsed_s >= WINDOW_S:
            rates_hz = {name: counts[kind] / elapsed_s for kind, name in NAMES.items()}
            changed |= rates_hz != self.rates_hz
            counts[ModeSample] -= counts[HeartbeatSample]  # every HEARTBEAT gives a mode sample too
            self.missing = frozenset(name for kind, name in NAMES.items() if counts[kind] <= 0)
            self.rates_hz, self._counts = rates_hz, dict.fromkeys(COUNTED, 0)
            self._window_since_s = now_s
        return changed

    @property
    def failing_checks(self) -> str | None:
        """Why the autopilot's preflight checks fail; "" where they pass, None where it has not reported them."""
        if self.may_arm is None:
            return None
        return "" if self.may_arm else self.last_warning or "the autopilot's preflight checks do not pass"
