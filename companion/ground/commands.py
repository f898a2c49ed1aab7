"""The only way of a command to a fleet: which vehicles get it with which content and in which order, and when it is done.

Session and clock are arguments: vehicles over Zenoh and the machine's clock, or a fleet in virtual time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import msgspec

from companion import GROUND_INSTALL
from companion.config.degrees import degree_notices
from companion.config.fleet import FleetConfig
from companion.config.reference_check import check_reference
from companion.ground.answers import AnswerKind, End, Outcome, TimedReply, outcome_of
from companion.ground.belief import Doubt, believed
from companion.ground.changes import (
    FleetAction,
    FormationRequest,
    ReferenceRequest,
    change_to,
    check_request,
    command_line,
    flown_slots_enu_m,
    reference_change,
    refusal_of,
    resolve_reference,
    resolve_reference_now,
    resolve_slots,
)
from companion.ground.goals import (
    ALL_OR_NONE,
    GOALS,
    NOT_HELD_S,
    STILL_CHANGING,
    Goal,
    check_all,
    end_cancelled,
    end_of,
    end_timed_out,
    progress_text,
)
from companion.types.commands import CommandName, Content, Lead, next_epoch
from companion.types.errors import CompanionError
from companion.types.flight import FlightPhase
from companion.types.notices import Notice
from companion.types.status import Status
from companion.types.values import ZERO3

POLL_S = 0.01
PREPARED_WITHIN_S = 8.0  # the longest mode change of an autopilot, with a margin
PROGRESS_EVERY_S = 0.05
FIRST_REPORTS_S = 1.0  # wait this long for a report of every vehicle before progress is shown


class OperateError(CompanionError):
    """No command was sent. str() is one line with what to do."""


class Clock(Protocol):
    """The time in which vehicles answer."""

    def now_s(self) -> float:
        """Monotonic."""

    def sleep(self, seconds: float) -> None:
        """Wait for this time."""


class MachineClock:
    """The machine's monotonic clock."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


MACHINE_CLOCK = MachineClock()


