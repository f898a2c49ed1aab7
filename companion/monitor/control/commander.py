"""Sends the commands of the live page: one at a time, in a thread; ABORT at once, beside any other."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, Protocol

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.ground.answers import AnswerKind, Outcome
from companion.ground.preconditions import divided
from companion.ground.readiness import checks_of, leader_check
from companion.ground.reports import no_report
from companion.ground.requests import FleetRequest
from companion.ground.sending import OperateError, Sender, check_content
from companion.ground.session import POLL_S, Answer, FleetSession
from companion.ground.text import id_list
from companion.monitor.api import AnswerView, CommandRequest, CommandResult, Preview
from companion.monitor.control.requests import ABORT, DOCTOR, RequestError, fleet_request
from companion.types.commands import CommandName, Content
from companion.types.notices import Code, Notice
from companion.types.status import Status

ABORTS_AT_ONCE = 4
READY, NOT_READY = "ready", "not ready"


class Log(Protocol):
    """Station.log."""

    def __call__(
        self, fleet: str, vehicle_id: int | None, kind: Literal["command", "answer"], code: str, text: str
    ) -> None: ...


class AbortedError(Exception):
    """An ABORT came while another command was being sent."""


class Commander:
    """Commands one fleet. `send` and `preview` belong to one event loop."""

    def __init__(self, session: FleetSession, fleet: FleetConfig, log: Log) -> None:
        self._session = session
        self._fleet = fleet
        self._log = log
        self._under_way = ""  # the command that is being sent
        self._aborts = threading.Event()  # since that command began
        self._threads = ThreadPoolExecutor(max_workers=1, thread_name_prefix="command")
        self._abort_threads = ThreadPoolExecutor(max_workers=ABORTS_AT_ONCE, thread_name_prefix="abort")
        self._preview_threads = ThreadPoolExecutor(max_workers=1, thread_name_prefix="preview")

    async def send(self, request: CommandRequest) -> CommandResult:
        """Waits for the answers, not for the end of the action. Refused while another command is being sent; ABORT never is."""
        try:
            wanted = fleet_request(request, self._fleet)
            check_content(wanted, self._fleet)
        except (RequestError, ConfigError, OperateError) as error:
            return CommandResult(request.name, (), error=_one_line(error))
        ids = sorted(set(wanted.only)) or [member.id for member in self._fleet.vehicles]
        if request.name == ABORT:
            return await self._abort(wanted, ids)
        if request.name == DOCTOR:
            return await self._in_thread(self._preview_threads, lambda: self._doctor(ids), request.name)
        if self._under_way:
            return CommandResult(request.name, (), error=f"{self._under_way} is being sent; wait for its answers")
        self._under_way = request.name
        self._aborts.clear()
        try:
            self._log_command(request.name, ids, wanted)
            return self._logged(await self._in_thread(self._threads, lambda: self._sent(wanted, ids), request.name))
        finally:
            self._under_way = ""

    async def _abort(self, wanted: FleetRequest, ids: list[int]) -> CommandResult:
        """In threads of its own. A command that is being sent is not repeated any more, and sends nothing further."""
        self._aborts.set()
        self._log_command(ABORT, ids, wanted)
        result = await self._in_thread(self._abort_threads, lambda: self._sent_abort(wanted, ids), ABORT)
        return self._logged(result)

    async def preview(self, request: CommandRequest) -> Preview:
        """What `formation` or `reference` would do. Nothing is sent."""
        try:
            wanted = fleet_request(request, self._fleet)
            check_content(wanted, self._fleet)
            if not (wanted.formation or wanted.reference):
                raise RequestError("name: expected formation or reference; other commands have no preview")
            from companion.monitor.control.preview import preview_of  # it takes a moment, for scipy

            statuses = self._session.newest()
            loop = asyncio.get_running_loop()
            return await loop.run_in_executor(self._preview_threads, lambda: preview_of(wanted, self._fleet, statuses))
        except (RequestError, ConfigError, OperateError) as error:
            return Preview(refused=_one_line(error))

    async def _in_thread(
        self, threads: ThreadPoolExecutor, work: Callable[[], CommandResult], name: str
    ) -> CommandResult:
        try:
            return await asyncio.get_running_loop().run_in_executor(threads, work)
        except (ConfigError, OperateError) as error:
            return CommandResult(name, (), error=_one_line(error))
        except AbortedError:
            return CommandResult(name, (), error="ended by abort; vehicles that had the command already may have begun")

    def _sent(self, wanted: FleetRequest, ids: list[int]) -> CommandResult:
        session = _UntilAborted(self._session, self._aborts.is_set)
        sent = Sender(session, self._fleet, wanted, ids).send(wanted)
        advice = divided(sent.name, sent.outcomes)
        return CommandResult(wanted.action, _views(sent.outcomes), str(advice) if advice else "")

    def _sent_abort(self, wanted: FleetRequest, ids: list[int]) -> CommandResult:
        sent = Sender(self._session, self._fleet, wanted, ids).send(wanted)
        return CommandResult(ABORT, _views(sent.outcomes))

    def _doctor(self, ids: list[int]) -> CommandResult:
        """The checks before flight; no command is sent."""
        statuses, every = self._session.newest(), [member.id for member in self._fleet.vehicles]
        own_hash, leader = self._fleet.formation_hash(), leader_check(statuses, every)
        answers = []
        for i in ids:
            if (status := statuses.get(i)) is None:
                notice = no_report(1.0)
                answers.append(AnswerView(i, AnswerKind.MISSING, notice.code, notice.text, None))
                continue
            failed = [check for check in (*checks_of(status, every, own_hash), leader) if not check.passed]
            text = "; ".join(f"{check.name}: {check.found}" for check in failed)
            code = failed[0].codes[0] if failed else ""
            answers.append(AnswerView(i, NOT_READY if failed else READY, code, text or "all checks passed", None))
        return CommandResult(DOCTOR, tuple(answers))

    def _log_command(self, name: str, ids: list[int], wanted: FleetRequest) -> None:
        details = f" {', '.join(map(str, wanted.leaders))}" if wanted.leaders else ""
        if wanted.formation and wanted.formation.shape:
            details = f" {wanted.formation.shape}, {wanted.formation.spacing_m:g} m"
        text = f"{self._session.operator}: {name}{details} to {id_list(ids)}"
        self._log(self._fleet.name, None, "command", name, text)

    def _logged(self, result: CommandResult) -> CommandResult:
        if result.error:
            self._log(self._fleet.name, None, "answer", Code.NOT_SENT, f"{result.name}: {result.error}")
        for answer in result.answers:
            text = f"{result.name} {answer.kind}: {answer.text}"
            self._log(self._fleet.name, answer.vehicle_id, "answer", answer.code, text)
        return result

    def close(self) -> None:
        """What is being sent ends at its next step."""
        self._aborts.set()
        for threads in (self._threads, self._abort_threads, self._preview_threads):
            threads.shutdown(wait=False, cancel_futures=True)


class _UntilAborted:
    """A session for a Sender whose commands end with an ABORT: after it each call raises AbortedError."""

    def __init__(self, session: FleetSession, aborted: Callable[[], bool]) -> None:
        self._session = session
        self._aborted = aborted

    @property
    def operator(self) -> str:
        return self._session.operator

    def newest(self) -> dict[int, Status]:
        self._check()
        return self._session.newest()

    def statuses(self, vehicle_ids: Iterable[int], timeout_s: float) -> dict[int, Status]:
        wanted, deadline_s = set(vehicle_ids), time.monotonic() + timeout_s
        while not wanted <= (reports := self.newest()).keys() and time.monotonic() < deadline_s:
            time.sleep(POLL_S)
        return {i: reports[i] for i in sorted(wanted & reports.keys())}

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None
    ) -> dict[int, Answer | None]:
        self._check()
        answers = self._session.ask(vehicle_ids, name, timeout_s, content, self._aborted)
        self._check()
        return answers

    def _check(self) -> None:
        if self._aborted():
            raise AbortedError


def _views(outcomes: Mapping[int, Outcome]) -> tuple[AnswerView, ...]:
    return tuple(_view(i, outcome) for i, outcome in sorted(outcomes.items()))


def _view(vehicle_id: int, outcome: Outcome) -> AnswerView:
    notice: Notice = outcome.notice
    after_ms = None if outcome.after_s is None else round(outcome.after_s * 1e3, 1)
    return AnswerView(vehicle_id, outcome.kind, notice.code, notice.text, after_ms)


def _one_line(error: Exception) -> str:
    return "; ".join(str(error).splitlines())
