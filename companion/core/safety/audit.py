"""Vehicle audit: whether a vehicle is fit to fly in formation. Used by `companion doctor` and by the agent before `form`.

`Facts` -> `Finding`s. A vehicle may fly with warnings but not with refusals. The rules for parameters are those of the
autopilot type; the rest is the same for every autopilot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import dist

from companion.core.autopilot import FenceSide, Judgement, ParameterRule, SentFrom
from companion.core.autopilot import Verdict as Verdict
from companion.core.safety.fleet_checks import NO_ALTITUDE, ONE_ID_EACH, SET_ORIGIN, TWO_STREAMS
from companion.types.notices import Code
from companion.types.values import Place, Vector3

# PX4 sends CURRENT_MODE twice a second and at every change, regardless of requests; HEARTBEAT at 1 Hz alone is too slow.
MIN_RATES_HZ = {"positions": 40.0, "attitudes": 40.0, "modes": 1.5, "landed states": 2.0}
MAX_ROUND_TRIP_S = 0.1  # of a question and its answer: 0.5 to 3 ms at a serial port
LOW_BATTERY_PERCENT = 40.0  # a flight may begin, but not a long one
EMPTY_BATTERY_PERCENT = 20.0
MAX_HOVER_THRUST_DIFFERENCE = 0.1  # relative; above it vehicle file and autopilot describe different vehicles


class PositionCheck(StrEnum):
    """Position of the vehicle relative to the fence."""

    UNKNOWN = "no position"
    NO_ORIGIN = "position, but no origin of its local frame"
    OUTSIDE = "outside the fleet's fence"
    INSIDE = "inside the fleet's fence"


@dataclass(frozen=True, slots=True)
class FoundHome:
    """The autopilot's home: its distance from the vehicle in the plane, None where it is not reported.

    `elsewhere`: why its return may end at another place.
    """

    apart_m: float | None
    separation_m: float
    elsewhere: str = ""


@dataclass(frozen=True, slots=True)
class FleetFence:
    """What the autopilot's own fence, a cylinder about its home, must leave room for.

    `corners_enu_m` are those of the fleet's fence in the plane, `ceiling_m` is its height above the place of the take-off.
    While the home is unknown it counts as in the middle.
    """

    corners_enu_m: tuple[Place, ...]
    ceiling_m: float
    takeoff_height_m: float
    home_enu_m: Place | None = None

    @property
    def radius_m(self) -> float:
        """From home to the farthest corner."""
        easts, norths = zip(*self.corners_enu_m, strict=True)
        middle = ((min(easts) + max(easts)) / 2.0, (min(norths) + max(norths)) / 2.0)
        return max(dist(self.home_enu_m or middle, corner) for corner in self.corners_enu_m)


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts of one vehicle. None means that the caller does not check this; it gives no finding.

    `parameters` are all requested ones, with None for no answer. `rates_hz` has the keys of MIN_RATES_HZ. `battery_percent`
    is -1 where the autopilot does not know it. `failing_checks` is the reason of failing preflight checks, "" where they pass.
    `round_trip_s` is the shortest one to the autopilot and back. `missing` has the names of telemetry whose own message did
    not arrive at all; where `messages` of the autopilot type has words for it, they replace its rate.
    """

    rules: tuple[ParameterRule, ...]  # what the autopilot type demands of the parameters
    parameters: Mapping[str, float | None]
    hover_thrust_norm: float  # configured in the vehicle file
    rates_hz: Mapping[str, float] | None = None
    missing: Collection[str] = ()
    messages: Mapping[str, SentFrom] = field(default_factory=dict)
    interleaves: bool = False  # two streams with the autopilot's system id
    awaits_poses: bool = False  # which go to the agent alone: without them there is no position
    failing_checks: str | None = None
    position_check: PositionCheck | None = None
    position_enu_m: Vector3 | None = None
    lacks_altitude: bool = False  # with a position, but without the altitude that its take-off needs
    home: FoundHome | None = None  # of a vehicle on the ground with a position
    battery_percent: float | None = None
    round_trip_s: float | None = None
    mode_name: str | None = None
    armed: bool | None = None
    accepts_uncontrolled_descent: bool = False  # set in the vehicle file
    fence: FleetFence | None = None


