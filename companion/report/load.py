"""Reads the recordings of a flight, one process for each vehicle, and makes columns of their records."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from companion.config.fleet import FleetConfig
from companion.config.validation import in_plain_words
from companion.recording.alignment import RecordingClock, align, of_one_flight
from companion.recording.reader import Recording, RecordingError, recordings
from companion.recording.records import (
    COMMAND,
    DECISION,
    EVENT,
    REPLY,
    STATUS,
    TIMING,
    DecisionRecord,
    Header,
    TimingRecord,
)
from companion.report.flight import (
    AgentStart,
    Bools,
    FlightEvent,
    FlightRecords,
    Floats,
    GivenCommand,
    NeighbourUse,
    Statuses,
    TickColumns,
    TickTiming,
    VehicleLog,
    Words,
)
from companion.types.commands import Command, CommandReply
from companion.types.flight import HealthFlag
from companion.types.notices import Notice
from companion.types.status import Status

TOPICS = (DECISION, TIMING, STATUS, EVENT, COMMAND, REPLY)
MOST = {DECISION: 720_000, TIMING: 720_000, STATUS: 100_000, EVENT: 10_000, COMMAND: 10_000, REPLY: 10_000}
"""Records of one start that are read: four hours of ticks, in some 2 GB of memory."""
LONGEST_S = 86_400.0
Show = Callable[[str], None]
T = TypeVar("T")


def load(folder: Path, show: Show) -> FlightRecords:
    """The flight in a folder. `show` gets a line for each step. Raises RecordingError."""
    problems: list[str] = []
    chosen = _of_one_fleet(folder, recordings(folder, problems.append), problems)
    pairs = of_one_flight(chosen, align(chosen, _nothing), problems.append)
    vehicles = sorted({recording.vehicle_id for recording, _ in pairs})
    show(f"recordings of vehicle{'s' if len(vehicles) > 1 else ''} {', '.join(map(str, vehicles))}")
    begin_s = min(clock.common_s(_first_s(recording)) for recording, clock in pairs)
    jobs: list[list[tuple[Recording, RecordingClock]]] = []
    for vehicle_id in vehicles:
        own = [pair for pair in pairs if pair[0].vehicle_id == vehicle_id]
        jobs.append(sorted(own, key=lambda pair: pair[1].common_s(_first_s(pair[0]))))
    aligned = [len(vehicles) == 1 or all(clock.is_aligned for _, clock in job) for job in jobs]
    with ProcessPoolExecutor(max_workers=min(len(jobs), os.cpu_count() or 1)) as pool:
        logs = list(pool.map(_read_vehicle, jobs, [begin_s] * len(jobs), [str(folder)] * len(jobs), aligned))
    header = pairs[0][0].header
    fleet, why_not = fleet_of(header)
    problems = [_without(line, str(folder)) for line in problems]
    flight = FlightRecords(header.fleet, tuple(logs), begin_s, fleet, (*problems, *why_not))
    _check_span(folder, flight)
    return flight


def _check_span(folder: Path, flight: FlightRecords) -> None:
    """Raises RecordingError: positions are compared every 20 ms from the first record to the last."""
    first_s = min(start.begins_s for vehicle in flight.vehicles for start in vehicle.starts)
    if not flight.ends_s - min(0.0, first_s) <= LONGEST_S:
        hours = f"{LONGEST_S / 3600.0:g} hours"
        raise RecordingError(f"{folder}: its records span more than {hours}; give the folder of one flight")


def _of_one_fleet(folder: Path, found: Sequence[Recording], problems: list[str]) -> list[Recording]:
    """The recordings of the fleet that has most of them; the others become a problem. Raises RecordingError."""
    of_vehicles = [recording for recording in found if recording.vehicle_id]
    if not of_vehicles:
        raise RecordingError(f"{folder}: only recordings of the ground, expected those of vehicles")
    counts = Counter(recording.header.fleet for recording in of_vehicles)
    fleet, _ = counts.most_common(1)[0]
    problems += [
        f"{counts[other]} recordings of the fleet {other} are left out; give each fleet its own folder"
        for other in sorted(set(counts) - {fleet})
    ]
    return [recording for recording in of_vehicles if recording.header.fleet == fleet]


def _first_s(recording: Recording) -> float:
    """Monotonic time of the first record; of the header where there is none."""
    first = next(iter(recording.read(TOPICS, _nothing)), None)
    return first.now_s if first else recording.header.monotonic_s


def _read_vehicle(
    recordings_: Sequence[tuple[Recording, RecordingClock]], begin_s: float, folder: str, aligned: bool
) -> VehicleLog:
    starts = [_read_start(recording, folder) for recording, _ in recordings_]
    to_flight = [lambda now_s, clock=clock: clock.common_s(now_s) - begin_s for _, clock in recordings_]
    return vehicle_log(starts, to_flight, aligned)


def _read_start(recording: Recording, folder: str) -> StartRecords:
    problems: list[str] = []
    read: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
    for topic, now_s, value in recording.read(TOPICS, problems.append):
        if len(read[topic]) == MOST[topic]:
            problems.append(f"after {MOST[topic]} records of {topic} the rest of the recording is left out")
            break
        read[topic].append((now_s, value))
    problems += recording.missing_parts
    return StartRecords(
        recording.header,
        decisions=[record for _, record in read[DECISION]],
        timings=[record for _, record in read[TIMING]],
        statuses=[(now_s, report.status) for now_s, report in read[STATUS]],
        events=read[EVENT],
        commands=read[COMMAND],
        replies=read[REPLY],
        files=tuple(_without(str(part.path), folder) for part in recording.parts),
        problems=tuple(_without(line, folder) for line in problems),
    )


def _without(line: str, folder: str) -> str:
    """A path as seen from the folder."""
    return line.replace(f"{folder.rstrip('/')}/", "")


def _nothing(_line: str) -> None:
    """Damage is reported when a recording is read as a whole."""


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
            f"the fleet file in the recording of vehicle {header.vehicle_id} cannot be used ({in_plain_words(error)}):"
            " distances are not judged",
        )


def vehicle_log(starts: Sequence[StartRecords], clocks: Sequence[ToFlight], aligned: bool = True) -> VehicleLog:
    """One vehicle from its starts in the order of time; `clocks` give the times of the flight for each."""
    both = list(zip(starts, clocks, strict=True))
    return VehicleLog(
        starts[0].header.vehicle_id,
        tuple(_start(start, at) for start, at in both),
        ticks_of(*_columns((at(one.now_s), one) for start, at in both for one in start.decisions)),
        timing_of(*_columns((at(one.now_s), one) for start, at in both for one in start.timings)),
        statuses_of(*_columns((at(time_s), status) for start, at in both for time_s, status in start.statuses)),
        tuple(FlightEvent(at(time_s), one.code, one.text) for start, at in both for time_s, one in start.events),
        tuple(command for start, at in both for command in pair_commands(start, at)),
        aligned,
    )


def _columns(timed: Iterable[tuple[float, T]]) -> tuple[list[float], list[T]]:
    """Times, and what is of them."""
    rows = list(timed)
    return [time_s for time_s, _ in rows], [one for _, one in rows]


def _start(start: StartRecords, at: ToFlight) -> AgentStart:
    begins_s, ends_s = start.span_s
    header = start.header
    return AgentStart(header.session, header.software, at(begins_s), at(ends_s), start.files, start.problems)


def pair_commands(start: StartRecords, at: ToFlight) -> list[GivenCommand]:
    """Each command once, however often its sender repeated it, with its first answer."""
    answers: dict[tuple[str, int], dict[str, Any]] = {}
    for time_s, reply in start.replies:
        answer = {"answered_s": at(time_s), "accepted": reply.accepted, "code": reply.code, "text": reply.reason}
        answers.setdefault((reply.operator, reply.number), answer)
    given: dict[tuple[str, int], GivenCommand] = {}
    for time_s, one in start.commands:
        key = (one.operator, one.number)
        if key not in given:
            given[key] = GivenCommand(at(time_s), one.name, one.number, one.operator, **answers.get(key, {}))
    return list(given.values())


# Columns of the decisions, by what their values are.
WORDS = ("phase", "role", "nearest")
NUMBERS = ("leader_id", "prc", "nearest_m", "required_m", "filter_changed_m_s2", "battery_percent")
VECTORS = (
    "position_enu_m",
    "velocity_enu_m_s",
    "slot_offset_enu_m",
    "reference_enu_m",
    "wind_acceleration_enu_m_s2",
)
NO_VECTOR = (np.nan, np.nan, np.nan)
LONGEST_WORD = 80  # each row has the room of the longest
LARGEST = 1e9  # a larger recorded value is damaged, whatever its unit


def ticks_of(time_s: Sequence[float], records: Sequence[DecisionRecord]) -> TickColumns:
    """The columns of decisions at these times (n,)."""
    columns: dict[str, Any] = {name: _words(records, name) for name in WORDS}
    columns |= {name: _numbers(records, name) for name in NUMBERS}
    columns |= {name: _vectors(records, name) for name in VECTORS}
    return TickColumns(
        time_s=np.array(time_s, dtype=np.float64), neighbours=_neighbours(records), flags=_flags(records), **columns
    )


def timing_of(time_s: Sequence[float], records: Sequence[TimingRecord]) -> TickTiming:
    """The columns of the timing of ticks, in milliseconds."""
    late_ms, to_command_ms = (_numbers(records, name) / 1e3 for name in ("late_us", "telemetry_to_command_us"))
    return TickTiming(np.array(time_s, dtype=np.float64), late_ms, to_command_ms)


def statuses_of(time_s: Sequence[float], records: Sequence[Status]) -> Statuses:
    """The columns of status reports."""
    errors = [record.motion.position_error for record in records]
    return Statuses(
        time_s=np.array(time_s, dtype=np.float64),
        armed=np.array([record.autopilot.armed for record in records], dtype=np.bool_),
        landed=np.array([int(record.autopilot.landed) for record in records], dtype=np.float64),
        mode=_words(records, "autopilot.mode_name"),
        error_horizontal_m=np.array([error.horizontal_m if error else np.nan for error in errors], dtype=np.float64),
        peers=tuple(frozenset(record.neighbourhood.peers) for record in records),
    )


def _numbers(records: Iterable[Any], name: str) -> Floats:
    get = attrgetter(name)
    return _possible(
        np.array([np.nan if (value := get(record)) is None else value for record in records], dtype=np.float64)
    )


def _vectors(records: Iterable[Any], name: str) -> Floats:
    get = attrgetter(name)
    return _possible(np.array([get(record) or NO_VECTOR for record in records], dtype=np.float64).reshape(-1, 3))


def _possible(values: Floats) -> Floats:
    """NaN in place of what no agent records: a figure would have no end."""
    return np.where(np.abs(values) <= LARGEST, values, np.nan)


def _words(records: Iterable[Any], name: str) -> Words:
    get = attrgetter(name)
    return np.array([get(record)[:LONGEST_WORD] for record in records], dtype=np.str_)


def _neighbours(records: Sequence[DecisionRecord]) -> Mapping[int, NeighbourUse]:
    """A weight or an age that is missing at the end of a record counts as not known."""
    columns: dict[int, NeighbourUse] = {}
    for row, record in enumerate(records):
        for place, other in enumerate(record.neighbours):
            use = columns.get(other)
            if use is None:
                use = columns[other] = NeighbourUse(_unknown(len(records)), _unknown(len(records)))
            use.weight[row] = record.weights[place] if place < len(record.weights) else np.nan
            use.age_s[row] = record.peer_ages_s[place] if place < len(record.peer_ages_s) else 0.0
    return dict(sorted(columns.items()))


def _flags(records: Sequence[DecisionRecord]) -> Mapping[str, Bools]:
    columns: dict[str, Bools] = {}
    known = set(HealthFlag)  # a column for each word of a damaged recording would fill the memory
    for row, record in enumerate(records):
        for flag in known.intersection(record.flags):
            if flag not in columns:
                columns[flag] = np.zeros(len(records), dtype=np.bool_)
            columns[flag][row] = True
    return columns


def _unknown(rows: int) -> Floats:
    return np.full(rows, np.nan)
