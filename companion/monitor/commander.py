"""Sends the commands of the live page, each in a thread: one at a time; ABORT, hold and land end the one under way."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from typing import Protocol, TypeVar

from msgspec.structs import replace

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.ground.answers import AnswerKind, Outcome, TimedReply, accepted_instead, id_list, outcome_of
from companion.ground.changes import FleetAction
from companion.ground.commands import OperateError, OperatorCommands, check_content
from companion.ground.fleet_state import SILENT_AFTER_S
from companion.ground.goals import advise_divided_fleet
from companion.ground.reports import Check, no_report, readiness_of, verdict_of
from companion.ground.session import FleetSession
from companion.monitor.api import AnswerView, CommandRequest, CommandResult, Preview
from companion.monitor.command_requests import ABORT, DOCTOR, HOLD, LAND, WAIT_S, fleet_action, preview_of
from companion.monitor.events import Given, Kind
from companion.types.commands import CommandName, Content
from companion.types.errors import CompanionError
from companion.types.notices import Code, Notice
from companion.types.status import Status

AT_ONCE = 16  # commands with threads of their own; a further one waits for one of them
URGENT = frozenset({HOLD, LAND})  # they end the command under way
REFUSALS = (ConfigError, OperateError)

T = TypeVar("T")


class Log(Protocol):
    """Station.log."""

    def __call__(
        self, fleet: str, vehicle_id: int | None, kind: Kind, code: str, text: str, given: Given = ...
    ) -> None: ...


class Commander:
    """Commands one fleet. `send` and `preview` belong to one event loop."""

    def __init__(self, session: FleetSession, fleet: FleetConfig, log: Log) -> None:
        self._session = session
        self._fleet = fleet
        self._log = log
        self._count = count(1)  # of its commands
        self._running: list[Running] = []  # oldest first; at most one is not urgent
        self._threads = ThreadPoolExecutor(max_workers=AT_ONCE, thread_name_prefix="command")
        self._abort_threads = ThreadPoolExecutor(max_workers=AT_ONCE, thread_name_prefix="abort")
        self._preview_threads = ThreadPoolExecutor(max_workers=1, thread_name_prefix="preview")
        self._check_threads = ThreadPoolExecutor(max_workers=1, thread_name_prefix="check")

    async def send(self, request: CommandRequest) -> CommandResult:
        """Waits for the answers, not for the end of the action.

        Refused while another command is being sent; ABORT, hold and land end that one instead. Only ABORT is never ended.
        """
        try:
            wanted = fleet_action(request, self._fleet)
        except OperateError as error:
            return CommandResult(request.name, (), error=_one_line(error))
        ids = sorted(set(wanted.only)) or [member.id for member in self._fleet.vehicles]
        if request.name == DOCTOR:
            return await self._in_thread(self._preview_threads, lambda: self._doctor(ids))
        running = Running(request.name, frozenset(ids))
        if request.name == ABORT:
            self._end(self._running, ABORT)
            return await self._send(wanted, running, self._abort_threads)
        before = list(self._running)
        if before and request.name not in URGENT:
            text = f"{before[-1].name} is being sent; wait for its answers"
            return CommandResult(request.name, (), error=text)
        self._running.append(running)
        try:
            await self._make_way(running, before)
            return await self._send(wanted, running, self._threads)
        finally:
            self._running.remove(running)
            running.left.set()

    def _end(self, those: Sequence[Running], by: str) -> None:
        """They are not repeated any more, and send nothing further."""
        for running in those:
            running.end(by)

    async def _make_way(self, urgent: Running, before: Sequence[Running]) -> None:
        """Ends the commands before this one, and waits for them, so that each vehicle gets this one last.

        Another urgent one that is also for other vehicles is not ended: those may not have it yet.
        """
        self._end([one for one in before if one.name not in URGENT or one.ids <= urgent.ids], urgent.name)
        for one in before:
            if one.ids & urgent.ids and not one.is_checked:
                await one.left.wait()

    async def _send(self, wanted: FleetAction, running: Running, threads: ThreadPoolExecutor) -> CommandResult:
        """In one of these threads."""
        ids = sorted(running.ids)
        given = Given(self._session.operator, f"{self._session.operator}/{next(self._count)}")
        self._log_command(wanted.name, ids, wanted, given)
        session = UntilEnded(self._session, running)
        try:
            await self._check(wanted, running)
            result = await self._in_thread(threads, lambda: self._sent(session, wanted))
        except REFUSALS as error:
            result = CommandResult(wanted.name, (), error=_one_line(error))
        return self._logged(result, given)

    async def _check(self, wanted: FleetAction, running: Running) -> None:
        """Of the content, before anything is sent. Raises ConfigError and OperateError."""
        if wanted.formation:  # with scipy, which takes seconds to load: neither the event loop nor hold waits for it
            running.is_checked = True
            await self._in_thread(self._preview_threads, lambda: check_content(wanted, self._fleet))
            running.is_checked = False
        else:
            check_content(wanted, self._fleet)

    async def preview(self, request: CommandRequest) -> Preview:
        """What `formation` or `reference` would do, and what each vehicle says to it. Nothing changes."""
        try:
            wanted = fleet_action(request, self._fleet)
            if not (wanted.formation or wanted.reference):
                raise OperateError("name: expected formation or reference; other commands have no preview")
            preview = await self._in_thread(self._preview_threads, lambda: self._previewed(wanted))
            if preview.refused:
                return preview
            return await self._in_thread(self._check_threads, lambda: self._checked(preview, wanted))
        except REFUSALS as error:
            return Preview(refused=_one_line(error))

    def _previewed(self, wanted: FleetAction) -> Preview:
        check_content(wanted, self._fleet)
        return preview_of(wanted, self._fleet, self._session.newest())

    def _checked(self, preview: Preview, wanted: FleetAction) -> Preview:
        """The preview with the vehicles' own answers."""
        sent = OperatorCommands(self._session, self._fleet, WAIT_S).check(wanted)
        refused: dict[str, list[int]] = {}
        for vehicle_id, outcome in sorted(sent.outcomes.items()):
            if outcome.kind is AnswerKind.REFUSED:
                refused.setdefault(str(outcome.notice), []).append(vehicle_id)
        return replace(
            preview,
            refused="; ".join(f"{id_list(ids)}: {text}" for text, ids in refused.items()),
            warning="; ".join(map(str, sent.warnings)),
            answers=_views(sent.outcomes),
            instead=accepted_instead(wanted, sent.content, sent.outcomes),
        )

    async def _in_thread(self, threads: ThreadPoolExecutor, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(threads, work)

    def _sent(self, session: UntilEnded, wanted: FleetAction) -> CommandResult:
        try:
            sent = OperatorCommands(session, self._fleet, WAIT_S).send(wanted)
        except EndedError as error:
            return CommandResult(wanted.name, _views(session.outcomes()), error=str(error))
        advice = advise_divided_fleet(sent.name, sent.outcomes)
        texts = [*map(str, sent.warnings), *map(str, sent.doubts), *([str(advice)] if advice else [])]
        return CommandResult(wanted.name, _views(sent.outcomes), "; ".join(texts))

    def _doctor(self, ids: list[int]) -> CommandResult:
        """The checks before flight; no command is sent."""
        checks = readiness_of(self._session.newest(), self._fleet)
        return CommandResult(DOCTOR, tuple(readiness_view(i, checks.get(i)) for i in ids))

    def _log_command(self, name: str, ids: list[int], wanted: FleetAction, given: Given) -> None:
        details = f" {', '.join(map(str, wanted.leaders))}" if wanted.leaders else ""
        if wanted.formation and wanted.formation.shape:
            details = f" {wanted.formation.shape}, {wanted.formation.spacing_m:g} m"
        text = f"{self._session.operator}: {name}{details} to {id_list(ids)}"
        self._log(self._fleet.name, None, "command", name, text, given)

    def _logged(self, result: CommandResult, given: Given) -> CommandResult:
        if result.error:
            code = Code.NO_REPLY if result.answers else Code.NOT_SENT
            outcome = given.answered(AnswerKind.MISSING if result.answers else AnswerKind.NOT_SENT)
            self._log(self._fleet.name, None, "answer", code, f"{result.name}: {result.error}", outcome)
        for answer in result.answers:
            text = f"{result.name} {answer.kind}: {answer.text}"
            outcome = given.answered(answer.kind)
            self._log(self._fleet.name, answer.vehicle_id, "answer", answer.code, text, outcome)
        return result

    def close(self) -> None:
        """What is being sent ends at its next step."""
        self._end(self._running, "the end of the server")
        for threads in (self._threads, self._abort_threads, self._preview_threads, self._check_threads):
            threads.shutdown(wait=False, cancel_futures=True)


def readiness_view(vehicle_id: int, checks: Sequence[Check] | None) -> AnswerView:
    """What the checks of one vehicle found, None without a report; warnings keep none from flying."""
    if checks is None:
        notice = no_report(SILENT_AFTER_S)
        return AnswerView(vehicle_id, AnswerKind.MISSING, notice.code, notice.text, None)
    failed = [check for check in checks if not check.passed]
    warned = [check for check in checks if check.passed and check.warnings]
    code = failed[0].codes[0] if failed else warned[0].warnings[0] if warned else ""
    text = "; ".join(f"{check.name}: {check.found}" for check in [*failed, *warned])
    return AnswerView(vehicle_id, verdict_of(checks), code, text or "all checks passed", None)


def _views(outcomes: Mapping[int, Outcome]) -> tuple[AnswerView, ...]:
    return tuple(_view(i, outcome) for i, outcome in sorted(outcomes.items()))


def _view(vehicle_id: int, outcome: Outcome) -> AnswerView:
    notice: Notice = outcome.notice
    after_ms = None if outcome.after_s is None else round(outcome.after_s * 1e3, 1)
    return AnswerView(vehicle_id, outcome.kind, notice.code, notice.text, after_ms)


def _one_line(error: Exception) -> str:
    return "; ".join(str(error).splitlines())


class Running:
    """A command to vehicles, from its request to its answers. One thread may end it while another one sends it."""

    def __init__(self, name: str, ids: frozenset[int]) -> None:
        self.name = name
        self.ids = ids
        self.is_checked = False  # at this time; where it has ended then, it sends nothing
        self.left = asyncio.Event()  # it sends nothing any more
        self.ended_by = ""

    def end(self, by: str) -> None:
        self.ended_by = self.ended_by or by


class EndedError(CompanionError):
    """Another command came while this one was being sent. str() says which."""


class UntilEnded:
    """A session of one command: after its end each call raises EndedError."""

    def __init__(self, session: FleetSession, running: Running) -> None:
        self._session = session
        self._running = running
        self._answers: dict[int, TimedReply | None] = {}

    @property
    def operator(self) -> str:
        return self._session.operator

    def outcomes(self) -> dict[int, Outcome]:
        """Of the vehicles that were asked: the last answer of each."""
        none = Outcome(AnswerKind.MISSING, Notice(Code.NO_REPLY, f"no reply before {self._running.ended_by}"))
        return {i: outcome_of(answer, WAIT_S) if answer else none for i, answer in self._answers.items()}

    def newest(self) -> dict[int, Status]:
        self._check()
        return self._session.newest()

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        self._check()
        answers = self._session.ask(vehicle_ids, name, timeout_s, content, lambda: bool(self._running.ended_by))
        self._answers |= answers
        self._check()
        return answers

    def check(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        self._check()
        return self._session.check(vehicle_ids, name, timeout_s, content)

    def _check(self) -> None:
        if by := self._running.ended_by:
            raise EndedError(f"ended by {by}; vehicles that had the command already may have begun")