@dataclass(frozen=True, slots=True)
class AuditFinding:
    """One line of the audit. `code` is None where the verdict is OK.

    `fix` is the value that may be set without asking a pilot; None where a person decides.
    """

    subject: str
    verdict: Verdict
    code: Code | None
    found: str
    wanted: str
    remedy: str = ""  # "" where nothing is to be done
    fix: float | None = None

    def __str__(self) -> str:
        """One sentence, for logs and replies."""
        return f"{self.subject}: {self.found}; wanted: {self.wanted}" + (f"; {self.remedy}" if self.remedy else "")


def audit(facts: Facts) -> tuple[AuditFinding, ...]:
    """All findings of these facts, in a fixed order."""
    return tuple(_findings(facts))


def worst(findings: tuple[AuditFinding, ...]) -> Verdict:
    """The worst verdict of these findings."""
    verdicts = {finding.verdict for finding in findings}
    return next(v for v in (Verdict.REFUSAL, Verdict.WARNING, Verdict.OK) if v in verdicts or v is Verdict.OK)


def _findings(facts: Facts) -> Iterator[AuditFinding]:
    if facts.interleaves:
        wanted = "one stream of one autopilot"
        yield AuditFinding("autopilot", Verdict.REFUSAL, Code.AUTOPILOT_ID_SHARED, TWO_STREAMS, wanted, ONE_ID_EACH)
    if facts.rates_hz is not None:
        for name, least_hz in MIN_RATES_HZ.items():
            if facts.awaits_poses and name == "positions":  # ArduCopter sends none before the first pose
                continue
            rate_hz, message = facts.rates_hz.get(name, 0.0), facts.messages.get(name)
            never = message is not None and name in facts.missing and rate_hz < least_hz
            yield _missing(name, message) if message and never else _rate(name, rate_hz, least_hz)
    if facts.round_trip_s is not None:
        yield _round_trip(facts.round_trip_s)
    if facts.awaits_poses:
        yield AuditFinding("position", Verdict.OK, None, "by poses, which only the agent gets", "judged by prepare")
    if facts.failing_checks is not None:
        yield _checks(facts.failing_checks)
    if facts.position_check is not None:
        yield _position(facts.position_check, facts.position_enu_m)
    if facts.lacks_altitude:
        wanted = "an origin (GPS_GLOBAL_ORIGIN)"
        yield AuditFinding("take-off", Verdict.REFUSAL, Code.ALTITUDE_UNKNOWN, NO_ALTITUDE, wanted, SET_ORIGIN)
    if facts.home is not None:
        yield _home(facts.home)
    if facts.battery_percent is not None:
        yield _battery(facts.battery_percent)
    if facts.armed is not None:
        yield _mode(facts.mode_name or "unknown", facts.armed)
    for rule in facts.rules:
        if rule.name in facts.parameters and rule.applies(facts.parameters):
            yield _parameter(rule, facts.parameters[rule.name], facts)


def _rate(name: str, rate_hz: float, least_hz: float) -> AuditFinding:
    wanted = f"at least {least_hz:g} Hz"
    if rate_hz >= least_hz:
        return AuditFinding(name, Verdict.OK, None, f"{rate_hz:.1f} Hz", wanted)
    remedy = "a faster line (baud rate), fewer other streams on it (MAV_x_RATE, SRx_*), or another port"
    return AuditFinding(name, Verdict.REFUSAL, Code.TELEMETRY_SLOW, f"{rate_hz:.1f} Hz", wanted, remedy)


