"""The recordings of a flight as a source of the live page: statuses, commands and answers of all vehicles on one time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.monitor.picture.events import Happening, answered, commanded
from companion.monitor.sources import ReplaySource, TimedReport
from companion.recording.alignment import Clock, align
from companion.recording.configuration import recorded_fleet
from companion.recording.mcap_file import Warn
from companion.recording.reader import Recording, recordings
from companion.recording.records import COMMAND, GROUND_STATUS, REPLY, STATUS
from companion.types.printable import printable

MOST_REPORTS = 1_000_000  # ten vehicles for almost three hours


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """`fleets` has the fleet files of the recordings by name."""

    source: ReplaySource
    fleets: dict[str, FleetConfig]


class NoFlightError(Exception):
    """Recordings without anything to show. str() is one line."""


def recorded_flight(folder: Path, warn: Warn, clock_s: Callable[[], float] = time.monotonic) -> RecordedFlight:
    """`warn` gets a line for each file that is damaged. `clock_s` is the machine's clock, by which it is played.

    Raises recording.reader.RecordingError and NoFlightError.
    """
    found = recordings(folder, warn)
    of_vehicles = [one for one in found if one.vehicle_id]
    clocks = align(of_vehicles, warn)
    reports = _reports(of_vehicles, clocks, STATUS, warn)
    recorded_ids = {(one.header.fleet, one.vehicle_id) for one in of_vehicles}
    by_ground = [one for one in found if not one.vehicle_id]
    on_ground = _reports(by_ground, [_own_clock(one) for one in by_ground], GROUND_STATUS, warn)
    reports += [(t, r) for t, r in on_ground if (r.status.fleet, r.status.vehicle_id) not in recorded_ids]
    if not reports:
        raise NoFlightError(f"{printable(str(folder))}: its recordings have no status of any vehicle")
    if len(reports) > MOST_REPORTS:
        raise NoFlightError(
            f"{printable(str(folder))}: {len(reports)} statuses are more than are shown at once, {MOST_REPORTS};"
            " give the folder of one flight"
        )
    reports.sort(key=lambda report: report[0])
    happenings = sorted(_happenings(of_vehicles, clocks, warn), key=lambda happening: happening.time_s)
    return RecordedFlight(ReplaySource(reports, happenings, clock_s), _fleets(found, warn))


def _own_clock(recording: Recording) -> Clock:
    return Clock(recording.header.monotonic_s, recording.header.unix_s, 0.0)


def _reports(recorded: Sequence[Recording], clocks: Sequence[Clock], topic: str, warn: Warn) -> list[TimedReport]:
    return [
        (clock.common_s(message.now_s), message.value)
        for one, clock in zip(recorded, clocks, strict=True)
        for message in one.read([topic], warn)
    ]


def _happenings(recorded: Sequence[Recording], clocks: Sequence[Clock], warn: Warn) -> Iterator[Happening]:
    """Commands as the vehicles received them, and their answers; each once, however often its operator repeated it."""
    for one, clock in zip(recorded, clocks, strict=True):
        fleet, vehicle_id = one.header.fleet, one.vehicle_id
        seen: set[tuple[str, str, int]] = set()
        for message in one.read([COMMAND, REPLY], warn):
            time_s, value = clock.common_s(message.now_s), message.value
            key = (message.topic, value.operator, value.number)
            if key in seen:
                continue
            seen.add(key)
            if message.topic == COMMAND:
                yield commanded(time_s, fleet, vehicle_id, value)
            else:
                yield answered(time_s, fleet, value)


def _fleets(recorded: Sequence[Recording], warn: Warn) -> dict[str, FleetConfig]:
    """One file for each fleet, of the last recording of it. One that is damaged is left out."""
    fleets: dict[str, FleetConfig] = {}
    for one in recorded:
        if not one.header.fleet_file:
            continue
        try:
            fleets[one.header.fleet] = recorded_fleet(one.parts[0].path, one.header)
        except ConfigError as error:
            warn(error.lines[0])
    return fleets