class CommandSession(Protocol):
    """The vehicles as an operator reaches them; `session.FleetSession` is one."""

    @property
    def operator(self) -> str:
        """The name by which commands are sent."""

    def newest(self) -> Mapping[int, Status]:
        """The newest status of each vehicle that reports."""

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        """Give one command to these vehicles and wait for their replies; None for a vehicle without one in time."""

    def check(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        """What these vehicles would answer to this command. They change nothing."""


def give(
    session: CommandSession,
    vehicle_ids: Collection[int],
    name: CommandName,
    timeout_s: float,
    content: Content | None = None,
) -> dict[int, TimedReply | None]:
    """One command to these vehicles, once.

    New leaders get a change of leaders first; the other vehicles, the present leader among them, only after all of those have
    accepted. So no vehicle gives up leadership that no other takes. A vehicle without the command learns it from the leaders.
    """
    if not isinstance(content, Lead):
        return session.ask(vehicle_ids, name, timeout_s, content)
    leaders = [i for i in vehicle_ids if i in content.leaders]
    answers = session.ask(leaders, name, timeout_s, content) if leaders else {}
    if not all(answer and answer.reply.accepted for answer in answers.values()):
        return answers
    others = [i for i in vehicle_ids if i not in content.leaders]
    return answers | session.ask(others, name, timeout_s, content)


@dataclass(frozen=True, slots=True)
class Sent:
    """A command, or the check of one, with its outcome for each vehicle. `running`: some vehicle was in formation then.

    `absent` vehicles do not report and got no command. `doubts`: what vehicles report that cannot be true. `warnings`: what of
    the content is probably meant otherwise.
    """

    name: CommandName
    content: Content | None
    outcomes: dict[int, Outcome]
    running: bool = False
    absent: tuple[int, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    warnings: tuple[Notice, ...] = ()


class OperatorCommands:
    """Commands of one operator to one fleet, over an open session."""

    def __init__(
        self, session: CommandSession, fleet: FleetConfig, wait_s: float, clock: Clock = MACHINE_CLOCK
    ) -> None:
        """`wait_s` is the time for reports, and for replies."""
        self._session = session
        self._clock = clock
        self._fleet = fleet
        self._all = [member.id for member in fleet.vehicles]
        self._wait_s = wait_s

    def send(self, action: FleetAction) -> Sent:
        """Raises ConfigError and OperateError, before any command is sent."""
        ids, to_send = self._resolved(action)
        if to_send.name is CommandName.ARM:
            outcomes = self._arm(ids)
        elif to_send.name in ALL_OR_NONE:
            outcomes = self._all_or_none(to_send.name, ids)
        else:
            outcomes = self._give(ids, to_send.name, to_send.content)
        return self._sent(to_send, outcomes)

    def check(self, action: FleetAction) -> Sent:
        """What each vehicle would answer, by its own checks and in its own state. Nothing changes.

        `arm` of a vehicle that is not prepared is checked as far as the first step, `prepare`. Raises as `send`.
        """
        ids, to_send = self._resolved(action)
        first = self._observing(ids) if to_send.name is CommandName.ARM else []
        rest = [i for i in ids if i not in first]
        answers = self._session.check(first, CommandName.PREPARE, self._wait_s) if first else {}
        answers |= self._session.check(rest, to_send.name, self._wait_s, to_send.content) if rest else {}
        return self._sent(to_send, self._outcomes(answers))

    def _sent(self, command: Sent, outcomes: dict[int, Outcome]) -> Sent:
        in_degrees = degree_notices(self._fleet.origin, command.content)
        return replace(command, outcomes=outcomes, warnings=tuple(in_degrees))

    def _resolved(self, action: FleetAction) -> tuple[Sequence[int], Sent]:
        """The vehicles that get the command, and the command without outcomes yet."""
        if action.leaders:
            return self._lead(action.leaders)
        if action.formation:
            return self._formation(action.formation)
        if action.reference:
            return self._reference(action.reference)
        return sorted(set(action.only)) or self._all, Sent(CommandName(action.name), None, {})

    def _give(self, ids: Collection[int], name: CommandName, content: Content | None = None) -> dict[int, Outcome]:
        return self._outcomes(give(self._session, ids, name, self._wait_s, content))

    def _outcomes(self, answers: Mapping[int, TimedReply | None]) -> dict[int, Outcome]:
        return {vehicle_id: outcome_of(answer, self._wait_s) for vehicle_id, answer in answers.items()}

    def _observing(self, ids: Sequence[int]) -> list[int]:
        """The vehicles that are not prepared yet."""
        reports = self._statuses(ids)
        return [
            i for i, status in reports.items() if status.phase is FlightPhase.OBSERVE and not status.autopilot.armed
        ]

    def _arm(self, ids: Sequence[int]) -> dict[int, Outcome]:
        """Vehicles in phase observe are prepared first; one that refuses that is not armed."""
        outcomes = self._give(self._observing(ids), CommandName.PREPARE)
        prepared = [i for i, outcome in outcomes.items() if outcome.kind is AnswerKind.ACCEPTED]
        self._wait_while(prepared, {FlightPhase.OBSERVE, FlightPhase.PREPARE}, PREPARED_WITHIN_S)
        to_arm = [i for i in ids if i not in outcomes or i in prepared]
        return outcomes | self._give(to_arm, CommandName.ARM)

    def _all_or_none(self, name: CommandName, ids: Sequence[int]) -> dict[int, Outcome]:
        """Sent only where the reports of all vehicles permit it."""
        self._statuses(ids)
        self._wait_while(ids, STILL_CHANGING, self._wait_s)
        statuses = self._session.newest()
        return check_all(name, ids, statuses, self._session.operator, self._wait_s) or self._give(ids, name)

    def _lead(self, leaders: tuple[int, ...]) -> tuple[Sequence[int], Sent]:
        lead = Lead(leaders, next_epoch(status.leadership.epoch for status in self._statuses(self._all).values()))
        return self._all, Sent(CommandName.LEAD, lead, {})

    def _formation(self, request: FormationRequest) -> tuple[Sequence[int], Sent]:
        """From the present positions of all vehicles that report; the others count as absent, and their slots stay empty.

        The vehicles cancel it where one of those flies in formation after all.
        """
        reports = self._statuses(self._all)
        if not reports:
            raise OperateError(f"no report of any vehicle for {self._wait_s:g} s")
        fleet = self._fleet
        statuses, doubts, unsure, reach_m = believed(reports.values(), fleet)
        slots_enu_m = resolve_slots(request, statuses, fleet, unsure)
        if refusal := refusal_of(slots_enu_m, fleet.separation_m, has_height=fleet.law.altitude == "formation"):
            raise OperateError(refusal)
        change = change_to(slots_enu_m, statuses, fleet.slot_speed_m_s, reach_m)
        return list(reports), Sent(CommandName.FORMATION, change, {}, time_runs(statuses), change.absent, doubts)

    def _reference(self, request: ReferenceRequest) -> tuple[Sequence[int], Sent]:
        """Checked with the present slots, as by each vehicle that may lead."""
        reports = self._statuses(self._all)
        if not reports:
            raise OperateError(f"no report of any vehicle for {self._wait_s:g} s")
        statuses, doubts, unsure, _ = believed(reports.values(), self._fleet)
        reference = resolve_reference_now(request, statuses)
        slots_enu_m = flown_slots_enu_m([s for s in statuses if s.agent.vehicle_id not in unsure] or statuses)
        check_reference(request.file or command_line("reference"), self._fleet, reference, slots_enu_m=slots_enu_m)
        change = reference_change(msgspec.to_builtins(reference), statuses)
        may_lead = [member.id for member in self._fleet.vehicles if member.can_lead]
        return may_lead, Sent(CommandName.REFERENCE, change, {}, time_runs(statuses), doubts=doubts)

    def _statuses(self, ids: Iterable[int]) -> dict[int, Status]:
        """Status of these vehicles when all have reported, or of those that have in time."""
        return statuses_of(self._session.newest, ids, self._wait_s, self._clock)

    def _wait_while(self, ids: Collection[int], phases: Collection[FlightPhase], within_s: float) -> None:
        """Until none of these vehicles is in one of the phases."""
        deadline_s = self._clock.now_s() + within_s
        while self._clock.now_s() < deadline_s:
            reports = self._session.newest()
            if not any(i in reports and reports[i].phase in phases for i in ids):
                return
            self._clock.sleep(POLL_S)


def statuses_of(
    newest: Callable[[], Mapping[int, Status]], ids: Iterable[int], within_s: float, clock: Clock = MACHINE_CLOCK
) -> dict[int, Status]:
    """Status of these vehicles when all have reported, or of those that have after `within_s`."""
    wanted, deadline_s = set(ids), clock.now_s() + within_s
    while not wanted <= (reports := newest()).keys() and clock.now_s() < deadline_s:
        clock.sleep(POLL_S)
    return {i: reports[i] for i in sorted(wanted & reports.keys())}


def time_runs(statuses: Iterable[Status]) -> bool:
    """Whether the time of the reference runs: some vehicle is in formation."""
    return any(status.phase is FlightPhase.FORMATION for status in statuses)


def wait_for(
    goal: Goal,
    outcomes: Mapping[int, Outcome],
    newest: Callable[[], Mapping[int, Status]],
    timeout_s: float,
    show: Callable[[str], None],
    clock: Clock = MACHINE_CLOCK,
) -> dict[int, Outcome]:
    """The outcomes with the end of every accepted action. Only reports newer than the command count; ABORT has no number."""
    pending = {
        i: 0 if goal is GOALS[CommandName.ABORT] else outcome.number
        for i, outcome in outcomes.items()
        if outcome.kind is AnswerKind.ACCEPTED
    }
    ends: dict[int, End] = {}
    seen_held: set[int] = set()
    began_s, before = clock.now_s(), ""
    while pending:
        reports = newest()
        statuses = {
            i: reports[i]
            for i, number in pending.items()
            if i in reports and reports[i].command.command_number >= number
        }
        after_s = clock.now_s() - began_s
        ends |= {i: end for i, status in statuses.items() if (end := end_of(goal, status, after_s))}
        held = {i for i, status in statuses.items() if goal.held(status)}
        dropped = seen_held - held if after_s < NOT_HELD_S else statuses.keys() - held
        ends |= {i: end_cancelled(goal, statuses[i], after_s) for i in dropped & statuses.keys() - ends.keys()}
        seen_held |= held
        pending = {i: number for i, number in pending.items() if i not in ends}
        statuses = {i: status for i, status in statuses.items() if i in pending}
        line = progress_text(goal, ends, {i: statuses.get(i) for i in pending}, len(outcomes))
        if line != before and (len(statuses) == len(pending) or after_s > FIRST_REPORTS_S):
            show(f"{after_s:5.1f} s  {line}")
            before = line
        if after_s > timeout_s:
            ends |= {i: end_timed_out(goal, statuses.get(i), after_s, timeout_s) for i in pending}
            break
        clock.sleep(PROGRESS_EVERY_S)
    return {i: replace(outcome, end=ends.get(i)) for i, outcome in outcomes.items()}


def check_content(action: FleetAction, fleet: FleetConfig) -> None:
    """Finds mistakes before the wait for any vehicle. Raises ConfigError and OperateError."""
    if action.formation:
        try:
            import scipy.optimize  # noqa: F401 -- it takes seconds: before reports are read, not after
        except ImportError as error:
            raise OperateError(f"formations need the package scipy: {GROUND_INSTALL}") from error
        check_request(action.formation, fleet)
    if action.reference:
        resolve_reference(action.reference, here_enu_m=ZERO3)
