"""From a request to commands: which vehicles get which command with which content, and in which order."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import msgspec

from companion import GROUND_INSTALL
from companion.config.fleet import FleetConfig
from companion.config.reference_check import check_reference
from companion.ground.answers import Answer, AnswerKind, Outcome, outcome_of
from companion.ground.changes import (
    FleetRequest,
    FormationRequest,
    ReferenceRequest,
    change_to,
    check_reports,
    check_request,
    command_line,
    reference_change,
    refusal_of,
    requested_reference,
    requested_slots,
)
from companion.ground.goals import ALL_OR_NONE, STILL_CHANGING, check_all
from companion.ground.session import POLL_S
from companion.types.commands import CommandName, Content, Lead, ReferenceChange, next_epoch
from companion.types.errors import CompanionError
from companion.types.flight import FlightPhase
from companion.types.formation import FormationChange
from companion.types.status import Status
from companion.types.values import ZERO3

PREPARED_WITHIN_S = 8.0  # the longest mode change of an autopilot, with a margin


class OperateError(CompanionError):
    """No command was sent. str() is one line with what to do."""


@dataclass(frozen=True, slots=True)
class Sent:
    """A command with its outcome for each vehicle. `running`: some vehicle was in formation when it was sent."""

    name: CommandName
    content: Content | None
    outcomes: dict[int, Outcome]
    running: bool = False


class Commanding(Protocol):
    """What a Sender uses of a FleetSession."""

    @property
    def operator(self) -> str: ...

    def newest(self) -> dict[int, Status]: ...

    def statuses(self, vehicle_ids: Iterable[int], timeout_s: float) -> dict[int, Status]: ...

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None
    ) -> dict[int, Answer | None]: ...


class Sender:
    """Sends the commands of one request over an open session."""

    def __init__(self, session: Commanding, fleet: FleetConfig, request: FleetRequest, ids: Sequence[int]) -> None:
        self._session = session
        self._fleet = fleet
        self._ids = ids  # the vehicles of the request
        self._all = [member.id for member in fleet.vehicles]
        self._wait_s = request.wait_s

    def send(self, request: FleetRequest) -> Sent:
        """Raises ConfigError and OperateError, before any command is sent."""
        if request.leaders:
            return self._lead(request.leaders)
        if request.formation:
            return self._formation(request.formation)
        if request.reference:
            return self._reference(request.reference)
        name = CommandName(request.action)
        if name is CommandName.ARM:
            return self._arm()
        if name in ALL_OR_NONE:
            return self._all_or_none(name)
        return Sent(name, None, self._ask(self._ids, name))

    def _ask(self, ids: Sequence[int], name: CommandName, content: Content | None = None) -> dict[int, Outcome]:
        answers = self._session.ask(ids, name, self._wait_s, content)
        return {vehicle_id: outcome_of(answer, self._wait_s) for vehicle_id, answer in answers.items()}

    def _arm(self) -> Sent:
        """Vehicles in phase observe are prepared first; one that refuses that is not armed."""
        reports = self._session.statuses(self._ids, self._wait_s)
        observing = [i for i, status in reports.items() if status.phase is FlightPhase.OBSERVE and not status.armed]
        outcomes = self._ask(observing, CommandName.PREPARE)
        prepared = [i for i, outcome in outcomes.items() if outcome.kind is AnswerKind.ACCEPTED]
        self._wait_while(prepared, {FlightPhase.OBSERVE, FlightPhase.PREPARE}, PREPARED_WITHIN_S)
        to_arm = [i for i in self._ids if i not in outcomes or i in prepared]
        return Sent(CommandName.ARM, None, outcomes | self._ask(to_arm, CommandName.ARM))

    def _all_or_none(self, name: CommandName) -> Sent:
        """Sent only where the reports of all vehicles permit it."""
        self._session.statuses(self._ids, self._wait_s)
        self._wait_while(self._ids, STILL_CHANGING, self._wait_s)
        statuses = self._session.newest()
        refused = check_all(name, self._ids, statuses, self._session.operator, self._wait_s)
        return Sent(name, None, refused or self._ask(self._ids, name))

    def _wait_while(self, ids: Collection[int], phases: Collection[FlightPhase], within_s: float) -> None:
        """Until none of these vehicles is in one of the phases."""
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            reports = self._session.newest()
            if not any(i in reports and reports[i].phase in phases for i in ids):
                return
            time.sleep(POLL_S)

    def _lead(self, leaders: tuple[int, ...]) -> Sent:
        """The new leaders first; the other vehicles, the present leader among them, only after all of those have accepted.

        So no vehicle gives up leadership that no other takes. A vehicle without the command learns it from the new leaders.
        """
        reports = self._session.statuses(self._ids, self._wait_s)
        lead = Lead(leaders, next_epoch(status.epoch for status in reports.values()))
        outcomes = self._ask(leaders, CommandName.LEAD, lead)
        if all(outcome.kind is AnswerKind.ACCEPTED for outcome in outcomes.values()):
            outcomes |= self._ask([i for i in self._ids if i not in leaders], CommandName.LEAD, lead)
        return Sent(CommandName.LEAD, lead, outcomes)

    def _formation(self, request: FormationRequest) -> Sent:
        """From the present positions of all vehicles: all of them must report."""
        reports = self._session.statuses(self._all, self._wait_s)
        if silent := [str(i) for i in self._all if i not in reports]:
            raise OperateError(
                f"no report of vehicle {', '.join(silent)} for {self._wait_s:g} s; all vehicles get new slots"
            )
        statuses = list(reports.values())
        slots_enu_m = requested_slots(request, statuses, self._fleet)
        fleet = self._fleet
        has_height = fleet.law.altitude == "formation"
        if refusal := refusal_of(slots_enu_m, fleet.separation_m, has_height):
            raise OperateError(refusal)
        change = change_to(slots_enu_m, statuses, self._fleet.slot_speed_m_s)
        return self._changed(CommandName.FORMATION, self._ids, change, statuses)

    def _reference(self, request: ReferenceRequest) -> Sent:
        """Checked with the present slots, as by each vehicle that may lead."""
        reports = self._session.statuses(self._all, self._wait_s)
        if not reports:
            raise OperateError(f"no report of any vehicle for {self._wait_s:g} s")
        statuses = list(reports.values())
        check_reports("reference", statuses)
        flown = [status.reference_enu_m for status in statuses if status.reference_enu_m]
        reference = requested_reference(request, here_enu_m=flown[0] if flown else None)
        slots_enu_m = {status.vehicle_id: status.slot.position_enu_m for status in statuses}
        check_reference(request.file or command_line("reference"), self._fleet, reference, slots_enu_m=slots_enu_m)
        change = reference_change(msgspec.to_builtins(reference), statuses)
        may_lead = [member.id for member in self._fleet.vehicles if member.can_lead]
        return self._changed(CommandName.REFERENCE, may_lead, change, statuses)

    def _changed(
        self,
        name: CommandName,
        ids: Sequence[int],
        change: FormationChange | ReferenceChange,
        statuses: Sequence[Status],
    ) -> Sent:
        running = any(status.phase is FlightPhase.FORMATION for status in statuses)
        return Sent(name, change, self._ask(ids, name, change), running)


def check_content(request: FleetRequest, fleet: FleetConfig) -> None:
    """Finds mistakes before the wait for any vehicle. Raises ConfigError and OperateError."""
    if request.formation:
        _need_scipy()
        check_request(request.formation, fleet)
    if request.reference:
        requested_reference(request.reference, here_enu_m=ZERO3)


def _need_scipy() -> None:
    """The assignment of slots uses it. Raises OperateError."""
    try:
        import scipy.optimize  # noqa: F401
    except ImportError as error:
        raise OperateError(f"formations need the package scipy: {GROUND_INSTALL}") from error
