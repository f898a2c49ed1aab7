"""A session for commands that another command may end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable

from companion.ground.answers import Answer, AnswerKind, Outcome, outcome_of
from companion.ground.session import POLL_S, FleetSession
from companion.monitor.control.requests import WAIT_S
from companion.types.commands import CommandName, Content
from companion.types.notices import Code, Notice
from companion.types.status import Status


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


class EndedError(Exception):
    """Another command came while this one was being sent. str() says which."""


class UntilEnded:
    """A session for a Sender: after the command has ended each call raises EndedError."""

    def __init__(self, session: FleetSession, running: Running) -> None:
        self._session = session
        self._running = running
        self._answers: dict[int, Answer | None] = {}

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

    def statuses(self, vehicle_ids: Iterable[int], timeout_s: float) -> dict[int, Status]:
        wanted, deadline_s = set(vehicle_ids), time.monotonic() + timeout_s
        while not wanted <= (reports := self.newest()).keys() and time.monotonic() < deadline_s:
            time.sleep(POLL_S)
        return {i: reports[i] for i in sorted(wanted & reports.keys())}

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None
    ) -> dict[int, Answer | None]:
        self._check()
        answers = self._session.ask(vehicle_ids, name, timeout_s, content, lambda: bool(self._running.ended_by))
        self._answers |= answers
        self._check()
        return answers

    def _check(self) -> None:
        if by := self._running.ended_by:
            raise EndedError(f"ended by {by}; vehicles that had the command already may have begun")
