"""One step of a timeline: its command is repeated until all its vehicles have done it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import msgspec
from msgspec import Struct

from companion.ground.answers import TimedReply
from companion.ground.changes import (
    assign_slots,
    change_to,
    fleet_time_s,
    named_slots,
    positions_enu_m,
    reference_change,
)
from companion.ground.commands import Clock, CommandSession, give
from companion.ground.goals import Goal, goal_of, way_left_m
from companion.types.commands import CommandName, Content, Lead, ReferenceChange, next_epoch
from companion.types.errors import CompanionError
from companion.types.flight import RULES, FlightPhase
from companion.types.formation import FormationChange
from companion.types.notices import Code
from companion.types.status import Status
from companion.types.values import Vector3
from sitl.flight.scenario import FormationStep, TimelineStep
from sitl.flight.watch import FlightWatch, reasons_in_words

REPEAT_S = 0.5
REPLY_WITHIN_S = 0.5
DISARM_SEEN_WITHIN_S = 1.5  # heartbeats, which carry the armed state, come once a second
# After one of these commands a vehicle may be in phase observe without a failure.
TO_THE_GROUND = (CommandName.LAND, CommandName.RETURN)
MAY_OBSERVE = (CommandName.PREPARE, CommandName.DISARM, *TO_THE_GROUND)
BEGUN_WITHIN_S = 1.0  # after its begin, by fleet time, a change is reported as flown
EXPIRING = (CommandName.FORMATION, CommandName.REFERENCE)  # their content names the time when it begins


class FlightFailure(CompanionError):  # noqa: N818 -- an outcome of a flight, not an error of this program
    """The flight cannot continue. str() is the reason in one line."""


class Refusal(Struct, frozen=True, kw_only=True):
    """The first refusal of one command by one vehicle. `code` is None without an answer from its agent."""

    time_s: float
    vehicle: int
    command: CommandName
    code: Code | None
    reason: str


class Order:
    """One command to its vehicles, repeated to those that refuse it or leave its phase."""

    def __init__(self, session: CommandSession, watch: FlightWatch, step: TimelineStep, clock: Clock) -> None:
        self._session = session
        self._clock = clock
        self._watch = watch
        self._step = step
        self._rule = RULES.get(step.command)  # None for a change: the flight continues under it in its phase
        self._ids = sorted(step.vehicles) or watch.vehicle_ids
        if step.command is CommandName.REFERENCE:  # for the vehicles that may lead
            followers_only = {
                status.agent.vehicle_id for status in watch.statuses() if status.formation.reference is None
            }
            self._ids = [i for i in self._ids if i not in followers_only]
        self._content: Content | None = None
        self._goal: Goal | None = None  # of a change that was given
        self._accepted_s: dict[int, float] = {}
        self._reasons: dict[int, str] = {}
        if step.command is CommandName.LEAD:
            others = [i for i in watch.vehicle_ids if i not in step.leaders]
            self._reasons = dict.fromkeys(others, "not commanded before the new leaders have accepted")
        self._observing_since_s: dict[int, float] = {}

    def carry_out(self, wait: Callable[[], None]) -> None:
        """Repeat until every vehicle has done it. Raises FlightFailure."""
        deadline_s = self._clock.now_s() + self._step.patience_s
        next_command_s = float("-inf")
        while missing := [i for i in self._ids if not self._is_done(i)]:
            now_s = self._clock.now_s()
            if now_s > deadline_s:
                raise FlightFailure(self._too_late(missing))
            self._renew_if_over()
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
            for vehicle_id, answer in self._command(open_ids).items():
                first.setdefault(vehicle_id, self._refusal(vehicle_id, answer))
            if self._step.command in EXPIRING or self._clock.now_s() > began_s + self._step.patience_s:
                break
            while self._clock.now_s() < given_s + REPEAT_S and len(self._accepted_s) < len(self._ids):
                wait()
        return [refusal for vehicle_id, refusal in first.items() if vehicle_id not in self._accepted_s]

    def _refusal(self, vehicle_id: int, answer: TimedReply | None) -> Refusal:
        return Refusal(
            time_s=round(self._clock.now_s() - self._watch.began_s, 3),
            vehicle=vehicle_id,
            command=self._step.command,
            code=answer.reply.code if answer else None,
            reason=answer.reply.reason if answer else "no answer from its agent",
        )

    def _command(self, vehicle_ids: Collection[int]) -> dict[int, TimedReply | None]:
        given_s = self._clock.now_s()
        if not self._accepted_s and (self._content is None or self._step.command in EXPIRING):
            self._content = content_of(self._step, self._watch.statuses())  # while all refuse, its begin passes
            self._goal = goal_of(self._step.command, self._content, running=True) if self._content else None
        answers = give(self._session, vehicle_ids, self._step.command, REPLY_WITHIN_S, self._content)
        self._watch.note_answers(given_s, self._clock.now_s(), self._step, answers)
        for vehicle_id, answer in answers.items():
            if answer is not None and answer.reply.accepted:
                self._accepted_s[vehicle_id] = self._clock.now_s()
            reply = answer.reply if answer else None
            self._reasons[vehicle_id] = f"{reply.code}: {reply.reason}" if reply else "no answer from its agent"
        return answers

    def _renew_if_over(self) -> None:
        """Give a change again whose begin has passed without a vehicle that flies it: all have cancelled or refused it."""
        content, statuses = self._content, self._watch.statuses()
        if not isinstance(content, FormationChange | ReferenceChange) or self._step.command not in EXPIRING:
            return
        if fleet_time_s(statuses) > content.begins_s + BEGUN_WITHIN_S and not any(
            number_flown(status, content) == content.number for status in statuses
        ):
            self._content = None
            self._accepted_s.clear()

    def _is_done(self, vehicle_id: int) -> bool:
        status = self._watch.status(vehicle_id)
        if status is None:
            return False
        if self._rule is None:  # a vehicle that missed a change of leaders learns it from the others
            return self._goal is not None and self._goal.reached(status)
        lands = self._step.command in (CommandName.DISARM, *TO_THE_GROUND)
        return (
            vehicle_id in self._accepted_s and status.phase is self._rule.to and not (lands and status.autopilot.armed)
        )

    def _check_phase(self, vehicle_id: int, now_s: float) -> None:
        """Repeat an accepted command for a vehicle that left its phases. Raises FlightFailure for one that observes."""
        status, rule = self._watch.status(vehicle_id), self._rule
        accepted_s = self._accepted_s.get(vehicle_id)
        if status is None or rule is None or accepted_s is None or now_s < accepted_s + REPEAT_S:
            return  # reports from before the command do not count
        if status.phase not in (rule.via, rule.to):
            del self._accepted_s[vehicle_id]
            self._reasons[vehicle_id] = newest_report(status)
            if status.phase is FlightPhase.OBSERVE and self._step.command not in MAY_OBSERVE:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {newest_report(status)}")
        elif self._step.command in TO_THE_GROUND and status.phase is rule.to and status.autopilot.armed:
            # Mode and armed state come in different messages and may disagree for a while after touchdown.
            observing_since_s = self._observing_since_s.setdefault(vehicle_id, now_s)
            if now_s > observing_since_s + DISARM_SEEN_WITHIN_S:
                raise FlightFailure(f"vehicle {vehicle_id} gave up at {self._step.command}: {newest_report(status)}")

    def _too_late(self, missing: Sequence[int]) -> str:
        reasons = reasons_in_words({i: self._why_not_done(i) for i in missing})
        return f"{self._step.command} not done within {self._step.patience_s:g} s: {reasons}"

    def _why_not_done(self, vehicle_id: int) -> str:
        """Its last refusal, or what is missing in a vehicle that has accepted."""
        status = self._watch.status(vehicle_id)
        if vehicle_id not in self._accepted_s or status is None:
            return self._reasons.get(vehicle_id, "")
        match self._content:
            case Lead(epoch=epoch):
                return f"{status.leadership.role} in epoch {status.leadership.epoch}, expected epoch {epoch}"
            case FormationChange(number=number) as change:
                if status.formation.slot.formation != number:
                    return f"formation {status.formation.slot.formation}, expected {number}"
                return f"its slot is {way_left_m(status, change):.2f} m from that of formation {number}"
        under_way = self._rule is not None and status.phase is self._rule.via
        return f"still in phase {status.phase}" if under_way else newest_report(status)


def content_of(step: TimelineStep, statuses: Sequence[Status]) -> Content | None:
    """What the command of a step carries, by the newest reports; None for a command that changes the phase."""
    if step.command is CommandName.LEAD:
        return Lead(step.leaders, next_epoch(status.leadership.epoch for status in statuses))
    if step.formation is not None:
        return change_to(_slots(step.formation, statuses), statuses, step.formation.speed_m_s)
    if step.reference is not None:
        return reference_change(msgspec.to_builtins(step.reference), statuses)
    return None


def _slots(wanted: FormationStep, statuses: Sequence[Status]) -> Mapping[int, Vector3]:
    """Slot by vehicle id: as given, or those of the shape assigned to the vehicles."""
    if wanted.shape is None or wanted.spacing_m is None:
        return wanted.slots_enu_m
    slots = named_slots(wanted.shape, len(statuses), wanted.spacing_m, wanted.heading_deg)
    return assign_slots(positions_enu_m(statuses), slots)


def number_flown(status: Status, change: FormationChange | ReferenceChange) -> int | None:
    """Number of what this vehicle flies of the kind of the change; None for a reference where it may not lead."""
    if isinstance(change, FormationChange):
        return status.formation.slot.formation
    return status.formation.reference.flown if status.formation.reference else None


def newest_report(status: Status) -> str:
    return str(status.last_event or f"phase {status.phase}, mode {status.autopilot.mode_name}")
