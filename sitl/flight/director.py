"""Flies a scenario's timeline: each step's command to every vehicle, until all have done it.

Session and clock are arguments: Zenoh and the machine's clock, or a world in virtual time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

from companion.ground.answers import id_list
from companion.ground.commands import Clock, CommandSession
from companion.types.autopilot import LandedState
from companion.types.commands import CommandName
from companion.types.flight import ON_GROUND, RULES, STREAMING, FlightPhase, Role
from companion.types.status import Status
from companion.types.values import Vector3
from companion.wire.messages import StatusReport
from sitl.flight.external import READY_WITHIN_S, Readiness, armed_already
from sitl.flight.orders import REPEAT_S, REPLY_WITHIN_S, FlightFailure, Order, Refusal, newest_report
from sitl.flight.scenario import TO_ALL, MovingTarget, TimelineStep
from sitl.flight.watch import SILENT_S, FlightWatch
from sitl.report.progress import FlightProgress

TARGET_PERIOD_S = 0.1
POLL_S = 0.02  # the period of an agent's ticks: the resolution of the entry into formation
LANDED_WITHIN_S = 60.0
FIRST_WITHIN_S = 10.0  # for those that no agent steers; a longer drift drives the others away
LISTEN_S = 0.3  # three reports of every vehicle

Publish = Callable[[str, Vector3, Vector3], None]
"""Takes a target's name, its velocity [m/s] and its position [m], ENU."""

GROUND_PHASES = frozenset({FlightPhase.OBSERVE, FlightPhase.PREPARE, FlightPhase.READY})


class DirectedSession(CommandSession, Protocol):
    """Commands and reports of the vehicles: `companion.ground.session.FleetSession` is one, a `Lockstep` another."""

    def drain(self) -> list[StatusReport]:
        """All reports since the last call, oldest first."""