def _missing(name: str, message: SentFrom) -> AuditFinding:
    """No line is so slow that nothing of a message arrives while others do."""
    wanted, found = f"{message.name}, which {message.senders} send", f"no {message.name}"
    return AuditFinding(name, Verdict.REFUSAL, Code.MESSAGE_MISSING, found, wanted, message.remedy)


def _round_trip(round_trip_s: float) -> AuditFinding:
    wanted = f"at most {1e3 * MAX_ROUND_TRIP_S:g} ms"
    found = f"{1e3 * round_trip_s:.1f} ms"
    if round_trip_s <= MAX_ROUND_TRIP_S:
        return AuditFinding("round trip", Verdict.OK, None, found, wanted)
    remedy = "a faster line, fewer streams on it (a full buffer delays all of them), or a wire in place of a radio"
    return AuditFinding("round trip", Verdict.REFUSAL, Code.TELEMETRY_LATE, found, wanted, remedy)


def _checks(reason: str) -> AuditFinding:
    wanted = "the autopilot's preflight checks pass"
    if not reason:
        return AuditFinding("estimator and checks", Verdict.OK, None, "passed", wanted)
    remedy = "wait for GPS and keep the vehicle still; a ground station shows the failing check"
    return AuditFinding("estimator and checks", Verdict.REFUSAL, Code.ARMING_CHECKS_FAILED, reason, wanted, remedy)


def _position(check: PositionCheck, position_enu_m: Vector3 | None) -> AuditFinding:
    wanted = PositionCheck.INSIDE.value
    found = check.value
    if position_enu_m is not None and check in (PositionCheck.INSIDE, PositionCheck.OUTSIDE):
        found += " at " + ", ".join(f"{coordinate:z.1f}" for coordinate in position_enu_m) + " m"
    match check:
        case PositionCheck.INSIDE:
            return AuditFinding("origin", Verdict.OK, None, found, wanted)
        case PositionCheck.OUTSIDE:
            code = Code.POSITION_OUTSIDE_FENCE
            remedy = "correct origin or envelope.fence_* of the fleet file, or move the vehicle into the fence"
        case PositionCheck.NO_ORIGIN:
            code = Code.ORIGIN_MISSING
            remedy = "wait for the position fix; without GPS set the origin (SET_GPS_GLOBAL_ORIGIN) or origin: indoor"
        case _:
            code = Code.POSITION_MISSING
            remedy = "wait for the estimator; LOCAL_POSITION_NED starts when it has a position"
    return AuditFinding("origin", Verdict.REFUSAL, code, found, wanted, remedy)


def _home(home: FoundHome) -> AuditFinding:
    """A vehicle may fly without: `return` is refused, and the failsafe lands instead."""
    wanted = f"HOME_POSITION within separation_m of the vehicle, {home.separation_m:g} m"
    if home.elsewhere:
        remedy = "clear the rally points, or expect `return` to be refused"
        return AuditFinding("home", Verdict.WARNING, Code.RETURNS_ELSEWHERE, home.elsewhere, wanted, remedy)
    if home.apart_m is None:
        remedy = "wait for the position fix, or expect `return` to be refused"
        return AuditFinding("home", Verdict.WARNING, Code.HOME_UNKNOWN, "not reported", wanted, remedy)
    found = f"{home.apart_m:.1f} m from the vehicle"
    if home.apart_m < home.separation_m:
        return AuditFinding("home", Verdict.OK, None, found, wanted)
    remedy = "`return` ends there; set the home to where the vehicle stands, unless arming does so"
    return AuditFinding("home", Verdict.WARNING, Code.HOME_ELSEWHERE, found, wanted, remedy)


def _battery(percent: float) -> AuditFinding:
    wanted = f"at least {LOW_BATTERY_PERCENT:g} %"
    if percent < 0.0:
        remedy = "calibrate the battery monitor of the autopilot"
        return AuditFinding("battery", Verdict.WARNING, Code.BATTERY_UNKNOWN, "not reported", wanted, remedy)
    if percent >= LOW_BATTERY_PERCENT:
        return AuditFinding("battery", Verdict.OK, None, f"{percent:.0f} %", wanted)
    verdict = Verdict.REFUSAL if percent < EMPTY_BATTERY_PERCENT else Verdict.WARNING
    return AuditFinding("battery", verdict, Code.BATTERY_LOW, f"{percent:.0f} %", wanted, "charge or change it")


