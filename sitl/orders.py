"""One step of a timeline on its way to the vehicles, until all that it is for have done it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Protocol

import msgspec

from companion.core.phase import RULES
from companion.ground.formations import assigned, change_to, named_slots, places_enu_m
from companion.ground.references import reference_change
from companion.types import CommandName, CommandReply, Content, FlightPhase, Lead, Role, Status
from companion.wire.ground import StatusReport
from sitl.timeline import TimelineStep
from sitl.watch import FlightWatch, vehicles_in_words

REPEAT_S = 0.5
REPLY_WITHIN_S = 0.5
DISARM_SEEN_WITHIN_S = 1.5  # heartbeats, which say so, come once a second
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


class Order:
    """One command on its way to all that it is for, repeated to those that refuse it or fall back from it."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        self._session = session
        self._clock = clock
        self._watch = watch
        self._step = step
        self._ids = sorted(step.vehicles) or watch.vehicle_ids
        self._accepted_s: dict[int, float] = {}
        self._reasons: dict[int, str] = {}
        self._observing_since_s: dict[int, float] = {}

    def carry_out(self, wait_a_little: Callable[[], None]) -> None:
        """Until every vehicle has done it. Raises FlightFailure."""
        deadline_s = self._clock.now_s() + self._step.patience_s
        next_ask_s = float("-inf")
        while missing := [i for i in self._ids if not self._done(i)]:
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
            self._reasons[vehicle_id] = last_word(status)
            if status.phase is FlightPhase.OBSERVE and self._step.command not in MAY_OBSERVE:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {last_word(status)}")
        elif self._step.command in TO_THE_GROUND and status.phase is rule.to and status.armed:
            # Mode and armed state reach the agent in different messages: at touch-down they may disagree for a while.
            observing_since_s = self._observing_since_s.setdefault(vehicle_id, now_s)
            if now_s > observing_since_s + DISARM_SEEN_WITHIN_S:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {last_word(status)}")

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
        return f"still in phase {status.phase}" if under_way else last_word(status)


class _LeadOrder(Order):
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


class _FormationOrder(Order):
    """Other slots, for every vehicle at the same time of the fleet's; they change no phase."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        statuses = [status for i in watch.vehicle_ids if (status := watch.status(i))]
        assert step.formation is not None  # checked when the scenario was read
        wanted = step.formation
        slots = named_slots(wanted.shape, len(statuses), wanted.spacing_m, wanted.heading_deg)
        self._change = change_to(assigned(places_enu_m(statuses), slots), statuses, wanted.speed_m_s)

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


class _ReferenceOrder(Order):
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
        return last_word(status)


def last_word(status: Status) -> str:
    return status.last_event or f"phase {status.phase}, mode {status.mode_name}"


def order_of(session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> Order:
    """Some change no phase: what was flown before goes on under them."""
    return ORDERS.get(step.command, Order)(session, watch, step, clock)


ORDERS: dict[CommandName, type[Order]] = {
    CommandName.LEAD: _LeadOrder,
    CommandName.FORMATION: _FormationOrder,
    CommandName.REFERENCE: _ReferenceOrder,
}
