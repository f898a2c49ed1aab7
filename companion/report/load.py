"""Reads the recordings of a flight: one process for each vehicle."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from companion.recording.alignment import RecordingClock, align
from companion.recording.one_flight import of_one_flight
from companion.recording.reader import Recording, RecordingError, recordings
from companion.recording.records import COMMAND, DECISION, EVENT, REPLY, STATUS, TIMING
from companion.report.assemble import StartRecords, fleet_of, vehicle_log
from companion.report.flight import FlightRecords, VehicleLog

TOPICS = (DECISION, TIMING, STATUS, EVENT, COMMAND, REPLY)
MOST = {DECISION: 720_000, TIMING: 720_000, STATUS: 100_000, EVENT: 10_000, COMMAND: 10_000, REPLY: 10_000}
"""Records of one start that are read: four hours of ticks, in some 2 GB of memory."""
LONGEST_S = 86_400.0
Show = Callable[[str], None]


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
    flight = FlightRecords(header.fleet, tuple(logs), begin_s, fleet, header.fleet_file, (*problems, *why_not))
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
    files = tuple(_without(str(part.path), folder) for part in recording.parts)
    records = StartRecords(recording.header, files=files)
    timed: dict[str, list[tuple[float, Any]]] = {
        EVENT: records.events,
        COMMAND: records.commands,
        REPLY: records.replies,
    }
    counts: Counter[str] = Counter()
    for topic, now_s, value in recording.read(TOPICS, problems.append):
        counts[topic] += 1
        if counts[topic] > MOST[topic]:
            problems.append(f"after {MOST[topic]} records of {topic} the rest of the recording is left out")
            break
        if topic == DECISION:
            records.decisions.append(value)
        elif topic == TIMING:
            records.timings.append(value)
        elif topic == STATUS:
            records.statuses.append((now_s, value.status))
        else:
            timed[topic].append((now_s, value))
    problems += [f"part {number} of the recording is not here" for number in recording.missing_parts]
    return replace(records, problems=tuple(_without(line, folder) for line in problems))


def _without(line: str, folder: str) -> str:
    """A path as seen from the folder."""
    return line.replace(f"{folder.rstrip('/')}/", "")


def _nothing(_line: str) -> None:
    """Damage is reported when a recording is read as a whole."""