def _mode(mode_name: str, armed: bool) -> AuditFinding:
    wanted = "disarmed"
    if armed:
        remedy = "land and disarm first; nothing is set while the vehicle is armed"
        return AuditFinding("mode", Verdict.WARNING, Code.VEHICLE_ARMED, f"{mode_name}, armed", wanted, remedy)
    return AuditFinding("mode", Verdict.OK, None, f"{mode_name}, disarmed", wanted)


def _parameter(rule: ParameterRule, value: float | None, facts: Facts) -> AuditFinding:
    wanted = rule.wanted if rule.judge else f"{rule.wanted}, {facts.hover_thrust_norm:g}"
    if value is None:
        remedy = "update the firmware, or check the link for packet loss"
        verdict = _accepted(rule.not_found, facts)
        return AuditFinding(rule.name, verdict, Code.PARAMETER_MISSING, "not found", wanted, remedy)
    if rule.judge is None:
        return _hover_thrust(rule, value, facts.hover_thrust_norm, wanted)
    judgement = rule.judge(value)
    found = f"{value:g} {rule.unit}".rstrip() + (f" ({judgement.meaning})" if judgement.meaning else "")
    if judgement.verdict is Verdict.OK and rule.fence_side and facts.fence:
        return _fence(rule, rule.fence_side, value, facts.fence, rule.acts(facts.parameters))
    if judgement.verdict is Verdict.OK:
        return AuditFinding(rule.name, Verdict.OK, None, found, wanted)
    fix = rule.safe(value) if rule.safe else None
    remedy = f"set {rule.name} to {fix:g}" if fix is not None else rule.remedy
    return AuditFinding(rule.name, _accepted(judgement, facts), rule.code, found, wanted, remedy, fix)


def _fence(rule: ParameterRule, side: FenceSide, metres: float, fleet: FleetFence, acts: bool) -> AuditFinding:
    """A fence of the autopilot in which the vehicle cannot take off, or that is inside the fleet's."""
    least_m = fleet.ceiling_m if side is FenceSide.CEILING else fleet.radius_m
    wanted = f"at least {least_m:.1f} m {side.value}, as the fleet's fence"
    if metres >= least_m:
        return AuditFinding(rule.name, Verdict.OK, None, f"{metres:g} m", wanted)
    found, verdict = f"{metres:g} m (inside the fleet's fence: the autopilot stops the vehicle there)", Verdict.WARNING
    if side is FenceSide.CEILING and metres <= fleet.takeoff_height_m:
        found = f"{metres:g} m (not above the take-off height, {fleet.takeoff_height_m:g} m)"
        verdict = Verdict.REFUSAL if acts else Verdict.WARNING
    return AuditFinding(rule.name, verdict, Code.AUTOPILOT_FENCE_SMALL, found, wanted, rule.remedy)


def _accepted(judgement: Judgement, facts: Facts) -> Verdict:
    """The verdict, after what the vehicle file accepts."""
    return Verdict.WARNING if judgement.acceptable and facts.accepts_uncontrolled_descent else judgement.verdict


def _hover_thrust(rule: ParameterRule, value: float, hover_thrust_norm: float, wanted: str) -> AuditFinding:
    if abs(value - hover_thrust_norm) <= MAX_HOVER_THRUST_DIFFERENCE * max(value, hover_thrust_norm):
        return AuditFinding(rule.name, Verdict.OK, None, f"{value:.3g}", wanted)
    return AuditFinding(rule.name, Verdict.WARNING, rule.code, f"{value:.3g}", wanted, rule.remedy)
