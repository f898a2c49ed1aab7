"""The state machine of the flight phases, by the table RULES of `types/flight.py`.

Theory of operation. Two machines fly one vehicle: the autopilot in its modes and this agent in its phases. The agent cannot set
a mode. It can only ask, and the mode, arming and landed state that telemetry reports are the truth. An acknowledgement proves
nothing: PX4 may accept a change of mode and then refuse it. So a phase is a claim about the vehicle, compared with telemetry in
every tick (`observe`), and a command is a request that is repeated until telemetry shows its effect (`core/autopilot.py`).

    OBSERVE -- prepare, arm --> READY, ARMED -- takeoff --> HOLD -- form --> ENGAGE --> FORMATION
       ^                                                    ^  |               |            |
       |                                                    |  +-- land, return --> LAND, RETURN
       |                                                    +------ RELEASE <--+------------+
       +--- from every phase: a mode, arming or flight that the phase did not command; after a landing; on failure

  - The pilot has precedence. In a mode that the present phase did not command, the agent returns to OBSERVE and sends nothing
    until the next command. While a procedure runs, the mode in which it began is tolerated as well, as the request may not
    have arrived yet. A landing or return that has begun tolerates no other mode any more.
  - A command leads from one of its `allowed` phases through `via` to `to`, or to `on_failure`. One that is under way or done
    is accepted again, because commands are repeated until all vehicles answer. ABORT becomes one of the others.
  - Nothing else changes the phase. Other stages return PhaseRequests, and a tick has one order: requests of guidance, commands,
    requests of safety. So a failsafe wins over a command of the same tick; only a landing or return out of hold gives way, as
    a command shows that somebody has taken over.
  - The stream of setpoints has no gap. It begins before the autopilot is asked to follow it (ENGAGE), since PX4 takes OFFBOARD
    only from a running stream; and it goes on, level, after the autopilot was asked to hold (RELEASE), until telemetry reports
    the hold. An autopilot that missed its setpoints would start its own failsafe in between.
  - An autopilot that has lost its position refuses to hold and to return. Then the next safe action follows: a refused return
    becomes a hold, a refused hold a landing; and where the landing is refused, too, setpoints lower the vehicle, level.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from msgspec import Struct

from companion.core.autopilot import Procedure, Profiles, Progress, RunningProcedure, profile_of
from companion.core.command.hand_over import BRAKES_WITHIN_S, LEVEL_BEFORE_HAND_OVER_S, NO_HAND_OVER
from companion.types.autopilot import AutopilotMode, AutopilotRequest, LandedState, Telemetry, VehicleState, in_air
from companion.types.commands import CommandName
from companion.types.flight import (
    FLYING,
    ON_GROUND,
    RULES,
    STREAMING,
    TO_THE_GROUND,
    Flight,
    FlightPhase,
    PhaseChange,
    PhaseRequest,
    Rule,
)
from companion.types.notices import Answer, Code, Notice, accept, refuse

P, M, C = FlightPhase, AutopilotMode, CommandName

FLOWN_BY_OTHERS = frozenset({M.LAND, M.RETURN, M.OTHER})  # while the agent observes: by a pilot or a failsafe
MUST_BE_ARMED = {P.ARMED} | FLYING - TO_THE_GROUND


LANDING, RETURNING = RULES[C.LAND], RULES[C.RETURN]
FORMATION = P.FORMATION  # member lookup of an enum is slow

ALREADY = {
    P.READY: "already prepared",
    P.ARMED: "already armed",
    P.HOLD: "already in hold",
    P.FORMATION: "already in formation",
}


class PhaseCommand(Struct, frozen=True, gc=False):
    """An admitted command for the phase machine, with what the checks found.

    `unfit` refuses it in every phase that does not refuse it itself, `refusal` in the phases where RULES allows it; `warning`
    goes with the answer.
    """

    number: int
    name: CommandName
    unfit: Notice | None = None
    refusal: Notice | None = None
    warning: Notice | None = None
    is_check: bool = False  # it is answered, and changes nothing


class PhaseMachine:
    """The flight phase. This stage alone changes it, by RULES; other stages return PhaseRequests."""

    def __init__(self, takeoff_height_m: float, profiles: Profiles) -> None:
        self._takeoff_height_m = takeoff_height_m
        self._profiles = profiles
        self.phase = P.OBSERVE
        self._rule: Rule | None = None
        self._running: RunningProcedure | None = None
        self.handing_over = NO_HAND_OVER
        self._began_in = P.OBSERVE  # the phase in which the procedure under way began
        self._filtered_m_s2 = 0.0  # change by the separation filter in the last tick
        self._tolerated: frozenset[AutopilotMode] = frozenset()
        self.events: list[Notice] = []
        self._seen: tuple[object, ...] = ()  # inputs of `observe` in the last tick
        self._observed = Flight()

    def streams(self, vehicle: VehicleState) -> bool:
        """True while attitude targets go out: just before formation, in it, and until the autopilot has taken over."""
        if self.phase in STREAMING:
            return True
        return self.handing_over.under_way and vehicle.mode is M.OFFBOARD

    def command(self, name: CommandName, now_s: float, vehicle: VehicleState) -> Answer:
        """(accepted, reason). A command that is under way or done already is accepted again."""
        answer = self._answer(name, vehicle)
        if answer.accepted and not self._is_under_way(name):
            self._begin(name, now_s, vehicle, _command(name))
        return answer

    def _answer(self, name: CommandName, vehicle: VehicleState) -> Answer:
        """The answer by phase and vehicle. It changes nothing."""
        if vehicle.autopilot is None:
            return refuse(Code.NO_HEARTBEAT, f"{name}: no HEARTBEAT has come from the autopilot yet")
        rule = RULES[name]
        if self._is_under_way(name):
            return accept(Code.ALREADY_DONE, ALREADY.get(self.phase, f"{name} already in progress"))
        if self.phase not in rule.allowed:
            text = f"{name} is not possible in phase {self.phase}, only in {', '.join(sorted(rule.allowed))}"
            return refuse(Code.WRONG_PHASE, text)
        if rule.on_ground is in_air(vehicle):
            if rule.on_ground:
                return refuse(Code.NOT_ON_GROUND, f"{name} needs the vehicle on the ground")
            return refuse(Code.NOT_IN_AIR, f"{name} needs the vehicle in the air")
        try:
            self._procedure(name, vehicle)
        except ValueError as error:
            return refuse(Code.ALTITUDE_UNKNOWN, f"{name}: {error}")
        return accept(Code.PHASE_CHANGED, f"{name} begins")

    def _procedure(self, name: CommandName, vehicle: VehicleState) -> Procedure:
        """Raises ValueError where it needs an altitude that is not known."""
        return profile_of(vehicle, self._profiles).procedures[name](vehicle, self._takeoff_height_m)

    def _is_under_way(self, name: CommandName) -> bool:
        """Or done already."""
        rule = RULES[name]
        return self._rule is rule or (self._rule is None and self.phase is rule.to is not P.OBSERVE)

    def abort(self, now_s: float, vehicle: VehicleState) -> Answer:
        """(accepted, reason), from every phase: disarm on the ground, the autopilot's own hold in the air.

        A landing continues, also at the end of a return, and a vehicle flown by its pilot is left to the pilot. A vehicle still
        returning holds where it is.
        """
        if vehicle.autopilot is None:
            return refuse(Code.NO_HEARTBEAT, "abort: no HEARTBEAT has come from the autopilot yet")
        if self.phase is P.LAND or (self.phase is P.RETURN and vehicle.landed is LandedState.LANDING):
            return accept(Code.LANDING_CONTINUES, "the landing continues")
        if self.phase is P.OBSERVE and not vehicle.armed:
            return accept(Code.ALREADY_DONE, "already disarmed")
        if not in_air(vehicle):
            # After a flight phase it lands, which disarms as well: with a wrong landed state, a disarm would stop the motors.
            lands = self.phase in FLYING - {P.TAKEOFF}
            self._begin(C.LAND if lands else C.DISARM, now_s, vehicle, _command(C.ABORT))
            return accept(Code.PHASE_CHANGED, "lands" if lands else "disarms")
        if self.phase is P.OBSERVE and vehicle.mode in FLOWN_BY_OTHERS:
            return accept(Code.FLOWN_BY_OTHERS, f"left to its pilot or failsafe, in mode {vehicle.mode_name}")
        return self.command(C.HOLD, now_s, vehicle)

    def observe(self, now_s: float, vehicle: VehicleState) -> Flight:
        """The phase at the beginning of a tick, after a change of mode, arming or flight by others."""
        seen = (self.phase, vehicle.mode, vehicle.armed, vehicle.landed, vehicle.autopilot)
        if seen == self._seen and not self.handing_over.under_way:
            return self._observed  # it follows from these alone
        self.follow_truth(vehicle)
        self._seen, self._observed = seen, self._flight(now_s, vehicle)
        return self._observed

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        before: Flight,
        telemetry: Iterable[Telemetry],
        guidance_requests: Collection[PhaseRequest],
        commands: Collection[PhaseCommand],
        safety_requests: Collection[PhaseRequest],
        filtered_m_s2: float,
    ) -> Flight:
        """The phase after the requests of guidance, the commands and the requests of safety, in this order.

        `before` is what `observe` returned in this tick, `filtered_m_s2` what the separation filter changed last.
        """
        self._filtered_m_s2 = filtered_m_s2
        if not (guidance_requests or commands or safety_requests or self._running or self.events):
            return before
        answers, commanded = [], False
        for request in guidance_requests:
            self._apply(request, now_s, vehicle, commanded)
        for command in commands:
            if command.is_check:
                answers.append((command.number, self._judge(command, vehicle)))
                continue
            answer = self._execute(command, now_s, vehicle)
            answers.append((command.number, answer))
            commanded = commanded or answer.accepted
        for request in safety_requests:
            self._apply(request, now_s, vehicle, commanded)
        to_autopilot: tuple[AutopilotRequest, ...] = ()
        if self._running and not self._brakes(now_s, vehicle):
            to_autopilot = self.advance(now_s, vehicle, telemetry)
        events, self.events = tuple(self.events), []
        return self._flight(now_s, vehicle, commanded, to_autopilot, tuple(answers), events)

    def _flight(
        self,
        now_s: float,
        vehicle: VehicleState,
        commanded: bool = False,
        requests: tuple[AutopilotRequest, ...] = (),
        answers: tuple[tuple[int, Answer], ...] = (),
        events: tuple[Notice, ...] = (),
    ) -> Flight:
        phase = self.phase
        return Flight(
            phase=phase,
            streams=self.streams(vehicle),
            in_formation=phase is FORMATION or (self.handing_over.under_way and phase is P.RELEASE),
            on_ground=not vehicle.armed or phase in ON_GROUND,
            levels=self.handing_over.levels(now_s),
            descends=self.handing_over.descends(now_s),
            commanded=commanded,
            requests=requests,
            answers=answers,
            events=events,
        )

    def _execute(self, command: PhaseCommand, now_s: float, vehicle: VehicleState) -> Answer:
        name = command.name
        if name is C.ABORT:
            return self.abort(now_s, vehicle)
        answer, warned = self._judge(command, vehicle), self._warning(command)
        if answer.accepted:
            self.command(name, now_s, vehicle)
            self.events += [warned] if warned else []
        return answer

    def _judge(self, command: PhaseCommand, vehicle: VehicleState) -> Answer:
        """The answer to a command other than ABORT. It changes nothing."""
        name, allowed = command.name, self.phase in RULES[command.name].allowed
        if command.unfit and (self._is_under_way(name) or allowed):
            return Answer(False, command.unfit)
        if command.refusal and allowed:
            return Answer(False, command.refusal)
        answer, warned = self._answer(name, vehicle), self._warning(command)
        if not answer.accepted or warned is None:
            return answer
        return Answer(True, Notice(warned.code, f"{answer.notice.text}; {warned.text}"))

    def _warning(self, command: PhaseCommand) -> Notice | None:
        return command.warning if self.phase in RULES[command.name].allowed else None

    def _apply(self, request: PhaseRequest, now_s: float, vehicle: VehicleState, commanded: bool) -> None:
        match request.kind:
            case PhaseChange.HAND_OVER:
                self.hand_over(now_s, vehicle, request.reason)
            case PhaseChange.HAND_OVER_LEVEL:
                self.hand_over_level(now_s, vehicle, request.reason)
            case PhaseChange.HAND_OVER_NOW:
                self.hand_over_silently(now_s, vehicle, request.reason)
            case PhaseChange.GIVE_UP if self.phase in STREAMING:
                self.give_up(request.reason)
            case PhaseChange.HOLD if self.phase is P.OBSERVE and vehicle.mode is M.OFFBOARD:
                self._begin(C.HOLD, now_s, vehicle, request.reason)
            case PhaseChange.ABANDON:
                self.give_up(request.reason)
            case PhaseChange.LAND if not commanded:
                self.leave_hold(C.LAND, now_s, vehicle, request.reason)
            case PhaseChange.RETURN if not commanded:
                self.leave_hold(C.RETURN, now_s, vehicle, request.reason)
            case PhaseChange.END_STREAM:
                self.end_stream()

    def hand_over(self, now_s: float, vehicle: VehicleState, reason: Notice) -> None:
        """Leave formation for the autopilot's own hold: brake, then level first."""
        if self.phase in STREAMING:
            self._begin(C.HOLD, now_s, vehicle, reason)

    def hand_over_level(self, now_s: float, vehicle: VehicleState, reason: Notice) -> None:
        """The same without braking, or with no more of it, where the velocity is in doubt."""
        if self.phase in STREAMING:
            self._begin(C.HOLD, now_s, vehicle, reason, brakes_within_s=0.0)
        else:
            self.handing_over = self.handing_over.without_braking(now_s)

    def hand_over_silently(self, now_s: float, vehicle: VehicleState, reason: Notice) -> None:
        """The same without levelling, where the attitude is unknown."""
        if self.phase in STREAMING:
            self._begin(C.HOLD, now_s, vehicle, reason, level_first_s=0.0, brakes_within_s=0.0)

    def leave_hold(self, name: CommandName, now_s: float, vehicle: VehicleState, reason: Notice) -> None:
        """Leave the autopilot's own hold by its own landing or return."""
        if self.phase is P.HOLD:
            self._begin(name, now_s, vehicle, reason)

    def give_up(self, reason: Notice) -> None:
        """Back to OBSERVE: nothing more is sent until a command comes."""
        self._enter(P.OBSERVE, reason)

    def end_stream(self) -> None:
        """No more setpoints; requests under way continue."""
        self.handing_over = self.handing_over.ended()

    def _brakes(self, now_s: float, vehicle: VehicleState) -> bool:
        """Whether the vehicle still brakes, or evades another one, before it levels and the autopilot is asked."""
        if self._running is None or not self.handing_over.has_to_brake:
            return False
        if self.handing_over.brakes(now_s, vehicle, self._filtered_m_s2):
            return True
        self._level(now_s, self._running.procedure)
        return False

    def _level(self, now_s: float, procedure: Procedure) -> None:
        """Levels from now on, then asks the autopilot."""
        self.handing_over = self.handing_over.level_from(now_s, procedure.delay_s)
        self._running = RunningProcedure(procedure, now_s)

    def advance(
        self, now_s: float, vehicle: VehicleState, telemetry: Iterable[Telemetry]
    ) -> tuple[AutopilotRequest, ...]:
        """One tick of the procedure under way. Returns the requests to the autopilot."""
        if self._running is None or self._rule is None:
            return ()
        self._running.receive(telemetry)
        if vehicle.landed is LandedState.ON_GROUND and self._rule is LANDING and self.handing_over.descends(now_s):
            self._begin(C.DISARM, now_s, vehicle, Notice(Code.PHASE_CHANGED, "lowered to the ground"))
        match self._running.progress(now_s, vehicle):
            case Progress.DONE:
                self._enter(self._rule.to)
                return ()
            case Progress.FAILED:
                failure = Notice(Code.PROCEDURE_FAILED, f"{self.phase} failed: {self._running.reason}")
                self._fail(self._rule, now_s, vehicle, failure)
                return ()
        return self._running.due(now_s, vehicle)

    def _fail(self, rule: Rule, now_s: float, vehicle: VehicleState, failure: Notice) -> None:
        """The next safe action, or the phase after the failure."""
        if self._began_in is P.OBSERVE:
            self._enter(P.OBSERVE, failure)
        elif rule.on_failure is P.RELEASE:
            self._begin(C.HOLD, now_s, vehicle, failure)
        elif rule.on_failure is P.LAND or (rule is LANDING and self.streams(vehicle)):
            self._begin(C.LAND, now_s, vehicle, failure)
        else:
            self._enter(rule.on_failure, failure)

    def _begin(
        self,
        name: CommandName,
        now_s: float,
        vehicle: VehicleState,
        reason: Notice,
        level_first_s: float = LEVEL_BEFORE_HAND_OVER_S,
        brakes_within_s: float = BRAKES_WITHIN_S,
    ) -> None:
        rule = RULES[name]
        procedure = self._procedure(name, vehicle)
        leaving = self.streams(vehicle) and rule.via is not P.ENGAGE
        leaves_formation = self.phase is P.FORMATION  # before it, the present attitude is streamed anyway
        self._began_in, before = self.phase, self.handing_over
        self._enter(rule.via, reason)
        self._rule = rule
        if leaving:
            self.handing_over = before.begun(now_s, lands=rule.via is P.LAND)
        self._tolerated = frozenset({vehicle.mode}) | ({M.OFFBOARD} if leaving else frozenset())
        self._running = RunningProcedure(procedure, now_s)
        if leaves_formation:
            self._level(now_s, replace(procedure, delay_s=level_first_s))
            self.handing_over = self.handing_over.braking(now_s, vehicle, self._filtered_m_s2, brakes_within_s)
        self._seen = ()

    def _enter(self, phase: FlightPhase, reason: Notice | None = None) -> None:
        if reason:
            self.events.append(Notice(reason.code, f"{self.phase} -> {phase} ({reason.text})"))
        elif phase is not self.phase:
            self.events.append(Notice(Code.PHASE_CHANGED, f"{self.phase} -> {phase}"))
        self.phase = phase
        self._rule = None
        self._running = None
        self.handing_over = self.handing_over.ended()
        self._tolerated = frozenset()
        self._seen = ()

    def follow_truth(self, vehicle: VehicleState) -> None:
        """Observe after a change of mode, arming or take-off by others. Called first in a tick."""
        if self.phase in MUST_BE_ARMED and not vehicle.armed:
            self._enter(P.OBSERVE, Notice(Code.AUTOPILOT_DISARMED, "the autopilot disarmed"))
        elif self.phase in ON_GROUND and in_air(vehicle):
            self._enter(P.OBSERVE, Notice(Code.FLOWN_BY_OTHERS, "the vehicle is flown by others"))
        elif (vehicle.armed or self.phase in ON_GROUND) and not self._mode_is_ours(vehicle):
            text = f"mode {vehicle.mode_name} was not set by this agent"
            self._enter(P.OBSERVE, Notice(Code.MODE_CHANGED_BY_OTHERS, text))

    def _mode_is_ours(self, vehicle: VehicleState) -> bool:
        if self.phase in TO_THE_GROUND and vehicle.landed is LandedState.ON_GROUND:
            return True  # at disarming PX4 reports its new mode before it reports disarmed
        own = profile_of(vehicle, self._profiles).modes.get(self.phase)
        if own is None or vehicle.mode in own:
            if self._rule is LANDING or self._rule is RETURNING:
                # It has begun: any other mode from now on is the pilot's, and nothing is left to hand over.
                self._tolerated = frozenset()
                self.handing_over = self.handing_over.ended()
            return True
        return vehicle.mode in self._tolerated


def _command(name: CommandName) -> Notice:
    return Notice(Code.PHASE_CHANGED, f"command {name}")
