"""What happened: a bounded ring of events, and the events between two reports of a vehicle."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Literal, NamedTuple

from companion.monitor.api import EventView
from companion.types.commands import Command, CommandReply
from companion.types.notices import Code
from companion.types.status import Status

EVENTS_KEPT = 2000

Kind = Literal["event", "phase", "command", "answer", "alarm"]


class Happening(NamedTuple):
    """Something that no status reports: a command, an answer."""

    time_s: float
    fleet: str
    vehicle_id: int | None
    kind: Kind
    code: str
    text: str


class EventLog:
    """The last EVENTS_KEPT events. Their ids rise by one."""

    def __init__(self) -> None:
        self._kept: deque[EventView] = deque(maxlen=EVENTS_KEPT)
        self._last_id = 0

    def add(self, time_s: float, fleet: str, vehicle_id: int | None, kind: Kind, code: str, text: str) -> None:
        self._last_id += 1
        self._kept.append(
            EventView(
                id=self._last_id, time_s=time_s, fleet=fleet, vehicle_id=vehicle_id, kind=kind, code=code, text=text
            )
        )

    def forget_from(self, time_s: float) -> None:
        """Without those at this time and later: a replay comes to them again."""
        self._kept = deque((event for event in self._kept if event.time_s < time_s), maxlen=EVENTS_KEPT)

    @property
    def last_id(self) -> int:
        return self._last_id

    def all(self) -> tuple[EventView, ...]:
        return tuple(self._kept)

    def after(self, event_id: int) -> tuple[EventView, ...]:
        """The events kept that are newer than this one."""
        if event_id >= self._last_id:
            return ()
        found: list[EventView] = []
        for event in reversed(self._kept):
            if event.id <= event_id:
                break
            found.append(event)
        return tuple(reversed(found))


def describe_reply(time_s: float, fleet: str, reply: CommandReply) -> Happening:
    """The reply of a vehicle."""
    text = f"{'accepted' if reply.accepted else 'refused'} for {reply.operator}: {reply.reason}"
    return Happening(time_s, fleet, reply.vehicle_id, "answer", reply.code, text)


def describe_command(time_s: float, fleet: str, vehicle_id: int | None, command: Command) -> Happening:
    return Happening(time_s, fleet, vehicle_id, "command", command.name, f"{command.operator}: {command.name}")


def compare_reports(before: Status, after: Status) -> Iterator[tuple[Kind, str, str]]:
    """(kind, code, text) of what two reports of a vehicle, one after the other, show. Its agent reports its last event only."""
    event = after.last_event if after.last_event != before.last_event else None
    if after.agent.session != before.agent.session:
        yield "event", "AGENT_STARTED", "the agent started again"
    if after.phase is not before.phase:
        reported = event is not None and event.code is Code.PHASE_CHANGED
        yield (
            "phase",
            Code.PHASE_CHANGED,
            event.text if event is not None and reported else f"{before.phase} -> {after.phase}",
        )
        if reported:
            return
    if event is not None:
        yield "event", event.code, event.text
