"""Is this vehicle fit to fly in formation? One audit for two doors: `companion doctor` and the agent before it forms.

What is looked at is in `Facts`, what follows from it in `Finding`s. A warning may be flown with, a refusal may not.
`audit_parameters.py` holds the table of the autopilots' parameters; the rest is the same for every autopilot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from companion.core.audit_parameters import RULES, Judgement, ParameterRule
from companion.core.audit_parameters import Verdict as Verdict
from companion.types import AutopilotKind, Vector3

# PX4 tells its mode twice a second and at every change, whatever was asked for; HEARTBEAT alone, once a second, is too little.
ENOUGH_HZ = {"positions": 40.0, "attitudes": 40.0, "modes": 1.5, "landed states": 2.0}
LOW_BATTERY_PERCENT = 40.0  # a flight may begin, but not a long one
EMPTY_BATTERY_PERCENT = 20.0
HOVER_THRUST_APART = 0.1  # of hover thrust; more, and vehicle file and autopilot mean different vehicles


class Place(StrEnum):
    """Where the vehicle is, as far as a formation goes."""

    UNKNOWN = "no position"
    NO_ORIGIN = "position, but no origin of its local frame"
    OUTSIDE = "outside the fleet's fence"
    INSIDE = "inside the fleet's fence"


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of one vehicle. None is what this door does not look at; nothing is said of that.

    `parameters`: all that were asked for; None for one that the autopilot did not answer. `rates_hz` has the keys of
    ENOUGH_HZ. `battery_percent` is -1 where the autopilot does not know.
    """

    autopilot: AutopilotKind
    parameters: Mapping[str, float | None]
    hover_thrust_norm: float  # as the vehicle file has it
    rates_hz: Mapping[str, float] | None = None
    checks_lack: str | None = (
        None  # what the autopilot's own checks before arming lack, the estimator's among them; "" nothing
    )
    place: Place | None = None
    position_enu_m: Vector3 | None = None
    battery_percent: float | None = None
    mode_name: str | None = None
    armed: bool | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the audit. `fix` is the value that may be set without asking a pilot; None where a human decides."""

    subject: str
    verdict: Verdict
    found: str
    wanted: str
    remedy: str = ""  # how to set it; "" where nothing is to be done
    fix: float | None = None

    def __str__(self) -> str:
        """In a sentence, for a log or a reply."""
        return f"{self.subject}: {self.found}; wanted: {self.wanted}" + (f"; {self.remedy}" if self.remedy else "")


def parameter_names(autopilot: AutopilotKind) -> tuple[str, ...]:
    """The parameters that the audit looks at, in its order."""
    return tuple(rule.name for rule in RULES[autopilot])


def audit(facts: Facts) -> tuple[Finding, ...]:
    """All that is to be said of these facts, in a fixed order."""
    return tuple(_findings(facts))


def worst(findings: tuple[Finding, ...]) -> Verdict:
    """The gravest verdict among them."""
    verdicts = {finding.verdict for finding in findings}
    return next(v for v in (Verdict.REFUSAL, Verdict.WARNING, Verdict.OK) if v in verdicts or v is Verdict.OK)


def _findings(facts: Facts) -> Iterator[Finding]:
    if facts.rates_hz is not None:
        yield from (_rate(name, facts.rates_hz.get(name, 0.0), least_hz) for name, least_hz in ENOUGH_HZ.items())
    if facts.checks_lack is not None:
        yield _checks(facts.checks_lack)
    if facts.place is not None:
        yield _place(facts.place, facts.position_enu_m)
    if facts.battery_percent is not None:
        yield _battery(facts.battery_percent)
    if facts.armed is not None:
        yield _mode(facts.mode_name or "unknown", facts.armed)
    for rule in RULES[facts.autopilot]:
        if rule.name in facts.parameters:
            yield _parameter(rule, facts.parameters[rule.name], facts.hover_thrust_norm)


def _rate(name: str, rate_hz: float, least_hz: float) -> Finding:
    wanted = f"at least {least_hz:g} Hz"
    if rate_hz >= least_hz:
        return Finding(name, Verdict.OK, f"{rate_hz:.1f} Hz", wanted)
    remedy = "a faster line (baud rate), fewer other streams on it (MAV_x_RATE, SRx_*), or another port"
    return Finding(name, Verdict.REFUSAL, f"{rate_hz:.1f} Hz", wanted, remedy)


def _checks(lacks: str) -> Finding:
    wanted = "the autopilot's own checks pass"
    if not lacks:
        return Finding("estimator and checks", Verdict.OK, "passed", wanted)
    remedy = "wait for GPS, keep it still; a ground station shows what it waits for"
    return Finding("estimator and checks", Verdict.REFUSAL, lacks, wanted, remedy)


def _place(place: Place, position_enu_m: Vector3 | None) -> Finding:
    wanted = Place.INSIDE.value
    found = place.value
    if position_enu_m is not None and place in (Place.INSIDE, Place.OUTSIDE):
        found += " at " + ", ".join(f"{coordinate:z.1f}" for coordinate in position_enu_m) + " m"
    match place:
        case Place.INSIDE:
            return Finding("origin", Verdict.OK, found, wanted)
        case Place.OUTSIDE:
            remedy = "origin or envelope.fence_* of the fleet file is of another field, or the vehicle stands wrong"
        case Place.NO_ORIGIN:
            remedy = "wait for its position fix; without GPS set the origin (SET_GPS_GLOBAL_ORIGIN) or origin: indoor"
        case _:
            remedy = "wait for its estimator; it sends LOCAL_POSITION_NED when it has a position"
    return Finding("origin", Verdict.REFUSAL, found, wanted, remedy)


def _battery(percent: float) -> Finding:
    wanted = f"at least {LOW_BATTERY_PERCENT:g} %"
    if percent < 0.0:
        return Finding(
            "battery", Verdict.WARNING, "the autopilot does not know", wanted, "calibrate its battery monitor"
        )
    remedy = "charge or change it"
    if percent < EMPTY_BATTERY_PERCENT:
        return Finding("battery", Verdict.REFUSAL, f"{percent:.0f} %", wanted, remedy)
    if percent < LOW_BATTERY_PERCENT:
        return Finding("battery", Verdict.WARNING, f"{percent:.0f} %", wanted, remedy)
    return Finding("battery", Verdict.OK, f"{percent:.0f} %", wanted)


def _mode(mode_name: str, armed: bool) -> Finding:
    wanted = "disarmed"
    if armed:
        remedy = "somebody flies it: nothing is set now; land and disarm first"
        return Finding("mode", Verdict.WARNING, f"{mode_name}, armed", wanted, remedy)
    return Finding("mode", Verdict.OK, f"{mode_name}, disarmed", wanted)


def _parameter(rule: ParameterRule, value: float | None, hover_thrust_norm: float) -> Finding:
    wanted = rule.wanted if rule.judge else f"{rule.wanted}, {hover_thrust_norm:g}"
    if value is None:
        return Finding(rule.name, rule.not_found, "not found", wanted, "older firmware, or a link that loses much")
    if rule.judge is None:
        return _hover_thrust(rule, value, hover_thrust_norm, wanted)
    judgement: Judgement = rule.judge(value)
    found = f"{value:g} {rule.unit}".rstrip() + (f" ({judgement.meaning})" if judgement.meaning else "")
    if judgement.verdict is Verdict.OK:
        return Finding(rule.name, Verdict.OK, found, wanted)
    fix = rule.safe(value) if rule.safe else None
    remedy = f"set {rule.name} to {fix:g}" if fix is not None else rule.remedy
    return Finding(rule.name, judgement.verdict, found, wanted, remedy, fix)


def _hover_thrust(rule: ParameterRule, value: float, hover_thrust_norm: float, wanted: str) -> Finding:
    if abs(value - hover_thrust_norm) <= HOVER_THRUST_APART * max(value, hover_thrust_norm):
        return Finding(rule.name, Verdict.OK, f"{value:.3g}", wanted)
    return Finding(rule.name, Verdict.WARNING, f"{value:.3g}", wanted, rule.remedy)
