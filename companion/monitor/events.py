"""What happened: a bounded ring of events, and the events between two reports of a vehicle."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Literal, NamedTuple

from companion.monitor.api import EventView
from companion.types.commands import Command, CommandReply
from companion.types.flight import Role
from companion.types.notices import Code
from companion.types.status import Status

EVENTS_KEPT = 2000

Kind = Literal["event", "phase", "leader", "formation", "command", "answer", "alarm"]
ENDED = "ended"  # outcome of an alarm


class Given(NamedTuple):
    """By whom a command was given, which one it is, and what an answer to it says; `outcome` also of an alarm that ended."""

    operator: str = ""
    command: str = ""
    outcome: str = ""

    def answered(self, outcome: str) -> Given:
        """Of an answer to this command."""
        return self._replace(outcome=outcome)


NOTHING_GIVEN = Given()


class Happening(NamedTuple):
    """Something that happened, as EventView has it."""

    time_s: float
    fleet: str
    vehicle_id: int | None
    kind: Kind
    code: str
    text: str
    given: Given = NOTHING_GIVEN


def event_view(number: int, happening: Happening) -> EventView:
    """As it is sent; `number` is its id."""
    operator, command, outcome = happening.given
    return EventView(
        id=number,
        time_s=happening.time_s,
        fleet=happening.fleet,
        vehicle_id=happening.vehicle_id,
        kind=happening.kind,
        code=happening.code,
        text=happening.text,
        operator=operator,
        command=command,
        outcome=outcome,
    )


class EventLog:
    """The last events, EVENTS_KEPT of them or `kept`. Their ids rise by one."""

    def __init__(self, kept: int = EVENTS_KEPT) -> None:
        self._kept: deque[EventView] = deque(maxlen=kept)
        self._last_id = 0

    def add(self, happening: Happening) -> None:
        self._last_id += 1
        self._kept.append(event_view(self._last_id, happening))

    def forget_from(self, time_s: float) -> None:
        """Without those at this time and later: a replay comes to them again."""
        self._kept = deque((event for event in self._kept if event.time_s < time_s), maxlen=self._kept.maxlen)

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
    outcome = "accepted" if reply.accepted else "refused"
    given = Given(reply.operator, _command_id(reply.operator, reply.vehicle_id, reply.number), outcome)
    return Happening(
        time_s, fleet, reply.vehicle_id, "answer", reply.code, f"{outcome} for {reply.operator}: {reply.reason}", given
    )


def describe_command(time_s: float, fleet: str, vehicle_id: int, command: Command) -> Happening:
    """A command as this vehicle received it."""
    given = Given(command.operator, _command_id(command.operator, vehicle_id, command.number))
    return Happening(time_s, fleet, vehicle_id, "command", command.name, f"{command.operator}: {command.name}", given)


def _command_id(operator: str, vehicle_id: int, number: int) -> str:
    """Each vehicle has numbers of its own."""
    return f"{operator}/{vehicle_id}/{number}"


def compare_reports(before: Status, after: Status) -> Iterator[tuple[Kind, str, str]]:
    """(kind, code, text) of what two reports of a vehicle, one after the other, show. Its agent reports its last event only."""
    event = after.last_event if after.last_event != before.last_event else None
    if after.agent.session != before.agent.session:
        yield "event", "AGENT_STARTED", "the agent started again"
    changes = dict(_changes(before, after))
    for code, (kind, text) in changes.items():
        yield kind, code, event.text if event is not None and event.code is code else text
    if event is not None and event.code not in changes:
        yield "event", event.code, event.text


def _changes(before: Status, after: Status) -> Iterator[tuple[Code, tuple[Kind, str]]]:
    """What the statuses themselves show: another event of the same tick may have come after it."""
    if after.phase is not before.phase:
        yield Code.PHASE_CHANGED, ("phase", f"{before.phase} -> {after.phase}")
    was, leads = before.leadership.role, after.leadership
    if leads.role is Role.LEADER and was is not Role.LEADER:
        yield Code.ROLE_CHANGED, ("leader", f"{was} -> {leads.role} in epoch {leads.epoch}")
    flown, now_flown = before.formation.slot.formation, after.formation.slot.formation
    if now_flown != flown:
        yield Code.FORMATION_CHANGED, ("formation", f"formation {flown} -> {now_flown}")
