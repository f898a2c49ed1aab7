"""What the core knows of an autopilot: its profile, the procedures that carry out commands, and the rules for its parameters.

What differs between the autopilot types is an `AutopilotProfile`: its data is in the folder of each type,
`companion/mavlink/TYPE/profile.py`, and reaches the core through `companion/assembly.py`.

A procedure is a request to the autopilot, repeated until telemetry shows its effect, or given up with the reason. A COMMAND_ACK
is no proof (PX4 may accept a mode change and then refuse it); it only gives the reason of a failure. A parameter value that is
set automatically never weakens a failsafe or takes control from the pilot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from math import inf
from operator import attrgetter

from companion.types.autopilot import (
    AckSample,
    Arm,
    AutopilotKind,
    AutopilotMode,
    AutopilotRequest,
    Disarm,
    LandedState,
    SetMode,
    TakeOff,
    Telemetry,
    TextSample,
    VehicleState,
    in_air,
)
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code

# From a commanded to the flown acceleration: the mean delay of the attitude step response, measured with PX4 (docs/law.md).
# The linear model of companion/analysis takes it from here.
LAG_S = 0.2

M = AutopilotMode
TEXTS_KEPT = 3
CLIMBED_WITHIN_M = 0.3

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
    is not `taken` within `taken_within_s` has failed, before `timeout_s`, and so has one that is not taken for
    `refused_for_s` after a COMMAND_ACK has refused it.
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
    refused_for_s: float = inf


@dataclass(slots=True)
class RunningProcedure:
    """A procedure under way: what was sent and what the autopilot answered."""

    procedure: Procedure
    started_s: float
    _next_s: float = field(init=False)
    _sent_s: float | None = None
    _accepted: bool = False
    _refusal: str = ""  # text of the last refusing COMMAND_ACK
    _refused_s: float = inf  # when the first refusing one came
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
                    self._refused_s = min(self._refused_s, sample.received_s)
            elif isinstance(sample, TextSample) and sample.severity <= 4:  # MAV_SEVERITY_WARNING and worse
                others = [text for text in self._texts if text != sample.text]
                self._texts = (*others, sample.text)[-TEXTS_KEPT:]

    def progress(self, now_s: float, vehicle: VehicleState) -> Progress:
        elapsed_s = now_s - self.started_s
        new = self._sent_s is not None and self.procedure.truth_time(vehicle) > self._sent_s
        if new and elapsed_s >= self.procedure.settle_s and self.procedure.done(vehicle):
            return Progress.DONE
        overdue = elapsed_s > self.procedure.taken_within_s or now_s - self._refused_s > self.procedure.refused_for_s
        refused = overdue and not self.procedure.taken(vehicle)
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


class Verdict(StrEnum):
    """Result of a check. A vehicle may fly with warnings but not with refusals."""

    OK = "ok"
    WARNING = "warning"
    REFUSAL = "refusal"


OK, WARNING, REFUSAL = Verdict.OK, Verdict.WARNING, Verdict.REFUSAL

# The agent leaves its formation after 0.5 s of silence. An autopilot with a shorter timeout would accept a stream that
# returns and continue without a command.
SHORTEST_TIMEOUT_S = 0.6


@dataclass(frozen=True, slots=True)
class Judgement:
    """Verdict on a value. `meaning` is what the autopilot does with it.

    `acceptable`: with `accept_uncontrolled_descent` in the vehicle file this refusal is a warning, as a pilot stands by.
    """

    verdict: Verdict
    meaning: str = ""
    acceptable: bool = False


Values = Mapping[str, float | None]
"""Parameters by name; None where there is no answer."""


class FenceSide(Enum):
    """What a parameter of the autopilot's fence limits, in metres from home."""

    RADIUS = "around home"
    CEILING = "above home"


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """Rule for one parameter. With `judge` None it is compared with the hover thrust of the vehicle file.

    `safe` gives the value that may be set instead of a bad one; without it a person decides, with the help of `remedy`.
    `applies`: whether it means anything beside these others. A `fence_side` is compared with the fleet's fence; `acts`:
    whether the autopilot does more than report a breach.
    """

    name: str
    code: Code
    wanted: str
    judge: Callable[[float], Judgement] | None
    safe: Callable[[float], float] | None = None
    unit: str = ""
    remedy: str = ""
    not_found: Judgement = Judgement(WARNING)
    applies: Callable[[Values], bool] = lambda _values: True
    fence_side: FenceSide | None = None
    acts: Callable[[Values], bool] = lambda _values: True


def one_of(meanings: dict[int, Judgement], otherwise: Judgement) -> Callable[[float], Judgement]:
    """Judges a value that names an action."""
    return lambda value: meanings.get(round(value), otherwise)


def differs(name: str, *values: int) -> Callable[[Values], bool]:
    """Whether this parameter has another value, or is not known."""
    return lambda found: found.get(name) not in values


def has_bit(name: str, bit: int) -> Callable[[Values], bool]:
    """Whether this bit is set, or the parameter is not known."""

    def is_set(found: Values) -> bool:
        value = found.get(name)
        return value is None or bool(int(value) & bit)

    return is_set


def with_bit(bit: int) -> Callable[[float], float]:
    """The safe value: this bit set, the others as they are."""
    return lambda value: float(int(value) | bit)


def always(value: float) -> Callable[[float], float]:
    """The safe value, whatever was found."""
    return lambda _found: value


NEAR_CONFIGURED = "near hover_thrust_norm of the vehicle file"
HOVER = "hover the vehicle, then correct the wrong value"
PILOTS_CHOICE = "set {} to 0, or expect each vehicle to leave the formation separately"
WIDER_FENCE = "set {} a little wider than the fleet's fence (envelope.fence_*), or make that smaller"