class MovingTargets:
    """Publishes the state of each target when it is due."""

    def __init__(self, targets: Sequence[MovingTarget], publish: Publish, began_s: float) -> None:
        self._targets = [(target, target.path.curve()) for target in targets]
        self._publish = publish
        self._began_s = began_s
        self._next_s = began_s

    def update(self, now_s: float) -> None:
        """Publish what is due. To be called more often than every TARGET_PERIOD_S."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + TARGET_PERIOD_S
        flight_s = now_s - self._began_s
        for target, curve in self._targets:
            if target.begins_s <= flight_s <= target.ends_s:
                position, velocity, _ = curve(flight_s - target.begins_s)
                self._publish(target.name, velocity, position)


class Director:
    """Gives the commands of one flight and follows the vehicles' reports.

    `check` is called in every pass and raises FlightFailure when something other than a vehicle ends the flight.
    `lost` returns the vehicles that cannot, or must not, be landed from here.
    """

    def __init__(
        self,
        session: DirectedSession,
        watch: FlightWatch,
        progress: FlightProgress,
        check: Callable[[], None],
        lost: Callable[[], Collection[int]],
        clock: Clock,
    ) -> None:
        self._session = session
        self._clock = clock
        self._watch = watch
        self._progress = progress
        self._check = check
        self._lost = lost
        self.refusals: list[Refusal] = []  # of steps that may fail

    def wait_for(self, readiness: Readiness) -> list[str]:
        """Wait until all vehicles are ready, without commanding them. Returns the failures, one line each."""
        began_s = self._clock.now_s()
        self._progress.begin_step("waiting for the vehicles to be ready", began_s)
        try:
            while not readiness.is_reached(self._watch.status, self._clock.now_s()):
                self._progress.remark(readiness.lacking)
                self._pass()
                if armed := armed_already(self._watch.statuses()):
                    raise FlightFailure(armed)
                if self._clock.now_s() > began_s + READY_WITHIN_S:
                    raise FlightFailure(f"not ready within {READY_WITHIN_S:g} s: {readiness.lacking}")
        except FlightFailure as failure:
            return [str(failure)]
        finally:
            self._progress.remark("")
        return []

    def attend(self, is_over: Callable[[], bool]) -> None:
        """Show the reports until `is_over`, without commands."""
        self._progress.begin_step("commanded by an operator", self._clock.now_s())
        while not is_over():
            self._pass()

    def fly_and_land(self, timeline: Sequence[TimelineStep]) -> list[str]:
        """All steps in turn, then a landing in any case. Returns the failures, one line each."""
        failures = []
        try:
            self.fly(timeline)
        except FlightFailure as failure:
            failures.append(str(failure))
        if still_up := self.land_all():
            failures.append(still_up)
        return failures

    def fly(self, timeline: Sequence[TimelineStep]) -> None:
        """All steps in turn. Raises FlightFailure and leaves the vehicles as they are."""
        phases = dict.fromkeys(self._watch.vehicle_ids, FlightPhase.OBSERVE)
        try:
            for number, step in enumerate(timeline, start=1):
                self._fly_step(f"step {number} of {len(timeline)}, {step.command}", step, phases)
        except FlightFailure as failure:
            # An agent that ends is silent, and others lose their leader: what they report is not the cause.
            ended = [one for one in self._watch.failed_agents() if one.event not in str(failure)]
            causes = [f"vehicle {one.vehicle}: {one.code}: {one.event}" for one in ended]
            raise FlightFailure("; ".join([*causes, str(failure)])) from failure
        finally:
            self._watch.end_formation(self._clock.now_s())

    def _fly_step(self, name: str, step: TimelineStep, phases: dict[int, FlightPhase]) -> None:
        """`phases` are those in which the vehicles are to stay; the step changes them."""
        self._wait_until(step, name, phases)
        self._progress.begin_step(name, self._clock.now_s())
        if step.command not in TO_ALL:
            # The next command ends a formation, so its end is recorded before the command is given.
            self._watch.end_formation(self._clock.now_s())
        if step.may_fail:
            self._try(step)
            phases |= {status.agent.vehicle_id: status.phase for status in self._watch.statuses()}
            return
        Order(self._session, self._watch, step, self._clock).carry_out(self._pass)
        if step.command not in TO_ALL:
            phases |= dict.fromkeys(step.vehicles or self._watch.vehicle_ids, RULES[step.command].to)
        self._stay(name, step, phases)

    def _try(self, step: TimelineStep) -> None:
        """A step that may fail: refusals are recorded, and its time passes whatever the vehicles do."""
        self.refusals += Order(self._session, self._watch, step, self._clock).attempt(self._pass)
        until_s = self._clock.now_s() + step.for_s
        if step.command is CommandName.FORM:
            while not self._leaders_formed() and self._clock.now_s() < until_s:  # a real autopilot takes its time
                self._pass()
            if self._leaders_formed():
                self._watch.begin_formation()
        self._pass_until(until_s)

    def _leaders_formed(self) -> bool:
        leads = [status.phase for status in self._watch.statuses() if status.leadership.role is Role.LEADER]
        return bool(leads) and set(leads) == {FlightPhase.FORMATION}

    def _wait_until(self, step: TimelineStep, name: str, phases: Mapping[int, FlightPhase]) -> None:
        """Wait until that time of the flight."""
        left_s = 0.0 if step.at_s is None else self._watch.began_s + step.at_s - self._clock.now_s()
        if left_s <= 0.0:
            return
        self._progress.begin_step(f"waiting for {name}", self._clock.now_s(), left_s)
        if step.may_fail:
            self._pass_until(self._clock.now_s() + left_s)
        else:
            self._keep(self._clock.now_s() + left_s, phases)

    def _pass_until(self, until_s: float) -> None:
        while self._clock.now_s() < until_s:
            self._pass()

    def _stay(self, name: str, step: TimelineStep, phases: Mapping[int, FlightPhase]) -> None:
        """Keep the phases of the step for its `for_s`."""
        formed = step.command is CommandName.FORM and set(phases.values()) == {FlightPhase.FORMATION}
        since_s = self._watch.begin_formation() if formed else self._clock.now_s()
        if step.for_s:
            self._progress.begin_step(name, since_s, step.for_s)
        self._keep(since_s + step.for_s, phases)

    def _keep(self, until_s: float, phases: Mapping[int, FlightPhase]) -> None:
        """Wait. Raises FlightFailure for a vehicle that leaves its phase, or flies and reports nothing."""
        while self._clock.now_s() < until_s:
            self._pass()
            for status in self._watch.statuses():
                if status.phase is not phases[status.agent.vehicle_id]:
                    left = phases[status.agent.vehicle_id]
                    raise FlightFailure(f"vehicle {status.agent.vehicle_id} left phase {left}: {newest_report(status)}")
            silent = [i for i in self._watch.silent(self._clock.now_s()) if phases[i] is not FlightPhase.OBSERVE]
            if silent:
                reports = ((i, self._watch.status(i)) for i in silent)
                last = [f"vehicle {i}: {newest_report(status)}" for i, status in reports if status]
                raise FlightFailure(f"no report from {id_list(silent)} for {SILENT_S:g} s; {'; '.join(last)}")

    def _pass(self) -> None:
        """Receive and show reports once, after POLL_S. Raises FlightFailure."""
        self._clock.sleep(POLL_S)
        self._receive()
        self._check()

    def _receive(self) -> None:
        reports, now_s = self._session.drain(), self._clock.now_s()
        for report in reports:
            self._watch.receive(report, now_s)
        if self._progress.is_due():
            self._progress.show(self._watch.vehicles_at(now_s), now_s)

    def land_all(self) -> str | None:
        """Land all flying vehicles, from any phase, except silent and lost ones. Returns in one line which still fly.

        Those that no agent steers come first: they may drift, and only agents keep vehicles apart.
        """
        began_s = self._clock.now_s()
        next_command_s = began_s + LISTEN_S
        while (now_s := self._clock.now_s()) < began_s + LANDED_WITHIN_S:
            self._clock.sleep(POLL_S)
            self._receive()
            if now_s < next_command_s:
                continue
            if not (up := self._still_up(now_s)):
                return None
            if next_command_s == began_s + LISTEN_S:
                self._progress.begin_step("landing all", now_s)
            first = [status for status in up if status.phase not in STREAMING]
            landing = any(status.autopilot.landed is not LandedState.ON_GROUND for status in first)
            due = first if landing and now_s < began_s + FIRST_WITHIN_S else up
            for name in (CommandName.LAND, CommandName.DISARM):
                if ids := [s.agent.vehicle_id for s in due if _landing_command(s) is name]:
                    self._session.ask(ids, name, REPLY_WITHIN_S)
            next_command_s = now_s + REPEAT_S
        up = self._still_up(self._clock.now_s())
        return f"{id_list([s.agent.vehicle_id for s in up])} did not land: {newest_report(up[0])}" if up else None

    def _still_up(self, now_s: float) -> list[Status]:
        reporting = {vehicle.vehicle_id for vehicle in self._watch.vehicles_at(now_s) if not vehicle.silent}
        ids = reporting.difference(self._lost())
        known = [status for status in self._watch.statuses() if status.agent.vehicle_id in ids]
        return [status for status in known if status.autopilot.armed or status.phase not in GROUND_PHASES]


def _landing_command(status: Status) -> CommandName | None:
    if status.phase is FlightPhase.LAND:
        return None
    observed = status.autopilot.landed is LandedState.ON_GROUND and status.phase is FlightPhase.OBSERVE
    return CommandName.DISARM if status.phase in ON_GROUND or observed else CommandName.LAND
