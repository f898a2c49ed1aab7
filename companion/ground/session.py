"""The ground's side of Zenoh: hears every vehicle's status and gives commands. Nothing here needs an event loop."""

from __future__ import annotations

import getpass
import re
import socket
import time
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import zenoh

from companion.link.zenoh_session import drain, open_session
from companion.types import Command, CommandName, CommandReply, Content, Status
from companion.wire.ground import StatusReport, decode_reply, decode_report, encode
from companion.wire.keys import command_key, every_status, status_key
from companion.wire.version import WireError

REPORTS_KEPT = 4096  # a ring: when nobody drains, the oldest reports go first
POLL_S = 0.01
FRESH_S = 1.0  # a vehicle that said nothing for so long may have started anew


def operator_here() -> str:
    """user@host, as far as this machine tells."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # no such user, as in some containers
        user = "operator"
    return re.sub(r"[^A-Za-z0-9_.@+-]", "-", f"{user}@{socket.gethostname()}").lstrip("_.@+-")[:63]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a vehicle said to a command, and how long after it was given."""

    reply: CommandReply
    after_s: float


@dataclass(frozen=True, slots=True)
class _Asked:
    channel: Any
    payload: bytes
    since_s: float


class FleetSession:
    """A Zenoh session of the ground. Use it in a `with`, or call `close()`.

    Commands are `operator`'s. `rejected` counts reports and replies that were no message of ours, by reason.
    """

    def __init__(self, fleet: str, session: zenoh.Session, operator: str) -> None:
        self.fleet = fleet
        self.operator = operator
        self.rejected: Counter[str] = Counter()
        self._session = session
        self._reports = session.declare_subscriber(every_status(fleet), zenoh.handlers.RingChannel(REPORTS_KEPT))
        self._undrained: deque[StatusReport] = deque(maxlen=REPORTS_KEPT)
        self._newest: dict[int, tuple[float, Status]] = {}  # by vehicle, with when it came
        self._number = 0  # of the last command

    @classmethod
    def open(cls, fleet: str, connect: Sequence[str], operator: str = "") -> FleetSession:
        """Connect to the vehicles' endpoints, in the background and for ever. `fleet` may be * to only listen to all.

        `operator` is whose the commands are, of the form of wire.ground.OPERATOR; user@host where it is left out.

        Raises link.zenoh_session.EndpointError.
        """
        with ExitStack() as undo:
            session = open_session(listen=(), connect=connect)
            undo.callback(session.close)
            opened = cls(fleet, session, operator or operator_here())
            undo.pop_all()
        return opened

    def drain(self) -> list[StatusReport]:
        """All reports that came since the last call, oldest first. Never blocks."""
        self._listen()
        reports = list(self._undrained)
        self._undrained.clear()
        return reports

    def _listen(self) -> None:
        for sample in drain(self._reports, REPORTS_KEPT):
            try:
                report = decode_report(sample.payload.to_bytes())
            except WireError as error:
                self.rejected[str(error)] += 1
                continue
            if str(sample.key_expr) == status_key(report.status.fleet, report.status.vehicle_id):
                self._undrained.append(report)
                self._newest[report.status.vehicle_id] = (time.monotonic(), report.status)
            else:
                self.rejected["status of another vehicle than its key says"] += 1

    def newest(self) -> dict[int, Status]:
        """What each vehicle said last, of those that said something within FRESH_S. Never blocks."""
        self._listen()
        now_s = time.monotonic()
        return {i: status for i, (heard_s, status) in self._newest.items() if now_s - heard_s < FRESH_S}

    def hear(self, vehicle_ids: Iterable[int], timeout_s: float) -> dict[int, Status]:
        """What each of these vehicles says, as soon as all have said something; without those silent for `timeout_s`."""
        wanted, deadline_s = set(vehicle_ids), time.monotonic() + timeout_s
        while not wanted <= (heard := self.newest()).keys() and time.monotonic() < deadline_s:
            time.sleep(POLL_S)
        return {i: heard[i] for i in sorted(wanted & heard.keys())}

    def command(
        self,
        vehicle_ids: Iterable[int],
        name: CommandName,
        timeout_s: float = 2.0,
        content: Content | None = None,
    ) -> dict[int, CommandReply | None]:
        """As `ask`, without the times."""
        asked = self.ask(vehicle_ids, name, timeout_s, content)
        return {vehicle_id: answer.reply if answer else None for vehicle_id, answer in asked.items()}

    def ask(
        self,
        vehicle_ids: Iterable[int],
        name: CommandName,
        timeout_s: float = 2.0,
        content: Content | None = None,
    ) -> dict[int, Answer | None]:
        """Give one command to these vehicles at the same time and wait for their answers. `content` goes with some.

        Returns one entry per id; None where no answer came within `timeout_s`. Who is not heard yet is waited for until then,
        as a command is for one start of an agent; a command that a vehicle has got is never repeated.
        """
        deadline_s = time.monotonic() + timeout_s
        answers: dict[int, Answer | None] = dict.fromkeys(vehicle_ids)
        unheard, asked = set(answers), dict[int, _Asked]()
        while (unheard or asked) and (remaining_s := deadline_s - time.monotonic()) > 0:
            heard = self.newest()
            for vehicle_id in sorted(unheard & heard.keys()):
                payload = encode(self._command(heard[vehicle_id], name, content))
                asked[vehicle_id] = self._send(vehicle_id, payload, time.monotonic(), remaining_s)
            unheard -= heard.keys()
            for vehicle_id, query in list(asked.items()):
                try:
                    reply = query.channel.try_recv()
                except zenoh.ZError:  # ended without an answer: nobody was there to take it
                    asked[vehicle_id] = self._send(vehicle_id, query.payload, query.since_s, remaining_s)
                    continue
                if reply is not None:
                    if answer := self._answer(reply, vehicle_id):
                        answers[vehicle_id] = Answer(answer, time.monotonic() - query.since_s)
                    del asked[vehicle_id]
            time.sleep(min(POLL_S, remaining_s) if asked or unheard else 0.0)
        return answers

    def _command(self, status: Status, name: CommandName, content: Content | None) -> Command:
        """For the vehicle that says this. Its last number counts where another operator's clock is ahead of this one's."""
        milliseconds = time.time_ns() // 1_000_000
        self._number = max(milliseconds, self._number + 1, status.command_number + 1)
        return Command(name, self._number, self.operator, status.session, content)

    def _send(self, vehicle_id: int, payload: bytes, since_s: float, timeout_s: float) -> _Asked:
        channel = self._session.get(
            command_key(self.fleet, vehicle_id),
            zenoh.handlers.FifoChannel(4),
            payload=payload,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            timeout=timeout_s,
        )
        return _Asked(channel, payload, since_s)

    def _answer(self, reply: Any, vehicle_id: int) -> CommandReply | None:
        if reply.ok is None:  # the query's time is over
            return None
        try:
            answer = decode_reply(reply.ok.payload.to_bytes())
        except WireError as error:
            self.rejected[str(error)] += 1
            return None
        if answer.vehicle_id != vehicle_id:
            self.rejected["reply of another vehicle than was asked"] += 1
            return None
        return answer

    def close(self) -> None:
        """End the session; without this a process may hang at its exit."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
