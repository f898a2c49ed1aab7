"""The Zenoh session of the ground: receives the status of every vehicle and sends commands. Needs no event loop."""

from __future__ import annotations

import getpass
import re
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from math import inf
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

import zenoh

from companion.ground.answers import TimedReply
from companion.ground.fleet_state import SILENT_AFTER_S
from companion.link.fleet.zenoh_session import drain, each, open_session
from companion.types.commands import Command, CommandName, CommandReply, Content, next_number
from companion.types.notices import Code
from companion.types.status import Status
from companion.wire.keys import (
    ANY,
    abort_key,
    admission_key,
    check_key,
    command_key,
    reply_fleet_of,
    reply_key,
    status_key,
)
from companion.wire.messages import StatusReport, WireError, decode_reply, decode_report, encode

if TYPE_CHECKING:
    from companion.security.identity import Identity


class GroundConnection:
    """Connects to vehicles' endpoints, in the background, without end. Use it in a `with`, or call `close()`.

    Raises link.fleet.zenoh_session.EndpointError.
    """

    def __init__(self, connect: Sequence[str], identity: Identity | None = None) -> None:
        self.session = open_session(listen=(), connect=connect, identity=identity)

    def close(self) -> None:
        """End the session; without this a process may hang at its exit."""
        self.session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


REPORTS_KEPT = 4096  # a ring: without drain() the oldest reports are dropped
POLL_S = 0.01
REPLIES_KEPT = COMMANDS_KEPT = 1024
AGAIN_S = 0.25  # an unanswered command is sent again