@dataclass(frozen=True, slots=True)
class SentFrom:
    """A message, the versions that send it, and what to do where it does not arrive."""

    name: str
    senders: str
    remedy: str


ProcedureBuilder = Callable[[VehicleState, float], Procedure]
"""(state, take-off height in metres) -> procedure. Raises ValueError where the state does not allow it."""


@dataclass(frozen=True, slots=True)
class AutopilotProfile:
    """`modes`: the modes of each phase; a running procedure also tolerates the mode in which it began.

    `procedures`: all commands that reach the autopilot. `flies_on_in_silence`: when the stream ends, the autopilot continues
    the last attitude and thrust for seconds, so the last setpoint must be safe to continue. `parameters`: what the audit
    checks, in its order, and `vision_parameters` where poses take the place of GPS; those in `decide_in_silence` decide what
    the autopilot does when setpoints end. `messages`: the message of each kind of telemetry whose rate is checked.
    """

    modes: Mapping[FlightPhase, frozenset[AutopilotMode]]
    procedures: Mapping[CommandName, ProcedureBuilder]
    flies_on_in_silence: bool
    takes_off_by_altitude: bool  # above sea level, so it needs an origin; else by a height
    parameters: tuple[ParameterRule, ...]
    vision_parameters: tuple[ParameterRule, ...]
    decide_in_silence: tuple[str, ...]
    messages: Mapping[str, SentFrom]

    @property
    def hover_parameter(self) -> str:
        """Name of the parameter with the hover thrust: the one that is compared with the vehicle file."""
        return next(rule.name for rule in self.parameters if rule.judge is None)


Profiles = Mapping[AutopilotKind, AutopilotProfile]


def profile_of(vehicle: VehicleState, profiles: Profiles) -> AutopilotProfile:
    """Profile of this vehicle's autopilot. Raises LookupError before its first HEARTBEAT."""
    if vehicle.autopilot is None:
        raise LookupError("no HEARTBEAT has come from the autopilot yet")
    return profiles[vehicle.autopilot]


def mode_is(mode: AutopilotMode) -> Truth:
    """Whether the vehicle is in this mode."""
    return lambda vehicle: vehicle.mode is mode


def _disarmed(vehicle: VehicleState) -> bool:
    return not vehicle.armed


_armed: Truth = attrgetter("armed")
mode_time_s: Callable[[VehicleState], float] = attrgetter("mode_time_s")
_heartbeat_time_s: Callable[[VehicleState], float] = attrgetter("heartbeat_time_s")


def hold(_vehicle: VehicleState, _height_m: float) -> Procedure:
    """The autopilot's own hold."""
    # settle_s: an OFFBOARD request sent just before the hold may still arrive after the hold looked done.
    # refused_for_s: two more requests. A vehicle that cannot hold drifts until something else is asked of it.
    held = mode_is(M.HOLD)
    return Procedure(SetMode(M.HOLD), held, held, mode_time_s, timeout_s=5.0, settle_s=0.2, refused_for_s=1.0)


def arm(_vehicle: VehicleState, _height_m: float) -> Procedure:
    """Motors on."""
    # Not repeated once accepted, as a pilot may have disarmed meanwhile. HEARTBEAT shows it only once a second.
    return Procedure(Arm(), _armed, _armed, _heartbeat_time_s, timeout_s=10.0, repeat_s=1.5, acceptance_counts=True)


def disarm(_vehicle: VehicleState, _height_m: float) -> Procedure:
    """Motors off."""
    return Procedure(Disarm(), _disarmed, _disarmed, _heartbeat_time_s, timeout_s=5.0)


def land(_vehicle: VehicleState, _height_m: float) -> Procedure:
    """Land where the vehicle is."""
    # On the ground only disarming remains, in whatever mode.
    return Procedure(SetMode(M.LAND), _mode_or_landed(M.LAND), _disarmed, _heartbeat_time_s, timeout_s=120.0)


def return_home(_vehicle: VehicleState, _height_m: float) -> Procedure:
    """Fly home and land, by the autopilot alone."""
    # No time limit: the autopilot decides, and waits above home for ever where it is configured to.
    return Procedure(
        SetMode(M.RETURN), _mode_or_landed(M.RETURN), _disarmed, _heartbeat_time_s, timeout_s=inf, taken_within_s=5.0
    )


def _mode_or_landed(mode: AutopilotMode) -> Truth:
    return lambda vehicle: vehicle.mode is mode or vehicle.landed is LandedState.ON_GROUND


def climb(vehicle: VehicleState, take_off: TakeOff, has_ended: Truth) -> Procedure:
    """A take-off to the height of this request."""
    height_m = take_off.height_m
    target_z_m = vehicle.position_enu_m[2] + height_m
    return Procedure(
        take_off,
        taken=lambda v: v.mode is M.TAKEOFF or in_air(v),
        done=lambda v: has_ended(v) and abs(v.position_enu_m[2] - target_z_m) < CLIMBED_WITHIN_M,
        truth_time=mode_time_s,
        timeout_s=15.0 + 2.0 * height_m,
    )


# What is the same for every autopilot type; a profile adds the rest.
MODES: dict[FlightPhase, frozenset[AutopilotMode]] = {
    FlightPhase.RELEASE: frozenset({M.HOLD}),
    FlightPhase.LAND: frozenset({M.LAND}),
    FlightPhase.RETURN: frozenset({M.RETURN}),
}
PROCEDURES: dict[CommandName, ProcedureBuilder] = {
    CommandName.ARM: arm,
    CommandName.HOLD: hold,
    CommandName.LAND: land,
    CommandName.RETURN: return_home,
    CommandName.DISARM: disarm,
}
