"""Flight phases: the table of what a command does from where, and the machine that walks it.

The pilot always wins: whenever the autopilot's mode is not one that this phase commanded, the agent falls back to OBSERVE
and sends nothing until it is told to again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from companion.core.flight_manners import in_air, manners_of
from companion.core.procedure import Progress, RunningProcedure
from companion.types import (
    AutopilotMode,
    AutopilotRequest,
    CommandName,
    FlightPhase,
    LandedState,
    Telemetry,
    VehicleState,
)

P, M, C = FlightPhase, AutopilotMode, CommandName

LEVEL_BEFORE_HAND_OVER_S = 0.25  # autopilots begin their own hold level, whatever was flown before
TAKES_OVER_WITHIN_S = 0.25  # both do it within 50 ms of being asked


@dataclass(frozen=True, slots=True)
class Rule:
    """A command: allowed from where, the phase while it is under way, the phase it leads to, and where a failure leads.

    A failure that leads to RELEASE is answered with a hold.
    """

    allowed: frozenset[FlightPhase]
    via: FlightPhase
    to: FlightPhase
    on_failure: FlightPhase
    on_ground: bool  # where the vehicle must be: on the ground or in the air


ON_GROUND = frozenset({P.PREPARE, P.READY, P.ARM, P.ARMED})
FLYING = frozenset({P.TAKEOFF, P.HOLD, P.ENGAGE, P.FORMATION, P.RELEASE, P.LAND, P.RETURN})
STREAMING = frozenset({P.ENGAGE, P.FORMATION})
TO_THE_GROUND = frozenset({P.LAND, P.RETURN})  # by the autopilot alone
FLOWN_BY_OTHERS = frozenset({M.LAND, M.RETURN, M.OTHER})  # while the agent observes: by a pilot or a failsafe
MUST_BE_ARMED = {P.ARMED} | FLYING - TO_THE_GROUND

LEAD_CHANGES_IN = ON_GROUND | {P.HOLD, P.FORMATION}

# All commands that bring about a phase; LEAD, FORMATION and TAKE change none, and ABORT is one of these.
RULES: dict[CommandName, Rule] = {
    C.PREPARE: Rule(frozenset({P.OBSERVE}), P.PREPARE, P.READY, P.OBSERVE, True),
    C.ARM: Rule(frozenset({P.READY}), P.ARM, P.ARMED, P.READY, True),
    C.TAKEOFF: Rule(frozenset({P.ARMED}), P.TAKEOFF, P.HOLD, P.OBSERVE, True),
    C.FORM: Rule(frozenset({P.HOLD}), P.ENGAGE, P.FORMATION, P.HOLD, False),
    C.HOLD: Rule(FLYING | {P.OBSERVE}, P.RELEASE, P.HOLD, P.OBSERVE, False),
    C.LAND: Rule(FLYING | {P.OBSERVE}, P.LAND, P.OBSERVE, P.OBSERVE, False),
    C.RETURN: Rule(STREAMING | {P.HOLD, P.RELEASE}, P.RETURN, P.OBSERVE, P.RELEASE, False),
    C.DISARM: Rule(ON_GROUND | {P.OBSERVE}, P.LAND, P.OBSERVE, P.OBSERVE, True),
}


class PhaseMachine:
    """Where in the flight the agent is. All it wants of the autopilot comes out of `advance`."""

    def __init__(self, takeoff_height_m: float) -> None:
        self._takeoff_height_m = takeoff_height_m
        self.phase = P.OBSERVE
        self._rule: Rule | None = None
        self._running: RunningProcedure | None = None
        self._leaving_formation = False
        self._level_until_s = float("-inf")  # of a hand-over
        self._tolerated: frozenset[AutopilotMode] = frozenset()
        self.events: list[str] = []

    def streams(self, vehicle: VehicleState) -> bool:
        """True while attitude targets go out: just before formation, in it, and until the autopilot has taken over."""
        if self.phase in STREAMING:
            return True
        return self._leaving_formation and vehicle.mode is M.OFFBOARD

    def has_handed_over(self, vehicle: VehicleState) -> bool:
        """No setpoint stream is left that the autopilot would miss."""
        return self.phase is not P.RELEASE and not self.streams(vehicle)

    def hands_over_level(self, now_s: float) -> bool:
        """In a hand-over from formation, until the autopilot should have taken over long since."""
        return self._leaving_formation and now_s < self._level_until_s

    def command(self, name: CommandName, now_s: float, vehicle: VehicleState) -> tuple[bool, str]:
        """(accepted, why not or what happens now). A command that is under way or done already is accepted again."""
        if vehicle.autopilot is None:
            return False, f"{name}: no HEARTBEAT has come from the autopilot yet"
        rule = RULES[name]
        if self._rule is rule or (self._rule is None and self.phase is rule.to is not P.OBSERVE):
            return True, f"already {self.phase}"
        if self.phase not in rule.allowed:
            return False, f"{name} is not possible in phase {self.phase}, only in {', '.join(sorted(rule.allowed))}"
        if rule.on_ground is in_air(vehicle):
            return False, f"{name} needs the vehicle {'on the ground' if rule.on_ground else 'in the air'}"
        try:
            self._begin(name, now_s, vehicle, f"command {name}")
        except ValueError as error:
            return False, f"{name}: {error}"
        return True, f"{self.phase}"

    def abort(self, now_s: float, vehicle: VehicleState) -> tuple[bool, str]:
        """(accepted, why not or what happens now), from every phase: disarmed on the ground, in the air into the own hold.

        Who lands goes on landing, also at the end of a return, and who is flown by a pilot is left to him. Who is still on its
        way home stops there.
        """
        if vehicle.autopilot is None:
            return False, "abort: no HEARTBEAT has come from the autopilot yet"
        if self.phase is P.LAND or (self.phase is P.RETURN and vehicle.landed is LandedState.LANDING):
            return True, "goes on landing"
        if not in_air(vehicle):
            # Who was flying a moment ago lands, which disarms as well: a landed state may be wrong, and then motors would stop.
            lands = self.phase in FLYING - {P.TAKEOFF}
            self._begin(C.LAND if lands else C.DISARM, now_s, vehicle, "command abort")
            return True, "lands" if lands else "disarms"
        if self.phase is P.OBSERVE and vehicle.mode in FLOWN_BY_OTHERS:
            return True, f"left to who flies it, in mode {vehicle.mode_name}"
        return self.command(C.HOLD, now_s, vehicle)

    @property
    def in_formation(self) -> bool:
        """Formation is flown, or was until just now: the reference's time runs."""
        return self.phase is P.FORMATION or (self.phase is P.RELEASE and self._leaving_formation)

    def stands(self, vehicle: VehicleState) -> bool:
        """On the ground, before a take-off or after a landing."""
        return not vehicle.armed or self.phase in ON_GROUND

    def refusal_of_lead(self, vehicle: VehicleState) -> str:
        """Why the lead cannot change now; "" where it can.

        In formation it changes in flight, in hold and on the ground before the next formation. A vehicle that climbs, lands or
        is flown by its pilot is no part of it; it hears of the new epoch from the others.
        """
        if self.phase in LEAD_CHANGES_IN or (self.phase is P.OBSERVE and not in_air(vehicle)):
            return ""
        return f"lead is not possible in phase {self.phase}, only in formation, in hold or on the ground"

    def hand_over(self, now_s: float, vehicle: VehicleState, reason: str) -> None:
        """Leave formation for the autopilot's own hold, level first."""
        if self.phase in STREAMING:
            self._begin(C.HOLD, now_s, vehicle, reason)

    def hand_over_silently(self, now_s: float, vehicle: VehicleState, reason: str) -> None:
        """The same, at once, where nothing more can be said of the attitude."""
        if self.phase in STREAMING:
            self._begin(C.HOLD, now_s, vehicle, reason, level_first_s=0.0)

    def land(self, now_s: float, vehicle: VehicleState, reason: str) -> None:
        """Out of the autopilot's own hold, by its own landing."""
        if self.phase is P.HOLD:
            self._begin(C.LAND, now_s, vehicle, reason)

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
                failure = f"{self.phase} failed: {self._running.reason}"
                if self._rule.on_failure is P.RELEASE:
                    self._begin(C.HOLD, now_s, vehicle, failure)
                else:
                    self._enter(self._rule.on_failure, failure)
                return ()
        return self._running.due(now_s, vehicle)

    def _begin(
        self,
        name: CommandName,
        now_s: float,
        vehicle: VehicleState,
        reason: str,
        level_first_s: float = LEVEL_BEFORE_HAND_OVER_S,
    ) -> None:
        rule = RULES[name]
        procedure = manners_of(vehicle).procedures[name](vehicle, self._takeoff_height_m)
        leaving = self.streams(vehicle) and rule.via is not P.ENGAGE
        if self.phase is P.FORMATION:  # before it, the attitude that was had anyway has been streamed
            procedure = replace(procedure, delay_s=level_first_s)
            self._level_until_s = now_s + level_first_s + TAKES_OVER_WITHIN_S
        running = RunningProcedure(procedure, now_s)
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
        if self.phase in MUST_BE_ARMED and not vehicle.armed:
            self._enter(P.OBSERVE, "the autopilot disarmed")
        elif self.phase in ON_GROUND and in_air(vehicle):
            self._enter(P.OBSERVE, "someone else flies")
        elif (vehicle.armed or self.phase in ON_GROUND) and not self._mode_is_ours(vehicle):
            self._enter(P.OBSERVE, f"mode {vehicle.mode_name} was set by someone else")

    def _mode_is_ours(self, vehicle: VehicleState) -> bool:
        own = manners_of(vehicle).modes.get(self.phase)
        if self.phase in TO_THE_GROUND and vehicle.landed is LandedState.ON_GROUND:
            return True  # at disarming PX4 changes its mode, and shows that before it shows that it is disarmed
        if own is None or vehicle.mode in own:
            if self._rule is RULES[C.LAND] or self._rule is RULES[C.RETURN]:
                # It has begun: any other mode from now on is the pilot's, and nothing is left to hand over.
                self._tolerated = frozenset()
                self._leaving_formation = False
            return True
        return vehicle.mode in self._tolerated
