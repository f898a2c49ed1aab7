"""Reads the recordings of a flight: one process for each vehicle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from companion.recording.alignment import Clock, align
from companion.recording.reader import Recording, RecordingError, recordings
from companion.recording.records import COMMAND, DECISION, EVENT, REPLY, STATUS, TIMING
from companion.report.assemble import StartRecords, fleet_of, vehicle_log
from companion.report.flight import RecordedFlight, VehicleLog

TOPICS = (DECISION, TIMING, STATUS, EVENT, COMMAND, REPLY)
Show = Callable[[str], None]


def load(folder: Path, show: Show) -> RecordedFlight:
    """The flight in a folder. `show` gets a line for each step. Raises RecordingError."""
    problems: list[str] = []
    chosen = _of_one_fleet(folder, recordings(folder, problems.append), problems)
    vehicles = sorted({recording.vehicle_id for recording in chosen})
    show(f"recordings of vehicle{'s' if len(vehicles) > 1 else ''} {', '.join(map(str, vehicles))}")
    clocks = align(chosen, _nothing)
    begin_s = min(clock.common_s(_first_s(recording)) for recording, clock in zip(chosen, clocks, strict=True))
    jobs: list[list[tuple[Recording, Clock]]] = []
    for vehicle_id in vehicles:
        own = [pair for pair in zip(chosen, clocks, strict=True) if pair[0].vehicle_id == vehicle_id]
        jobs.append(sorted(own, key=lambda pair: pair[1].common_s(_first_s(pair[0]))))
    aligned = [len(vehicles) == 1 or all(clock.is_aligned for _, clock in job) for job in jobs]
    with ProcessPoolExecutor(max_workers=len(jobs)) as pool:
        logs = list(pool.map(_read_vehicle, jobs, [begin_s] * len(jobs), [str(folder)] * len(jobs), aligned))
    header = chosen[0].header
    fleet, why_not = fleet_of(header)
    problems = [_without(line, str(folder)) for line in problems]
    return RecordedFlight(header.fleet, tuple(logs), begin_s, fleet, header.fleet_file, (*problems, *why_not))


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
    recordings_: Sequence[tuple[Recording, Clock]], begin_s: float, folder: str, aligned: bool
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
    for topic, now_s, value in recording.read(TOPICS, problems.append):
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
