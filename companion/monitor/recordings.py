"""What the monitor replays and records: a recorded flight as a source of the page, and the recording of the ground."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from math import inf
from pathlib import Path

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.ground.session import FleetSession
from companion.monitor.events import Happening, describe_command, describe_reply
from companion.monitor.sources import ReplaySource, TimedReport
from companion.recording.alignment import APART_S, RecordingClock, align, of_one_flight
from companion.recording.codec import recorded_fleet
from companion.recording.mcap_file import Warn
from companion.recording.reader import Recording, recordings
from companion.recording.recorder import ground_recorder
from companion.recording.records import COMMAND, GROUND_COMMAND, GROUND_STATUS, REPLY, STATUS
from companion.recording.writing import WritingThread
from companion.types.errors import CompanionError
from companion.types.notices import Notice
from companion.types.values import printable

MOST_REPORTS = 300_000  # ten vehicles for 100 minutes, in 1.3 GB of memory
MOST_HAPPENINGS = 100_000


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """`fleets` has the fleet files of the recordings by name."""

    source: ReplaySource
    fleets: dict[str, FleetConfig]


class NoFlightError(CompanionError):
    """Recordings without anything to show. str() is one line."""


def read_flight(folder: Path, warn: Warn, clock_s: Callable[[], float] = time.monotonic) -> RecordedFlight:
    """`warn` gets a line once for each file that is damaged. `clock_s` is the machine's clock, by which it is played.

    Raises recording.reader.RecordingError and NoFlightError.
    """
    warn = _once(warn)
    found = recordings(folder, warn)
    by_vehicles = [one for one in found if one.vehicle_id]
    by_ground = [one for one in found if not one.vehicle_id]
    own_clocks = [_own_clock(one) for one in by_ground]
    pairs = of_one_flight(by_vehicles, align(by_vehicles, warn), warn) if by_vehicles else []
    on_ground = list(zip(by_ground, own_clocks, strict=True)) if pairs else of_one_flight(by_ground, own_clocks, warn)
    recorded_ids = {(one.header.fleet, one.vehicle_id) for one, _ in pairs}
    reports = list(islice(_reports(pairs, STATUS, warn), MOST_REPORTS + 1))
    first_s, last_s = _about([time_s for time_s, _ in reports])
    unrecorded = (
        (time_s, report)
        for time_s, report in _reports(on_ground, GROUND_STATUS, warn)
        if first_s <= time_s <= last_s
        and (report.status.agent.fleet, report.status.agent.vehicle_id) not in recorded_ids
    )
    reports += islice(unrecorded, MOST_REPORTS + 1)
    if not reports:
        raise NoFlightError(f"{printable(str(folder))}: its recordings have no status of any vehicle")
    if len(reports) > MOST_REPORTS:
        raise NoFlightError(
            f"{printable(str(folder))}: has more statuses than are shown at once, {MOST_REPORTS};"
            " give the folder of one flight"
        )
    reports.sort(key=lambda report: report[0])
    unreceived = _sent(on_ground, reports, recorded_ids, warn)
    happenings = sorted(
        islice(chain(_happenings(pairs, warn), unreceived), MOST_HAPPENINGS), key=lambda one: one.time_s
    )
    return RecordedFlight(ReplaySource(reports, happenings, clock_s), _fleets(found, warn))


def _once(warn: Warn) -> Warn:
    """Each line once: a file is read several times."""
    said: set[str] = set()

    def warn_once(line: str) -> None:
        if line not in said:
            said.add(line)
            warn(line)

    return warn_once


def _about(times_s: Sequence[float]) -> tuple[float, float]:
    """The time of a flight, with some before and after it, from those of its records; all time without any."""
    return (min(times_s) - APART_S, max(times_s) + APART_S) if times_s else (-inf, inf)


def _own_clock(recording: Recording) -> RecordingClock:
    return RecordingClock(recording.header.monotonic_s, recording.header.unix_s, 0.0)


def _reports(recorded: Sequence[tuple[Recording, RecordingClock]], topic: str, warn: Warn) -> Iterator[TimedReport]:
    for one, clock in recorded:
        for message in one.read([topic], warn):
            yield clock.common_s(message.now_s), message.value


def _happenings(recorded: Sequence[tuple[Recording, RecordingClock]], warn: Warn) -> Iterator[Happening]:
    """Commands as the vehicles received them, and their answers; each once, however often its operator repeated it.

    An answer without a command is to a check (`--check`, a preview), which is recorded as an answer alone.
    """
    for one, clock in recorded:
        fleet, vehicle_id = one.header.fleet, one.vehicle_id
        seen: set[tuple[str, str, int]] = set()
        for message in one.read([COMMAND, REPLY], warn):
            time_s, value = clock.common_s(message.now_s), message.value
            key = (message.topic, value.operator, value.number)
            if key in seen:
                continue
            seen.add(key)
            if message.topic == COMMAND:
                yield describe_command(time_s, fleet, vehicle_id, value)
            elif (COMMAND, value.operator, value.number) in seen:
                yield describe_reply(time_s, fleet, value)


def _sent(
    on_ground: Sequence[tuple[Recording, RecordingClock]],
    reports: Sequence[TimedReport],
    recorded_ids: Collection[tuple[str, int]],
    warn: Warn,
) -> Iterator[Happening]:
    """Commands as the ground sent them, each for one start of an agent, to vehicles without a recording of their own."""
    agents = {report.status.agent.session: report.status.agent for _, report in reports}
    for one, clock in on_ground:
        for message in one.read([GROUND_COMMAND], warn):
            agent = agents.get(message.value.session)
            if agent is not None and (agent.fleet, agent.vehicle_id) not in recorded_ids:
                yield describe_command(clock.common_s(message.now_s), agent.fleet, agent.vehicle_id, message.value)


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


STEP_S = 1.0


class GroundRecording:
    """A listener of the Station. The disk never delays it: a thread writes."""

    def __init__(
        self, folder: Path, session: FleetSession, fleet: FleetConfig | None, report: Callable[[Notice], None]
    ) -> None:
        """`report` gets what is to be known of the recording, like a full disk."""
        self._session = session
        self._report = report
        unix_s, monotonic_s = time.time(), time.monotonic()
        name = fleet.name if fleet else session.fleet
        self._recorder = ground_recorder(name, fleet, folder, unix_s, monotonic_s, WritingThread())
        self._stepped_s = -inf

    def listen(self, reports: Sequence[TimedReport], now_s: float) -> None:
        for arrived_s, report in reports:
            self._recorder.status(report, arrived_s)
        for command in self._session.drain_commands():
            self._recorder.command(command, now_s)
        if now_s - self._stepped_s >= STEP_S:
            self._stepped_s = now_s
            if notice := self._recorder.step(now_s):
                self._report(notice)

    def close(self) -> None:
        self._recorder.close()
