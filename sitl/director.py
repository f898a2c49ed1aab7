"""Flies a scenario's timeline: each step's command to every vehicle, until all have done it.

Who carries the commands and whose time it is are given: Zenoh and the machine's clock, or a world in virtual time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

import msgspec

from companion.core.phase import ON_GROUND, RULES
from companion.ground.formations import assigned, change_to, named_slots
from companion.ground.references import reference_change
from companion.types import CommandName, CommandReply, Content, FlightPhase, LandedState, Lead, Role, Status
from companion.wire.ground import StatusReport
from sitl.progress import Progress
from sitl.readiness import READY_WITHIN_S, Readiness, somebody_flies
from sitl.scenario import TimelineStep
from sitl.watch import FlightWatch, vehicles_in_words

POLL_S = 0.02  # as often as an agent ticks: the entry into formation is known to this
REPEAT_S = 0.5
REPLY_WITHIN_S = 0.5
LANDED_WITHIN_S = 60.0
DISARM_SEEN_WITHIN_S = 1.5  # heartbeats, which say so, come once a second
LISTEN_S = 0.3  # three reports of every vehicle
GROUND_PHASES = frozenset({FlightPhase.OBSERVE, FlightPhase.PREPARE, FlightPhase.READY})
# A vehicle that was told one of these may be in phase observe without anything being wrong.
TO_THE_GROUND = (CommandName.LAND, CommandName.RETURN)
MAY_OBSERVE = (CommandName.PREPARE, CommandName.DISARM, *TO_THE_GROUND)


class FlightFailure(Exception):  # noqa: N818 -- what happened to a flight, not an error of this program
    """The flight cannot go on. str() says why in one line."""


class Session(Protocol):
    """The vehicles as the ground reaches them; `companion.ground.session.FleetSession` is one."""

    def drain(self) -> list[StatusReport]:
        """All reports that came since the last call, oldest first."""

    def command(
        self,
        vehicle_ids: Iterable[int],
        name: CommandName,
        timeout_s: float,
        content: Content | None = None,
    ) -> dict[int, CommandReply | None]:
        """Give one command to these vehicles and wait for their answers; None where none came in time."""


class Clock(Protocol):
    def now_s(self) -> float:
        """Monotonic."""

    def sleep(self, seconds: float) -> None:
        """Let this time pass."""


class MachineClock:
    """The clock of real flights."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class Director:
    """Gives the commands of one flight and follows what the vehicles report.

    `check` is called in every pass and raises FlightFailure when something outside the vehicles ends the flight.
    `lost` names the vehicles that nobody here can land any more, or may.
    """

    def __init__(
        self,
        session: Session,
        watch: FlightWatch,
        progress: Progress,
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

    def wait_for(self, readiness: Readiness) -> list[str]:
        """Until all vehicles are ready to be flown; nothing is asked of them. Why they are not, in one line each."""
        began_s = self._clock.now_s()
        self._progress.begin_step("waiting for the vehicles to be ready", began_s)
        try:
            while not readiness.is_reached(self._watch.status, self._clock.now_s()):
                self._progress.remark(readiness.lacking)
                self._pass()
                if flown := somebody_flies(self._statuses()):
                    raise FlightFailure(flown)
                if self._clock.now_s() > began_s + READY_WITHIN_S:
                    raise FlightFailure(f"not ready within {READY_WITHIN_S:g} s: {readiness.lacking}")
        except FlightFailure as failure:
            return [str(failure)]
        finally:
            self._progress.remark("")
        return []

    def fly_and_land(self, timeline: Sequence[TimelineStep]) -> list[str]:
        """All steps in turn, and down in any case. What went wrong, in one line each."""
        failures = []
        try:
            self.fly(timeline)
        except FlightFailure as failure:
            failures.append(str(failure))
        if still_up := self.land_all():
            failures.append(still_up)
        return failures

    def fly(self, timeline: Sequence[TimelineStep]) -> None:
        """All steps in turn. Raises FlightFailure; the vehicles are then where they were."""
        phase = FlightPhase.OBSERVE
        with self._formation_ends():
            for number, step in enumerate(timeline, start=1):
                self._progress.begin_step(f"step {number} of {len(timeline)}, {step.command}", self._clock.now_s())
                if step.command is CommandName.LEAD:  # a formation goes on under it
                    _LeadOrder(self._session, self._watch, step, self._clock).carry_out(self._pass)
                elif step.command is CommandName.FORMATION:
                    _FormationOrder(self._session, self._watch, step, self._clock).carry_out(self._pass)
                elif step.command is CommandName.REFERENCE:
                    _ReferenceOrder(self._session, self._watch, step, self._clock).carry_out(self._pass)
                else:
                    # The command that follows a formation ends it, so the time is taken before it is given.
                    self._watch.end_formation(self._clock.now_s())
                    _Order(self._session, self._watch, step, self._clock).carry_out(self._pass)
                    phase = RULES[step.command].to
                self._stay(number, len(timeline), step, phase)

    @contextmanager
    def _formation_ends(self) -> Iterator[None]:
        """However a timeline ends, a formation that is flown ends with it."""
        try:
            yield
        finally:
            self._watch.end_formation(self._clock.now_s())

    def _stay(self, number: int, steps: int, step: TimelineStep, phase: FlightPhase) -> None:
        """Keep what the step brought about for its `for_s`; a vehicle that leaves it ends the flight."""
        forms = step.command is CommandName.FORM
        since_s = self._watch.begin_formation() if forms else self._clock.now_s()
        if step.for_s:
            self._progress.begin_step(f"step {number} of {steps}, {step.command}", since_s, step.for_s)
        while self._clock.now_s() < since_s + step.for_s:
            self._pass()
            for status in self._statuses():
                if status.phase is not phase:
                    raise FlightFailure(f"vehicle {status.vehicle_id} left phase {phase}: {_last(status)}")
            if (
                phase is not FlightPhase.OBSERVE
                and step.command not in MAY_OBSERVE
                and (silent := self._watch.silent(self._clock.now_s()))
            ):
                raise FlightFailure(f"nothing heard of {vehicles_in_words(silent)} for seconds")

    def _pass(self) -> None:
        """Listen and show, once, within POLL_S. Raises FlightFailure."""
        self._clock.sleep(POLL_S)
        self._listen()
        self._check()

    def _listen(self) -> None:
        reports, now_s = self._session.drain(), self._clock.now_s()
        for report in reports:
            self._watch.hear(report, now_s)
        if self._progress.is_due():
            self._progress.show(self._watch.rows(now_s), now_s)

    def _statuses(self) -> list[Status]:
        found = (self._watch.status(vehicle_id) for vehicle_id in self._watch.vehicle_ids)
        return [status for status in found if status]

    def land_all(self) -> str | None:
        """Bring down whatever flies, from any phase; silent and lost vehicles are left alone. What is still up, in words."""
        began_s = self._clock.now_s()
        next_ask_s = began_s + LISTEN_S
        while (now_s := self._clock.now_s()) < began_s + LANDED_WITHIN_S:
            self._clock.sleep(POLL_S)
            self._listen()
            if now_s < next_ask_s:
                continue
            up = self._still_up(now_s)
            if not up:
                return None
            if next_ask_s == began_s + LISTEN_S:
                self._progress.begin_step("landing all", now_s)
            for name in (CommandName.LAND, CommandName.DISARM):
                ids = [s.vehicle_id for s in up if _way_down(s) is name]
                if ids:
                    self._session.command(ids, name, REPLY_WITHIN_S)
            next_ask_s = now_s + REPEAT_S
        up = self._still_up(self._clock.now_s())
        return f"{vehicles_in_words([s.vehicle_id for s in up])} could not be landed: {_last(up[0])}" if up else None

    def _still_up(self, now_s: float) -> list[Status]:
        heard = {row.vehicle_id for row in self._watch.rows(now_s) if not row.silent} - set(self._lost())
        return [s for s in self._statuses() if s.vehicle_id in heard and (s.armed or s.phase not in GROUND_PHASES)]


class _Order:
    """One command on its way to every vehicle, repeated to those that refuse it or fall back from it."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        self._session = session
        self._clock = clock
        self._watch = watch
        self._step = step
        self._accepted_s: dict[int, float] = {}
        self._reasons: dict[int, str] = {}
        self._observing_since_s: dict[int, float] = {}

    def carry_out(self, wait_a_little: Callable[[], None]) -> None:
        """Until every vehicle has done it. Raises FlightFailure."""
        deadline_s = self._clock.now_s() + self._step.patience_s
        next_ask_s = float("-inf")
        while missing := [i for i in self._watch.vehicle_ids if not self._done(i)]:
            now_s = self._clock.now_s()
            if now_s > deadline_s:
                raise FlightFailure(self._too_late(missing))
            ask = [i for i in missing if i not in self._accepted_s]
            if ask and now_s >= next_ask_s:
                next_ask_s = now_s + REPEAT_S
                self._ask(ask)
            wait_a_little()
            for vehicle_id in missing:
                self._look_for_falling_back(vehicle_id, self._clock.now_s())

    def _ask(self, vehicle_ids: Collection[int]) -> None:
        asked_s = self._clock.now_s()
        replies = self._give(vehicle_ids)
        self._watch.note_answers(asked_s, self._clock.now_s(), self._step, replies)
        for vehicle_id, reply in replies.items():
            if reply is not None and reply.accepted:
                self._accepted_s[vehicle_id] = self._clock.now_s()
            self._reasons[vehicle_id] = reply.reason if reply else "its agent does not answer"

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        return self._session.command(vehicle_ids, self._step.command, REPLY_WITHIN_S)

    def _done(self, vehicle_id: int) -> bool:
        status = self._watch.status(vehicle_id)
        if status is None or vehicle_id not in self._accepted_s:
            return False
        lands = self._step.command in (CommandName.DISARM, *TO_THE_GROUND)
        return status.phase is RULES[self._step.command].to and not (lands and status.armed)

    def _look_for_falling_back(self, vehicle_id: int, now_s: float) -> None:
        """A vehicle that took the command and is neither there nor on its way is asked again; one that observes is lost."""
        status, rule = self._watch.status(vehicle_id), RULES[self._step.command]
        accepted_s = self._accepted_s.get(vehicle_id)
        if status is None or accepted_s is None or now_s < accepted_s + REPEAT_S:
            return  # what was reported before the command does not count
        if status.phase not in (rule.via, rule.to):
            del self._accepted_s[vehicle_id]
            self._reasons[vehicle_id] = _last(status)
            if status.phase is FlightPhase.OBSERVE and self._step.command not in MAY_OBSERVE:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {_last(status)}")
        elif self._step.command in TO_THE_GROUND and status.phase is rule.to and status.armed:
            # Mode and armed state reach the agent in different messages: at touch-down they may disagree for a while.
            observing_since_s = self._observing_since_s.setdefault(vehicle_id, now_s)
            if now_s > observing_since_s + DISARM_SEEN_WITHIN_S:
                raise FlightFailure(f"vehicle {vehicle_id} stopped landing: {_last(status)}")

    def _too_late(self, missing: Sequence[int]) -> str:
        by_reason: dict[str, list[int]] = {}
        for vehicle_id in missing:
            status, reason = self._watch.status(vehicle_id), self._reasons.get(vehicle_id, "")
            if vehicle_id in self._accepted_s and status:
                reason = self._why_not_done(status)
            by_reason.setdefault(reason, []).append(vehicle_id)
        said = "; ".join(f"{vehicles_in_words(ids)}: {reason}" for reason, ids in by_reason.items())
        return f"{self._step.command} not done within {self._step.patience_s:g} s: {said}"

    def _why_not_done(self, status: Status) -> str:
        under_way = status.phase is RULES[self._step.command].via
        return f"still in phase {status.phase}" if under_way else _last(status)


class _LeadOrder(_Order):
    """The lead, on its way to every vehicle in an epoch of its own; it changes no phase."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        known = (status.epoch for i in watch.vehicle_ids if (status := watch.status(i)))
        self._lead = Lead(step.leaders, max(known, default=0) + 1)
        others = [i for i in watch.vehicle_ids if i not in step.leaders]
        self._reasons = dict.fromkeys(others, "not asked before who is to lead takes the lead")

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        """The others are not asked before all that are to lead have taken it: nobody gives up what nobody takes."""
        leaders = [i for i in vehicle_ids if i in self._lead.leaders]
        replies = self._session.command(leaders, CommandName.LEAD, REPLY_WITHIN_S, self._lead) if leaders else {}
        if not all(reply and reply.accepted for reply in replies.values()):
            return replies
        others = [i for i in vehicle_ids if i not in self._lead.leaders]
        return replies | self._session.command(others, CommandName.LEAD, REPLY_WITHIN_S, self._lead)

    def _done(self, vehicle_id: int) -> bool:
        status = self._watch.status(vehicle_id)
        role = Role.LEADER if vehicle_id in self._lead.leaders else Role.FOLLOWER
        return status is not None and status.epoch == self._lead.epoch and status.role is role

    def _look_for_falling_back(self, vehicle_id: int, now_s: float) -> None:
        """What else a vehicle does is seen while the step's time goes by."""

    def _why_not_done(self, status: Status) -> str:
        return f"{status.role} in epoch {status.epoch}, expected epoch {self._lead.epoch}"


class _FormationOrder(_Order):
    """Other slots, for every vehicle at the same time of the fleet's; they change no phase."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        statuses = [status for i in watch.vehicle_ids if (status := watch.status(i))]
        assert step.formation is not None  # checked when the scenario was read
        wanted = step.formation
        slots = named_slots(wanted.shape, len(statuses), wanted.spacing_m, wanted.heading_deg)
        flown = {status.vehicle_id: status.slot.position_enu_m for status in statuses}
        self._change = change_to(assigned(flown, slots), statuses, wanted.speed_m_s)

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        return self._session.command(vehicle_ids, CommandName.FORMATION, REPLY_WITHIN_S, self._change)

    def _done(self, vehicle_id: int) -> bool:
        """Taken up, and at its end."""
        status = self._watch.status(vehicle_id)
        slot = dict(self._change.slots_enu_m)[vehicle_id]
        taken = status is not None and status.slot.formation == self._change.number
        return taken and status is not None and status.slot.position_enu_m == slot

    def _look_for_falling_back(self, vehicle_id: int, now_s: float) -> None:
        """What else a vehicle does is seen while the step's time goes by."""

    def _why_not_done(self, status: Status) -> str:
        return f"formation {status.slot.formation}, expected {self._change.number}"


class _ReferenceOrder(_Order):
    """Another RFT, for those that may lead, from the same time of the fleet's on; it changes no phase."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        statuses = [status for i in watch.vehicle_ids if (status := watch.status(i))]
        self._change = reference_change(msgspec.to_builtins(step.reference), statuses)

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        return self._session.command(vehicle_ids, CommandName.REFERENCE, REPLY_WITHIN_S, self._change)

    def _done(self, vehicle_id: int) -> bool:
        """It has begun, where anything is known of it."""
        status = self._watch.status(vehicle_id)
        return status is not None and (status.reference is None or status.reference.flown == self._change.number)

    def _look_for_falling_back(self, vehicle_id: int, now_s: float) -> None:
        """What else a vehicle does is seen while the step's time goes by."""

    def _why_not_done(self, status: Status) -> str:
        return _last(status)


def _way_down(status: Status) -> CommandName | None:
    if status.phase is FlightPhase.LAND:
        return None
    stands = status.landed is LandedState.ON_GROUND and status.phase is FlightPhase.OBSERVE
    return CommandName.DISARM if status.phase in ON_GROUND or stands else CommandName.LAND


def _last(status: Status) -> str:
    return status.last_event or f"phase {status.phase}, mode {status.mode_name}"