def operator_here() -> str:
    """user@host of this machine; "operator" for an unknown user."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # no such user, as in some containers
        user = "operator"
    return re.sub(r"[^A-Za-z0-9_.@+-]", "-", f"{user}@{socket.gethostname()}").lstrip("_.@+-")[:63]


class Posted(NamedTuple):
    """What is sent to one vehicle until it answers, and under which key: a command, or the check of one."""

    key: str
    command: Command
    is_check: bool = False


Make = Callable[[int, Status | None], Posted | None]
"""(vehicle, its newest report) -> what it is asked; None while it cannot be yet."""


class FleetSession(GroundConnection):
    """Receives from one fleet and commands it. Threads may use it at the same time.

    `operator` sends the commands. `rejected` counts refused reports and replies by code.
    """

    def __init__(
        self, fleet: str, connect: Sequence[str], operator: str = "", identity: Identity | None = None
    ) -> None:
        """`fleet` may be * to receive from all fleets; with an identity that is its own fleet.

        `operator` has the form of types.commands.OPERATOR; user@host where it is empty. With an identity it is the common name
        of the certificate: agents accept no other.
        """
        if identity and fleet == "*":
            fleet = identity.fleet
        # A name that is no part of a key is refused here, before a session is open.
        status, reply = zenoh.KeyExpr(status_key(fleet, ANY)), zenoh.KeyExpr(reply_key(fleet, ANY))
        super().__init__(connect, identity)
        self.fleet = fleet
        self.operator = identity.common_name if identity else operator or operator_here()
        self.rejected: Counter[str] = Counter()
        self._reports = self.session.declare_subscriber(status, zenoh.handlers.RingChannel(REPORTS_KEPT))
        self._replies = self.session.declare_subscriber(reply, zenoh.handlers.RingChannel(REPLIES_KEPT))
        self._lock = threading.Lock()  # protects the fields below
        self._undrained: deque[StatusReport] = deque(maxlen=REPORTS_KEPT)
        self._undrained_replies: deque[tuple[str, CommandReply]] = deque(maxlen=REPLIES_KEPT)
        # Vehicle and number of the commands that wait for a reply, or had one; the order is that of sending.
        self._asked: dict[tuple[int, int], None] = {}
        self._undrained_commands: deque[Command] = deque(maxlen=COMMANDS_KEPT)
        self._mailboxes: list[deque[CommandReply]] = []  # one for each `ask` under way
        self._newest: dict[int, tuple[float, Status]] = {}  # by vehicle, with the time of arrival
        self._numbers: dict[int, int] = {}  # number of the last command to each vehicle
        self._last_check = 0

    def drain(self) -> list[StatusReport]:
        """All reports since the last call, oldest first. Never blocks."""
        with self._lock:
            self._listen()
            reports = list(self._undrained)
            self._undrained.clear()
        return reports

    def drain_other_replies(self) -> list[tuple[str, CommandReply]]:
        """Fleet and reply since the last call, oldest first, of those that `ask` does not return. Never blocks.

        They are for other operators, for other programs of this one, or too late.
        """
        with self._lock:
            self._listen_to_replies()
            replies = list(self._undrained_replies)
            self._undrained_replies.clear()
        return replies

    def drain_commands(self) -> list[Command]:
        """The commands sent since the last call, each once, oldest first."""
        with self._lock:
            commands = list(self._undrained_commands)
            self._undrained_commands.clear()
        return commands

    def _listen(self) -> None:
        each(drain(self._reports, REPORTS_KEPT), self._take_report, self._refuse)

    def _refuse(self) -> None:
        self.rejected[Code.REPORT_MALFORMED] += 1

    def _take_report(self, sample: zenoh.Sample) -> None:
        try:
            report = decode_report(sample.payload.to_bytes())
        except WireError as error:
            self.rejected[error.key] += 1
            return
        if str(sample.key_expr) == status_key(report.status.agent.fleet, report.status.agent.vehicle_id):
            self._undrained.append(report)
            self._newest[report.status.agent.vehicle_id] = (time.monotonic(), report.status)  # at most 250 ids
        else:
            self.rejected[Code.PEER_KEY_MISMATCH] += 1

    def newest(self) -> dict[int, Status]:
        """The newest status of each vehicle; without one that is silent: its agent may have restarted. Never blocks."""
        with self._lock:
            self._listen()
            now_s = time.monotonic()
            return {
                i: status for i, (received_s, status) in self._newest.items() if now_s - received_s < SILENT_AFTER_S
            }

    def command(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float = 2.0, content: Content | None = None
    ) -> dict[int, CommandReply | None]:
        """As `ask`, without the times of the replies."""
        asked = self.ask(vehicle_ids, name, timeout_s, content)
        return {vehicle_id: answer.reply if answer else None for vehicle_id, answer in asked.items()}

    def ask(
        self,
        vehicle_ids: Iterable[int],
        name: CommandName,
        timeout_s: float = 2.0,
        content: Content | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> dict[int, TimedReply | None]:
        """Sends one command to these vehicles at the same time and waits for their replies. Some commands have a `content`.

        Returns one entry per id; None where no reply came within `timeout_s`. A command waits for the report of its vehicle,
        because it is valid for one start of the agent only. ABORT waits for nothing. A command is sent again until it is
        answered, or `cancelled`; a vehicle executes it once.
        """

        def made(vehicle_id: int, report: Status | None) -> Posted | None:
            if name is CommandName.ABORT:
                command = Command(name, time.time_ns() // 1_000_000, self.operator, session=0)
                return Posted(abort_key(self.fleet, vehicle_id, self.operator), command)
            if report is None:
                return None
            return Posted(command_key(self.fleet, vehicle_id, self.operator), self._command(report, name, content))

        return self._ask_all(vehicle_ids, made, timeout_s, cancelled)

    def check(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        """As `ask`, for what these vehicles would answer to a command. They change nothing, and neither does this session."""

        def made(vehicle_id: int, report: Status | None) -> Posted | None:
            if report is None:
                return None
            check = Command(name, self._check_number(), self.operator, report.agent.session, content)
            return Posted(check_key(self.fleet, vehicle_id, self.operator), check, is_check=True)

        return self._ask_all(vehicle_ids, made, timeout_s, lambda: False)

    def _check_number(self) -> int:
        """For the reply alone: far above the number of any command, and of one program alone."""
        with self._lock:
            self._last_check = max(self._last_check + 1, time.time_ns() // 1_000_000)
            return self._last_check

    def _ask_all(
        self, vehicle_ids: Iterable[int], made: Make, timeout_s: float, cancelled: Callable[[], bool]
    ) -> dict[int, TimedReply | None]:
        mailbox: deque[CommandReply] = deque(maxlen=REPLIES_KEPT)
        with self._lock:
            self._listen_to_replies()  # those before this command are not for it
            self._mailboxes.append(mailbox)
        answers: dict[int, TimedReply | None] = dict.fromkeys(vehicle_ids)
        sent: dict[int, tuple[Posted, float, float]] = {}  # command, time of the first and of the last sending
        try:
            self._ask(answers, sent, made, timeout_s, cancelled, mailbox)
        finally:
            with self._lock:
                self._mailboxes = [other for other in self._mailboxes if other is not mailbox]
                for vehicle_id, (asked, _, _) in sent.items():
                    if answers[vehicle_id] is None:  # a reply that comes now is a late one
                        self._asked.pop((vehicle_id, asked.command.number), None)
        return answers

    def _ask(
        self,
        answers: dict[int, TimedReply | None],
        sent: dict[int, tuple[Posted, float, float]],
        made: Make,
        timeout_s: float,
        cancelled: Callable[[], bool],
        mailbox: deque[CommandReply],
    ) -> None:
        """Sends and waits; fills in `answers` and `sent`."""
        start_s = time.monotonic()
        while None in answers.values() and time.monotonic() - start_s < timeout_s and not cancelled():
            now_s, reports = time.monotonic(), self.newest()
            for vehicle_id in sorted(i for i, answer in answers.items() if answer is None):
                if cancelled():
                    break
                asked, first_s, last_s = sent.get(vehicle_id, (None, now_s, -inf))
                asked = asked or made(vehicle_id, reports.get(vehicle_id))
                if asked and now_s - last_s >= AGAIN_S:
                    if vehicle_id not in sent:
                        self._note(vehicle_id, asked)
                    self._send(asked)
                    sent[vehicle_id] = (asked, first_s, now_s)
            time.sleep(min(POLL_S, timeout_s))
            with self._lock:
                self._listen_to_replies()
            while mailbox:
                reply = mailbox.popleft()
                asked, first_s, _ = sent.get(reply.vehicle_id, (None, 0.0, 0.0))
                if asked and (reply.operator, reply.number) == (asked.command.operator, asked.command.number):
                    answers[reply.vehicle_id] = TimedReply(reply, time.monotonic() - first_s)

    def _note(self, vehicle_id: int, asked: Posted) -> None:
        """What is sent for the first time."""
        with self._lock:
            if not asked.is_check:
                self._undrained_commands.append(asked.command)
            self._asked[vehicle_id, asked.command.number] = None
            if len(self._asked) > REPLIES_KEPT:
                del self._asked[next(iter(self._asked))]

    def _command(self, status: Status, name: CommandName, content: Content | None) -> Command:
        """For the vehicle with this status, with a number of its own: a wrong one of a vehicle does not concern the others."""
        with self._lock:
            number = next_number(self._numbers.get(status.agent.vehicle_id, 0), status.command.command_number)
            self._numbers[status.agent.vehicle_id] = number
        return Command(name, number, self.operator, status.agent.session, content)

    def _send(self, asked: Posted) -> None:
        self.session.put(
            asked.key,
            encode(asked.command),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )

    def send_admission_list(self, data: bytes) -> None:
        """To all vehicles; they verify it."""
        self.session.put(
            admission_key(self.fleet, self.operator), data, congestion_control=zenoh.CongestionControl.DROP
        )

    def _listen_to_replies(self) -> None:
        each(drain(self._replies, REPLIES_KEPT), self._take_reply, self._refuse)

    def _take_reply(self, sample: zenoh.Sample) -> None:
        try:
            reply = decode_reply(sample.payload.to_bytes())
        except WireError as error:
            self.rejected[error.key] += 1
            return
        key = str(sample.key_expr)
        fleet = reply_fleet_of(key)
        if fleet is None or key != reply_key(fleet, reply.vehicle_id):
            self.rejected[Code.PEER_KEY_MISMATCH] += 1
            return
        is_other = reply.operator != self.operator or (reply.vehicle_id, reply.number) not in self._asked
        if is_other and reply.code is not Code.CHECK_PASSED:  # to a check of another program
            self._undrained_replies.append((fleet, reply))
        for mailbox in self._mailboxes:
            mailbox.append(reply)

    def linked(self) -> list[str]:
        """Remote endpoints that this session has a link to, like tcp/192.168.1.11:7447."""
        return [str(link.dst) for link in self.session.info.links()]
