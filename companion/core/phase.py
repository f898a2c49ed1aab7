"""Flight phases: the table of what a command does from where, and the machine that walks it.

The pilot always wins: whenever the autopilot's mode is not one that this phase commanded, the agent falls back to OBSERVE
and sends nothing until it is told to again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from companion.core.procedure import Procedure, Progress, RunningProcedure
from companion.types import (
    Arm,
    AutopilotMode,
    AutopilotRequest,
    CommandName,
    Disarm,
    FlightPhase,
    LandedState,
    SetMode,
    TakeOff,
    Telemetry,
    VehicleState,
)

P, M, C = FlightPhase, AutopilotMode, CommandName

STREAM_BEFORE_OFFBOARD_S = 0.3  # PX4 takes OFFBOARD only from a running stream
CLIMBED_WITHIN_M = 0.3


def _mode_is(mode: AutopilotMode) -> Callable[[VehicleState], bool]:
    return lambda vehicle: vehicle.mode is mode


def _armed(vehicle: VehicleState) -> bool:
    return vehicle.armed


def _disarmed(vehicle: VehicleState) -> bool:
    return not vehicle.armed


def in_air(vehicle: VehicleState) -> bool:
    """Armed and not known to stand on the ground: doubt counts as flying."""
    return vehicle.armed and vehicle.landed is not LandedState.ON_GROUND


def _mode_time_s(vehicle: VehicleState) -> float:
    return vehicle.mode_time_s


def _heartbeat_time_s(vehicle: VehicleState) -> float:
    return vehicle.heartbeat_time_s


def _hold(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # The settling time: an OFFBOARD request sent just before a hold may still arrive after it looked done.
    held = _mode_is(M.HOLD)
    return Procedure(SetMode(M.HOLD), held, held, _mode_time_s, timeout_s=5.0, settle_s=0.2)


def _offboard(_vehicle: VehicleState, _height_m: float) -> Procedure:
    taken = _mode_is(M.OFFBOARD)
    return Procedure(SetMode(M.OFFBOARD), taken, taken, _mode_time_s, timeout_s=5.0, delay_s=STREAM_BEFORE_OFFBOARD_S)


def _arm(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # Once accepted it is never asked again: who disarms meanwhile means it. HEARTBEAT shows it only once a second.
    return Procedure(Arm(), _armed, _armed, _heartbeat_time_s, timeout_s=10.0, repeat_s=1.5, acceptance_counts=True)


def _disarm(_vehicle: VehicleState, _height_m: float) -> Procedure:
    return Procedure(Disarm(), _disarmed, _disarmed, _heartbeat_time_s, timeout_s=5.0)


def _land(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # On the ground there is only the disarming to wait for, whatever mode is shown or set there.
    return Procedure(SetMode(M.LAND), _lands_or_has_landed, _disarmed, _heartbeat_time_s, timeout_s=120.0)


def _lands_or_has_landed(vehicle: VehicleState) -> bool:
    return vehicle.mode is M.LAND or vehicle.landed is LandedState.ON_GROUND


def _take_off(vehicle: VehicleState, height_m: float) -> Procedure:
    if vehicle.altitude_amsl_m is None:
        raise ValueError("the autopilot's altitude above sea level is unknown")
    target_z_m = vehicle.position_enu_m[2] + height_m
    return Procedure(
        TakeOff(vehicle.altitude_amsl_m + height_m, height_m),
        taken=lambda v: v.mode is M.TAKEOFF or in_air(v),
        done=lambda v: v.mode is M.HOLD and abs(v.position_enu_m[2] - target_z_m) < CLIMBED_WITHIN_M,
        truth_time=_mode_time_s,
        timeout_s=15.0 + 2.0 * height_m,
    )


@dataclass(frozen=True, slots=True)
class Rule:
    """A command: allowed from where, the phase while it is under way, the phase it leads to, and where a failure leads."""

    allowed: frozenset[FlightPhase]
    via: FlightPhase
    to: FlightPhase
    on_failure: FlightPhase
    on_ground: bool  # where the vehicle must be: on the ground or in the air
    procedure: Callable[[VehicleState, float], Procedure]  # ValueError where the state does not allow it


ON_GROUND = frozenset({P.PREPARE, P.READY, P.ARM, P.ARMED})
FLYING = frozenset({P.TAKEOFF, P.HOLD, P.ENGAGE, P.FORMATION, P.RELEASE, P.LAND})

LEAD_CHANGES_IN = ON_GROUND | {P.HOLD, P.FORMATION}

# All commands but LEAD, which changes no phase.
RULES: dict[CommandName, Rule] = {
    C.PREPARE: Rule(frozenset({P.OBSERVE}), P.PREPARE, P.READY, P.OBSERVE, True, _hold),
    C.ARM: Rule(frozenset({P.READY}), P.ARM, P.ARMED, P.READY, True, _arm),
    C.TAKEOFF: Rule(frozenset({P.ARMED}), P.TAKEOFF, P.HOLD, P.OBSERVE, True, _take_off),
    C.FORM: Rule(frozenset({P.HOLD}), P.ENGAGE, P.FORMATION, P.HOLD, False, _offboard),
    C.HOLD: Rule(FLYING | {P.OBSERVE}, P.RELEASE, P.HOLD, P.OBSERVE, False, _hold),
    C.LAND: Rule(FLYING | {P.OBSERVE}, P.LAND, P.OBSERVE, P.OBSERVE, False, _land),
    C.DISARM: Rule(ON_GROUND | {P.OBSERVE}, P.LAND, P.OBSERVE, P.OBSERVE, True, _disarm),
}

# The modes that a phase brings about. While its procedure runs it tolerates the mode that it began in, too.
MODES: dict[FlightPhase, frozenset[AutopilotMode]] = {
    P.PREPARE: frozenset({M.HOLD}),
    P.READY: frozenset({M.HOLD}),
    P.ARM: frozenset({M.HOLD}),
    P.ARMED: frozenset({M.HOLD}),
    P.TAKEOFF: frozenset({M.TAKEOFF, M.HOLD}),
    P.HOLD: frozenset({M.HOLD}),
    P.ENGAGE: frozenset({M.HOLD, M.OFFBOARD}),
    P.FORMATION: frozenset({M.OFFBOARD}),
    P.RELEASE: frozenset({M.HOLD}),
    P.LAND: frozenset({M.LAND}),
}


class PhaseMachine:
    """Where in the flight the agent is. All it wants of the autopilot comes out of `advance`."""

    def __init__(self, takeoff_height_m: float) -> None:
        self._takeoff_height_m = takeoff_height_m
        self.phase = P.OBSERVE
        self._rule: Rule | None = None
        self._running: RunningProcedure | None = None
        self._leaving_formation = False
        self._tolerated: frozenset[AutopilotMode] = frozenset()
        self.events: list[str] = []

    def streams(self, vehicle: VehicleState) -> bool:
        """True while attitude targets go out: just before formation, in it, and until the autopilot has taken over."""
        if self.phase in (P.ENGAGE, P.FORMATION):
            return True
        return self._leaving_formation and vehicle.mode is M.OFFBOARD

    def command(self, name: CommandName, now_s: float, vehicle: VehicleState) -> tuple[bool, str]:
        """(accepted, why not or what happens now). A command that is under way or done already is accepted again."""
        rule = RULES[name]
        if self._rule is rule or (self._rule is None and self.phase is rule.to is not P.OBSERVE):
            return True, f"already {self.phase}"
        if self.phase not in rule.allowed:
            return False, f"{name} is not possible in phase {self.phase}, only in {', '.join(sorted(rule.allowed))}"
        if rule.on_ground is in_air(vehicle):
            return False, f"{name} needs the vehicle {'on the ground' if rule.on_ground else 'in the air'}"
        try:
            self._begin(rule, now_s, vehicle, f"command {name}")
        except ValueError as error:
            return False, f"{name}: {error}"
        return True, f"{self.phase}"

    @property
    def in_formation(self) -> bool:
        """Formation is flown, or was until just now: the reference's time runs."""
        return self.phase is P.FORMATION or (self.phase is P.RELEASE and self._leaving_formation)

    def refusal_of_lead(self, vehicle: VehicleState) -> str:
        """Why the lead cannot change now; "" where it can.

        In formation it changes in flight, in hold and on the ground before the next formation. A vehicle that climbs, lands or
        is flown by its pilot is no part of it; it hears of the new epoch from the others.
        """
        if self.phase in LEAD_CHANGES_IN or (self.phase is P.OBSERVE and not in_air(vehicle)):
            return ""
        return f"lead is not possible in phase {self.phase}, only in formation, in hold or on the ground"

    def hand_over(self, now_s: float, vehicle: VehicleState, reason: str) -> None:
        """Leave formation for the autopilot's own hold."""
        if self.phase in (P.ENGAGE, P.FORMATION):
            self._begin(RULES[C.HOLD], now_s, vehicle, reason)

    def give_up(self, reason: str) -> None:
        """Back to OBSERVE: nothing more is sent until a command comes."""
        self._enter(P.OBSERVE, reason)

    def end_stream(self) -> None:
        """No more setpoints, but whatever was asked of the autopilot is still asked."""
        self._leaving_formation = False

    def advance(
        self, now_s: float, vehicle: VehicleState, telemetry: Iterable[Telemetry]
    ) -> tuple[AutopilotRequest, ...]:
        """One tick of the procedure under way; what is to be asked of the autopilot now."""
        if self._running is None or self._rule is None:
            return ()
        self._running.hear(telemetry)
        match self._running.progress(now_s, vehicle):
            case Progress.DONE:
                self._enter(self._rule.to)
                return ()
            case Progress.FAILED:
                self._enter(self._rule.on_failure, f"{self.phase} failed: {self._running.reason}")
                return ()
        return self._running.due(now_s, vehicle)

    def _begin(self, rule: Rule, now_s: float, vehicle: VehicleState, reason: str) -> None:
        running = RunningProcedure(rule.procedure(vehicle, self._takeoff_height_m), now_s)
        leaving = self.streams(vehicle) and rule.via is not P.ENGAGE
        self._enter(rule.via, reason)
        self._rule = rule
        self._leaving_formation = leaving
        self._tolerated = frozenset({vehicle.mode}) | ({M.OFFBOARD} if leaving else frozenset())
        self._running = running

    def _enter(self, phase: FlightPhase, reason: str = "") -> None:
        if phase is not self.phase or reason:
            self.events.append(f"{self.phase} -> {phase}" + (f" ({reason})" if reason else ""))
        self.phase = phase
        self._rule = None
        self._running = None
        self._leaving_formation = False
        self._tolerated = frozenset()

    def follow_truth(self, vehicle: VehicleState) -> None:
        """Someone else changed the mode, armed, disarmed or took off: observe. Comes before anything else in a tick."""
        must_be_armed = self.phase is P.ARMED or (self.phase in FLYING and self.phase is not P.LAND)
        if must_be_armed and not vehicle.armed:
            self._enter(P.OBSERVE, "the autopilot disarmed")
        elif self.phase in ON_GROUND and in_air(vehicle):
            self._enter(P.OBSERVE, "someone else flies")
        elif (vehicle.armed or self.phase in ON_GROUND) and not self._mode_is_ours(vehicle):
            self._enter(P.OBSERVE, f"mode {vehicle.mode_name} was set by someone else")

    def _mode_is_ours(self, vehicle: VehicleState) -> bool:
        own = MODES.get(self.phase)
        if self.phase is P.LAND and vehicle.landed is LandedState.ON_GROUND:
            return True  # at disarming PX4 changes its mode, and shows that before it shows that it is disarmed
        if own is None or vehicle.mode in own:
            if self.phase is P.LAND and self._rule is RULES[C.LAND]:
                # Landing has begun: any other mode from now on is the pilot's, and nothing is left to hand over.
                self._tolerated = frozenset()
                self._leaving_formation = False
            return True
        return vehicle.mode in self._tolerated
