"""The records of all starts of one vehicle to its columns on the time axis of the flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import msgspec

from companion.config.fleet import FleetConfig
from companion.recording.records import DecisionRecord, Header, TimingRecord
from companion.report.columns import statuses_of, ticks_of, timing_of
from companion.report.flight import AgentStart, FlightEvent, GivenCommand, VehicleLog
from companion.types.commands import Command, CommandReply
from companion.types.notices import Notice
from companion.types.status import Status

ToFlight = Callable[[float], float]
"""The time of the flight at a time of a monotonic clock."""


@dataclass(frozen=True, slots=True)
class StartRecords:
    """What one start of an agent recorded, with times of its monotonic clock. Lists are in the order of time."""

    header: Header
    decisions: list[DecisionRecord] = field(default_factory=list)
    timings: list[TimingRecord] = field(default_factory=list)
    statuses: list[tuple[float, Status]] = field(default_factory=list)
    events: list[tuple[float, Notice]] = field(default_factory=list)
    commands: list[tuple[float, Command]] = field(default_factory=list)
    replies: list[tuple[float, CommandReply]] = field(default_factory=list)
    files: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last record; the time of the header where there is none."""
        times_s = [record.now_s for record in (*self.decisions[:1], *self.decisions[-1:])]
        for timed in (self.statuses, self.events, self.commands):
            times_s += [row[0] for row in (*timed[:1], *timed[-1:])]
        return (min(times_s), max(times_s)) if times_s else (self.header.monotonic_s, self.header.monotonic_s)


def fleet_of(header: Header) -> tuple[FleetConfig | None, tuple[str, ...]]:
    """The fleet file of a recording, or why it cannot be used."""
    try:
        return msgspec.json.decode(header.fleet_file, type=FleetConfig), ()
    except msgspec.MsgspecError as error:
        return None, (
            f"the fleet file in the recording of vehicle {header.vehicle_id} cannot be used ({error}): distances are"
            " not judged",
        )


def vehicle_log(starts: Sequence[StartRecords], clocks: Sequence[ToFlight], aligned: bool = True) -> VehicleLog:
    """One vehicle from its starts in the order of time; `clocks` give the times of the flight for each."""
    both = list(zip(starts, clocks, strict=True))
    decisions = [(at(record.now_s), record) for start, at in both for record in start.decisions]
    timings = [(at(record.now_s), record) for start, at in both for record in start.timings]
    statuses = [(at(time_s), status) for start, at in both for time_s, status in start.statuses]
    return VehicleLog(
        starts[0].header.vehicle_id,
        tuple(_start(start, at) for start, at in both),
        ticks_of([time_s for time_s, _ in decisions], [record for _, record in decisions]),
        timing_of([time_s for time_s, _ in timings], [record for _, record in timings]),
        statuses_of([time_s for time_s, _ in statuses], [status for _, status in statuses]),
        tuple(FlightEvent(at(time_s), one.code, one.text) for start, at in both for time_s, one in start.events),
        tuple(command for start, at in both for command in given_commands(start, at)),
        aligned,
    )


def _start(start: StartRecords, at: ToFlight) -> AgentStart:
    begins_s, ends_s = start.span_s
    header = start.header
    return AgentStart(header.session, header.software, at(begins_s), at(ends_s), start.files, start.problems)


def given_commands(start: StartRecords, at: ToFlight) -> list[GivenCommand]:
    """Each command once, however often its sender repeated it, with its first answer."""
    answers: dict[tuple[str, int], tuple[float, CommandReply]] = {}
    for time_s, reply in start.replies:
        answers.setdefault((reply.operator, reply.number), (time_s, reply))
    given: dict[tuple[str, int], GivenCommand] = {}
    for time_s, command in start.commands:
        key = (command.operator, command.number)
        if key in given:
            continue
        given[key] = GivenCommand(at(time_s), command.name, command.number, command.operator)
        if answer := answers.get(key):
            answered_s, reply = answer
            given[key] = replace(
                given[key],
                answered_s=at(answered_s),
                accepted=reply.accepted,
                code=reply.code,
                text=reply.reason,
            )
    return list(given.values())
