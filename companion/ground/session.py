"""The ground's side of Zenoh: hears every vehicle's status and gives commands. Nothing here needs an event loop."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import zenoh

from companion.link.zenoh_session import drain, open_session
from companion.types import Command, CommandName, CommandReply, Content
from companion.wire.ground import StatusReport, decode_reply, decode_report, encode
from companion.wire.keys import command_key, every_status, status_key
from companion.wire.version import WireError

REPORTS_KEPT = 4096  # a ring: when nobody drains, the oldest reports go first
POLL_S = 0.01


class FleetSession:
    """A Zenoh session of the ground. Use it in a `with`, or call `close()`.

    `rejected` counts reports and replies that were no message of ours, by reason.
    """

    def __init__(self, fleet: str, session: zenoh.Session) -> None:
        self.fleet = fleet
        self.rejected: Counter[str] = Counter()
        self._session = session
        self._reports = session.declare_subscriber(every_status(fleet), zenoh.handlers.RingChannel(REPORTS_KEPT))
        self._commands_given = 0

    @classmethod
    def open(cls, fleet: str, connect: Sequence[str]) -> FleetSession:
        """Connect to the vehicles' endpoints, in the background and for ever. `fleet` may be * to only listen to all.

        Raises link.zenoh_session.EndpointError.
        """
        with ExitStack() as undo:
            session = open_session(listen=(), connect=connect)
            undo.callback(session.close)
            opened = cls(fleet, session)
            undo.pop_all()
        return opened

    def drain(self) -> list[StatusReport]:
        """All reports that came since the last call, oldest first. Never blocks."""
        reports = []
        for sample in drain(self._reports, REPORTS_KEPT):
            try:
                report = decode_report(sample.payload.to_bytes())
            except WireError as error:
                self.rejected[str(error)] += 1
                continue
            if str(sample.key_expr) == status_key(report.status.fleet, report.status.vehicle_id):
                reports.append(report)
            else:
                self.rejected["status of another vehicle than its key says"] += 1
        return reports

    def command(
        self,
        vehicle_ids: Iterable[int],
        name: CommandName,
        timeout_s: float = 2.0,
        content: Content | None = None,
    ) -> dict[int, CommandReply | None]:
        """Give one command to these vehicles at the same time and wait for their answers. `content` goes with some.

        Returns one entry per id; None where no answer came within `timeout_s`. A vehicle that cannot be reached yet is
        asked again until then; a command that a vehicle has got is never repeated.
        """
        self._commands_given += 1
        payload = encode(Command(name, self._commands_given, content))
        deadline_s = time.monotonic() + timeout_s
        answers: dict[int, CommandReply | None] = dict.fromkeys(vehicle_ids)
        asked = {vehicle_id: self._ask(vehicle_id, payload, timeout_s) for vehicle_id in answers}
        while asked and (remaining_s := deadline_s - time.monotonic()) > 0:
            for vehicle_id, channel in list(asked.items()):
                try:
                    reply = channel.try_recv()
                except zenoh.ZError:  # ended without an answer: nobody was there to take it
                    asked[vehicle_id] = self._ask(vehicle_id, payload, remaining_s)
                    continue
                if reply is not None:
                    answers[vehicle_id] = self._answer(reply, vehicle_id)
                    del asked[vehicle_id]
            time.sleep(min(POLL_S, remaining_s) if asked else 0.0)
        return answers

    def _ask(self, vehicle_id: int, payload: bytes, timeout_s: float) -> Any:
        return self._session.get(
            command_key(self.fleet, vehicle_id),
            zenoh.handlers.FifoChannel(4),
            payload=payload,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            timeout=timeout_s,
        )

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
