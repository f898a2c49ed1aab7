"""Flies a scenario's timeline: each step's command to every vehicle, until all have done it.

Who carries the commands and whose time it is are given: Zenoh and the machine's clock, or a world in virtual time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager

from companion.core.phase import ON_GROUND, RULES
from companion.types import CommandName, FlightPhase, LandedState, Status
from sitl.orders import REPEAT_S, REPLY_WITHIN_S, Clock, FlightFailure, Session, last_word, order_of
from sitl.progress import Progress
from sitl.readiness import READY_WITHIN_S, Readiness, somebody_flies
from sitl.timeline import TO_ALL, TimelineStep
from sitl.watch import FlightWatch, vehicles_in_words

POLL_S = 0.02  # as often as an agent ticks: the entry into formation is known to this
LANDED_WITHIN_S = 60.0
LISTEN_S = 0.3  # three reports of every vehicle
GROUND_PHASES = frozenset({FlightPhase.OBSERVE, FlightPhase.PREPARE, FlightPhase.READY})


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

    def attend(self, is_over: Callable[[], bool]) -> None:
        """Listen and show; nothing is asked of the vehicles."""
        self._progress.begin_step("commanded from elsewhere", self._clock.now_s())
        while not is_over():
            self._pass()

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
        phases = dict.fromkeys(self._watch.vehicle_ids, FlightPhase.OBSERVE)
        with self._formation_ends():
            for number, step in enumerate(timeline, start=1):
                name = f"step {number} of {len(timeline)}, {step.command}"
                self._wait_until(step.at_s, name, phases)
                self._progress.begin_step(name, self._clock.now_s())
                if step.command not in TO_ALL:
                    # The command that follows a formation ends it, so the time is taken before it is given.
                    self._watch.end_formation(self._clock.now_s())
                order_of(self._session, self._watch, step, self._clock).carry_out(self._pass)
                if step.command not in TO_ALL:
                    phases |= dict.fromkeys(step.vehicles or self._watch.vehicle_ids, RULES[step.command].to)
                self._stay(name, step, phases)

    @contextmanager
    def _formation_ends(self) -> Iterator[None]:
        """However a timeline ends, a formation that is flown ends with it."""
        try:
            yield
        finally:
            self._watch.end_formation(self._clock.now_s())

    def _wait_until(self, at_s: float | None, name: str, phases: Mapping[int, FlightPhase]) -> None:
        """Until that time of the flight, where it is not over yet."""
        left_s = 0.0 if at_s is None else self._watch.began_s + at_s - self._clock.now_s()
        if left_s > 0.0:
            self._progress.begin_step(f"waiting for {name}", self._clock.now_s(), left_s)
            self._keep(self._clock.now_s() + left_s, phases)

    def _stay(self, name: str, step: TimelineStep, phases: Mapping[int, FlightPhase]) -> None:
        """Keep what the step brought about for its `for_s`."""
        formed = step.command is CommandName.FORM and set(phases.values()) == {FlightPhase.FORMATION}
        since_s = self._watch.begin_formation() if formed else self._clock.now_s()
        if step.for_s:
            self._progress.begin_step(name, since_s, step.for_s)
        self._keep(since_s + step.for_s, phases)

    def _keep(self, until_s: float, phases: Mapping[int, FlightPhase]) -> None:
        """A vehicle that leaves its phase ends the flight, as one in the air does that says nothing."""
        while self._clock.now_s() < until_s:
            self._pass()
            for status in self._statuses():
                if status.phase is not phases[status.vehicle_id]:
                    left = phases[status.vehicle_id]
                    raise FlightFailure(f"vehicle {status.vehicle_id} left phase {left}: {last_word(status)}")
            silent = [i for i in self._watch.silent(self._clock.now_s()) if phases[i] is not FlightPhase.OBSERVE]
            if silent:
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
        return (
            f"{vehicles_in_words([s.vehicle_id for s in up])} could not be landed: {last_word(up[0])}" if up else None
        )

    def _still_up(self, now_s: float) -> list[Status]:
        heard = {row.vehicle_id for row in self._watch.rows(now_s) if not row.silent} - set(self._lost())
        return [s for s in self._statuses() if s.vehicle_id in heard and (s.armed or s.phase not in GROUND_PHASES)]


def _way_down(status: Status) -> CommandName | None:
    if status.phase is FlightPhase.LAND:
        return None
    stands = status.landed is LandedState.ON_GROUND and status.phase is FlightPhase.OBSERVE
    return CommandName.DISARM if status.phase in ON_GROUND or stands else CommandName.LAND
