"""One step of a timeline: its command is repeated until all its vehicles have done it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from math import dist
from typing import Protocol

import msgspec
from msgspec import Struct

from companion.ground.changes import assigned, change_to, named_slots, positions_enu_m, reference_change
from companion.types.commands import CommandName, CommandReply, Content, Lead, ReferenceChange, next_epoch
from companion.types.errors import CompanionError
from companion.types.flight import RULES, FlightPhase, Role
from companion.types.formation import FormationChange
from companion.types.notices import Code
from companion.types.status import Status
from companion.types.values import Vector3
from companion.wire.messages import StatusReport
from sitl.flight.scenario import FormationStep, TimelineStep
from sitl.flight.watch import FlightWatch, vehicles_in_words

REPEAT_S = 0.5
REPLY_WITHIN_S = 0.5
DISARM_SEEN_WITHIN_S = 1.5  # heartbeats, which carry the armed state, come once a second
SLOT_REACHED_M = 0.001  # a status has its slot to 0.1 mm
# After one of these commands a vehicle may be in phase observe without a failure.
TO_THE_GROUND = (CommandName.LAND, CommandName.RETURN)
MAY_OBSERVE = (CommandName.PREPARE, CommandName.DISARM, *TO_THE_GROUND)


class FlightFailure(CompanionError):  # noqa: N818 -- an outcome of a flight, not an error of this program
    """The flight cannot continue. str() is the reason in one line."""


class Session(Protocol):
    """Access to the vehicles from the ground; `companion.ground.session.FleetSession` is one."""

    def drain(self) -> list[StatusReport]:
        """All reports since the last call, oldest first."""

    def command(
        self,
        vehicle_ids: Iterable[int],
        name: CommandName,
        timeout_s: float,
        content: Content | None = None,
    ) -> dict[int, CommandReply | None]:
        """Give one command to these vehicles and wait for their answers; None for a vehicle without one in time."""


class Clock(Protocol):
    def now_s(self) -> float:
        """Monotonic."""

    def sleep(self, seconds: float) -> None:
        """Wait for this time."""


class Refusal(Struct, frozen=True, kw_only=True):
    """The first refusal of one command by one vehicle. `code` is None without an answer from its agent."""

    time_s: float
    vehicle: int
    command: CommandName
    code: Code | None
    reason: str


class Order:
    """One command to its vehicles, repeated to those that refuse it or leave its phase."""

    EXPIRES = False  # whether its content names a time, so that it is given only once

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        self._session = session
        self._clock = clock
        self._watch = watch
        self._step = step
        self._ids = sorted(step.vehicles) or watch.vehicle_ids
        self._accepted_s: dict[int, float] = {}
        self._reasons: dict[int, str] = {}
        self._observing_since_s: dict[int, float] = {}

    def carry_out(self, wait: Callable[[], None]) -> None:
        """Repeat until every vehicle has done it. Raises FlightFailure."""
        deadline_s = self._clock.now_s() + self._step.patience_s
        next_command_s = float("-inf")
        while missing := [i for i in self._ids if not self._done(i)]:
            now_s = self._clock.now_s()
            if now_s > deadline_s:
                raise FlightFailure(self._too_late(missing))
            open_ids = [i for i in missing if i not in self._accepted_s]
            if open_ids and now_s >= next_command_s:
                next_command_s = now_s + REPEAT_S
                self._command(open_ids)
            wait()
            for vehicle_id in missing:
                self._check_phase(vehicle_id, self._clock.now_s())

    def attempt(self, wait: Callable[[], None]) -> list[Refusal]:
        """Give it until every vehicle has accepted it, or for the time of the step. Returns the refusals that remain."""
        began_s = self._clock.now_s()
        first: dict[int, Refusal] = {}
        while open_ids := [i for i in self._ids if i not in self._accepted_s]:
            given_s = self._clock.now_s()
            for vehicle_id, reply in self._command(open_ids).items():
                first.setdefault(vehicle_id, self._refusal(vehicle_id, reply))
            if self.EXPIRES or self._clock.now_s() > began_s + self._step.patience_s:
                break
            while self._clock.now_s() < given_s + REPEAT_S and len(self._accepted_s) < len(self._ids):
                wait()
        return [refusal for vehicle_id, refusal in first.items() if vehicle_id not in self._accepted_s]

    def _statuses(self) -> list[Status]:
        return [status for i in self._watch.vehicle_ids if (status := self._watch.status(i))]

    def _refusal(self, vehicle_id: int, reply: CommandReply | None) -> Refusal:
        return Refusal(
            time_s=round(self._clock.now_s() - self._watch.began_s, 3),
            vehicle=vehicle_id,
            command=self._step.command,
            code=reply.code if reply else None,
            reason=reply.reason if reply else "no answer from its agent",
        )

    def _command(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        given_s = self._clock.now_s()
        replies = self._give(vehicle_ids)
        self._watch.note_answers(given_s, self._clock.now_s(), self._step, replies)
        for vehicle_id, reply in replies.items():
            if reply is not None and reply.accepted:
                self._accepted_s[vehicle_id] = self._clock.now_s()
            self._reasons[vehicle_id] = f"{reply.code}: {reply.reason}" if reply else "no answer from its agent"
        return replies

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        return self._session.command(vehicle_ids, self._step.command, REPLY_WITHIN_S)

    def _done(self, vehicle_id: int) -> bool:
        status = self._watch.status(vehicle_id)
        if status is None or vehicle_id not in self._accepted_s:
            return False
        lands = self._step.command in (CommandName.DISARM, *TO_THE_GROUND)
        return status.phase is RULES[self._step.command].to and not (lands and status.armed)

    def _check_phase(self, vehicle_id: int, now_s: float) -> None:
        """Repeat an accepted command for a vehicle that left its phases. Raises FlightFailure for one that observes."""
        status, rule = self._watch.status(vehicle_id), RULES[self._step.command]
        accepted_s = self._accepted_s.get(vehicle_id)
        if status is None or accepted_s is None or now_s < accepted_s + REPEAT_S:
            return  # reports from before the command do not count
        if status.phase not in (rule.via, rule.to):
            del self._accepted_s[vehicle_id]
            self._reasons[vehicle_id] = newest_report(status)
            if status.phase is FlightPhase.OBSERVE and self._step.command not in MAY_OBSERVE:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {newest_report(status)}")
        elif self._step.command in TO_THE_GROUND and status.phase is rule.to and status.armed:
            # Mode and armed state come in different messages and may disagree for a while after touchdown.
            observing_since_s = self._observing_since_s.setdefault(vehicle_id, now_s)
            if now_s > observing_since_s + DISARM_SEEN_WITHIN_S:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {newest_report(status)}")

    def _too_late(self, missing: Sequence[int]) -> str:
        by_reason: dict[str, list[int]] = {}
        for vehicle_id in missing:
            status, reason = self._watch.status(vehicle_id), self._reasons.get(vehicle_id, "")
            if vehicle_id in self._accepted_s and status:
                reason = self._why_not_done(status)
            by_reason.setdefault(reason, []).append(vehicle_id)
        reasons = "; ".join(f"{vehicles_in_words(ids)}: {reason}" for reason, ids in by_reason.items())
        return f"{self._step.command} not done within {self._step.patience_s:g} s: {reasons}"

    def _why_not_done(self, status: Status) -> str:
        under_way = status.phase is RULES[self._step.command].via
        return f"still in phase {status.phase}" if under_way else newest_report(status)


class _LeadOrder(Order):
    """A change of leaders, to every vehicle, with a new epoch; it changes no phase."""

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        known = (status.epoch for i in watch.vehicle_ids if (status := watch.status(i)))
        self._lead = Lead(step.leaders, next_epoch(known))
        others = [i for i in watch.vehicle_ids if i not in step.leaders]
        self._reasons = dict.fromkeys(others, "not commanded before the new leaders have accepted")

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        """The others are commanded after all new leaders have accepted, so that the fleet always has a leader."""
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

    def _check_phase(self, vehicle_id: int, now_s: float) -> None:
        """The command changes no phase; phases are checked while the step lasts."""

    def _why_not_done(self, status: Status) -> str:
        return f"{status.role} in epoch {status.epoch}, expected epoch {self._lead.epoch}"


class _FormationOrder(Order):
    """A formation change, for every vehicle at the same mission time; it changes no phase."""

    EXPIRES = True

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        self._change = self._new_change()

    def _new_change(self) -> FormationChange:
        wanted, statuses = self._step.formation, self._statuses()
        assert wanted is not None  # checked when the scenario was read
        return change_to(_slots(wanted, statuses), statuses, wanted.speed_m_s)

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        if not self._accepted_s:  # while all refuse, its begin passes
            self._change = self._new_change()
        return self._session.command(vehicle_ids, CommandName.FORMATION, REPLY_WITHIN_S, self._change)

    def _done(self, vehicle_id: int) -> bool:
        """The change is accepted and complete."""
        status = self._watch.status(vehicle_id)
        accepted = status is not None and status.slot.formation == self._change.number
        return accepted and status is not None and self._way_left_m(status) < SLOT_REACHED_M

    def _way_left_m(self, status: Status) -> float:
        """From the slot that the vehicle flies to its slot in the new formation."""
        return dist(status.slot.position_enu_m, dict(self._change.slots_enu_m)[status.vehicle_id])

    def _check_phase(self, vehicle_id: int, now_s: float) -> None:
        """The command changes no phase; phases are checked while the step lasts."""

    def _why_not_done(self, status: Status) -> str:
        number, wanted = status.slot.formation, self._change.number
        if number != wanted:
            return f"formation {number}, expected {wanted}"
        return f"its slot is {self._way_left_m(status):.2f} m from that of formation {wanted}"


def _slots(wanted: FormationStep, statuses: Sequence[Status]) -> Mapping[int, Vector3]:
    """Slot by vehicle id: as given, or those of the shape assigned to the vehicles."""
    if wanted.shape is None or wanted.spacing_m is None:
        return wanted.slots_enu_m
    slots = named_slots(wanted.shape, len(statuses), wanted.spacing_m, wanted.heading_deg)
    return assigned(positions_enu_m(statuses), slots)


class _ReferenceOrder(Order):
    """Another RFT, for the vehicles that may lead, from the same mission time on; it changes no phase."""

    EXPIRES = True

    def __init__(self, session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        super().__init__(session, watch, step, clock)
        followers_only = {status.vehicle_id for status in self._statuses() if status.reference is None}
        self._ids = [i for i in self._ids if i not in followers_only]
        self._change = self._new_change()

    def _new_change(self) -> ReferenceChange:
        return reference_change(msgspec.to_builtins(self._step.reference), self._statuses())

    def _give(self, vehicle_ids: Collection[int]) -> dict[int, CommandReply | None]:
        if not self._accepted_s:  # while all refuse, its begin passes
            self._change = self._new_change()
        return self._session.command(vehicle_ids, CommandName.REFERENCE, REPLY_WITHIN_S, self._change)

    def _done(self, vehicle_id: int) -> bool:
        """The RFT is flown; a vehicle that does not report its reference counts as done."""
        status = self._watch.status(vehicle_id)
        return status is not None and (status.reference is None or status.reference.flown == self._change.number)

    def _check_phase(self, vehicle_id: int, now_s: float) -> None:
        """The command changes no phase; phases are checked while the step lasts."""

    def _why_not_done(self, status: Status) -> str:
        return newest_report(status)


def newest_report(status: Status) -> str:
    return str(status.last_event or f"phase {status.phase}, mode {status.mode_name}")


def order_of(session: Session, watch: FlightWatch, step: TimelineStep, clock: Clock) -> Order:
    """The order of a step; some commands change no phase, and the flight continues under them."""
    return ORDERS.get(step.command, Order)(session, watch, step, clock)


ORDERS: dict[CommandName, type[Order]] = {
    CommandName.LEAD: _LeadOrder,
    CommandName.FORMATION: _FormationOrder,
    CommandName.REFERENCE: _ReferenceOrder,
}
