"""`companion logs`: lists and downloads the autopilot's flight logs over the agent's link."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Coroutine, Iterator, Sequence
from contextlib import aclosing, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig, load_agent
from companion.link.bench import LISTEN_PERIOD_S, Bench
from companion.link.flight_logs import FlightLogs, FlightLogsError, LogEntry, NothingCameError
from companion.mavlink.autopilot_types import DIALECTS
from companion.tools.output import json_text, line_printer
from companion.types.autopilot import AutopilotKind, HeartbeatSample, TextSample
from companion.types.errors import CompanionError

COMPLETE, INCOMPLETE = 0, 1  # exit codes
SILENT_AFTER_S = 5.0  # without a HEARTBEAT
LOOK_AGAIN_S, SETTLED_WITHIN_S = 1.0, 20.0  # for a log that is still written to
PLAIN_STEP_PERCENT = 10  # without a terminal, progress is printed at each such step
ARMED = "it is armed: land and disarm it first"
ALL, LAST = "all", "last"  # in place of an id


@dataclass(frozen=True, slots=True)
class LogsReport:
    """Result for one vehicle, as `--json` prints it.

    `logs` are those listed, or with --get those now in the folder. `failure` is the reason why some are missing.
    """

    vehicle: int
    autopilot: AutopilotKind
    mavlink: str
    logs: tuple[LogEntry, ...] = ()
    failure: str = ""


class NoSuchLogError(CompanionError):
    """A log that is not in the list. `str()` names it and the existing ones."""


def choose(logs: Sequence[LogEntry], wanted: Sequence[int | str], autopilot: AutopilotKind) -> tuple[LogEntry, ...]:
    """The wanted logs, each once, in the order of the list. Raises NoSuchLogError."""
    if ALL in wanted:
        return tuple(logs)
    ids = {newest(logs, autopilot).id if one == LAST else one for one in wanted}
    if missing := sorted(ids - {log.id for log in logs}):
        raise NoSuchLogError(f"no log {', '.join(map(str, missing))}; {_there(logs)}")
    return tuple(log for log in logs if log.id in ids)


def _there(logs: Sequence[LogEntry]) -> str:
    if len(logs) == 1:
        return f"there is only {logs[0].id}"
    runs: list[list[int]] = []
    for log in logs:
        if runs and runs[-1][-1] == log.id - 1:
            runs[-1].append(log.id)
        else:
            runs.append([log.id])
    return "there are " + ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)


def newest(logs: Sequence[LogEntry], autopilot: AutopilotKind) -> LogEntry:
    """The newest log with content: a number whose file is missing has size 0. Raises NoSuchLogError without any.

    ArduPilot numbers logs in order of time, independent of its clock; PX4 in order of its folders.
    """
    filled = [log for log in logs if log.size_bytes]
    if not filled:
        raise NoSuchLogError("all logs are empty")
    if DIALECTS[autopilot].LOGS.numbered_by_time:
        return filled[-1]
    return max(filled, key=lambda log: (log.date_utc.timestamp() if log.date_utc else 0.0, log.id))


def file_name(vehicle_id: int, log: LogEntry, autopilot: AutopilotKind) -> Path:
    """Name of a log's file. It contains the id, because the date may be unknown or the same for two logs."""
    date = f"_{log.date_utc:%Y-%m-%d_%H-%M-%S}" if log.date_utc else ""
    return Path(f"vehicle-{vehicle_id}{date}_log-{log.id}{DIALECTS[autopilot].LOGS.suffix}")


def heading(report: LogsReport) -> str:
    """The first line of the report."""
    return f"vehicle {report.vehicle}, {DIALECTS[report.autopilot].NAME} at {report.mavlink}"


def listing(logs: Sequence[LogEntry]) -> Iterator[str]:
    """The list, in columns."""
    yield f"{'log':>5}  {'last written (UTC)':<19}  {'size':>10}"
    for log in logs:
        date = f"{log.date_utc:%Y-%m-%d %H:%M:%S}" if log.date_utc else "unknown"
        yield f"{log.id:>5}  {date:<19}  {size_text(log.size_bytes):>10}"


def progress_text(log: LogEntry, written_bytes: int, taken_s: float) -> str:
    """Progress of a download: percent, size and rate."""
    percent = 100.0 * written_bytes / max(log.size_bytes, 1)
    rate = f", {size_text(round(written_bytes / taken_s))}/s" if taken_s > 0.0 else ""
    return f"log {log.id}: {percent:3.0f} % of {size_text(log.size_bytes)}{rate}"


def size_text(number_bytes: int) -> str:
    """A size in B, kB or MB."""
    if number_bytes < 1000:
        return f"{number_bytes} B"
    return f"{number_bytes / 1e3:.1f} kB" if number_bytes < 1e6 else f"{number_bytes / 1e6:.1f} MB"


@dataclass(frozen=True, slots=True)
class LogsOptions:
    """What to do with the logs of the vehicle in `file`. `wanted` holds ids, `all` and `last`; empty only lists."""

    file: Path
    wait_s: float
    wanted: tuple[int | str, ...]
    folder: Path
    as_json: bool


def run_logs(options: LogsOptions) -> int:
    """Run the command and return its exit code. Raises ConfigError and AutopilotSilentError."""
    config = load_agent(options.file)
    if options.wanted:
        _make(options.folder)
    return asyncio.run(_run(options, config))


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK | os.X_OK)
    except OSError as error:
        raise ConfigError(f"--out {folder}", "", f"{error.strerror}; name a folder that can be written to") from error
    if not writable:
        raise ConfigError(f"--out {folder}", "", "no permission to write there; name a folder that can be written to")


async def _run(options: LogsOptions, config: AgentConfig) -> int:
    with closing(LogSession(options.file, config)) as session:
        report = await session.run(options.wait_s, partial(_serve, session, options))
    if options.as_json:
        print(json_text(report))
    if report.failure:
        print(f"vehicle {report.vehicle}: {report.failure}", file=sys.stderr)
    return INCOMPLETE if report.failure else COMPLETE


async def _serve(session: LogSession, options: LogsOptions) -> LogsReport:
    """List the logs, or download the selected ones, and print the progress."""
    report = LogsReport(session.vehicle_id, session.autopilot, session.endpoint)
    show = line_printer(options.as_json)
    try:
        listed = await session.entries()
        if options.wanted:
            listed = await session.wait_until_settled(listed)
        chosen = choose(listed, options.wanted, session.autopilot)
        show([heading(report)])
        if not options.wanted:
            report = replace(report, logs=listed)
            show(listing(report.logs))
        for entry in chosen:
            log, text = await session.get(entry, options.folder)
            report = replace(report, logs=(*report.logs, log))
            show([text])
    except (FlightLogsError, NoSuchLogError) as error:
        return replace(report, failure=str(error))
    return report


class LogSession(Bench):
    """Link to one vehicle and its logs."""

    def __init__(self, file: Path, config: AgentConfig) -> None:
        """Opens the link. Raises ConfigError."""
        super().__init__(file, config)
        self.vehicle_id, self.endpoint = config.vehicle.id, config.vehicle.mavlink
        self.autopilot = AutopilotKind.PX4  # this and the following from HEARTBEAT, once `_known` is set
        self._armed = False
        self._heard_s = 0.0
        self._known = asyncio.Event()
        self._text = ""
        self._logs = FlightLogs(config.vehicle.id, self.link.relay)
        self.listeners.append(self._logs.receive)

    def jobs(self) -> tuple[Coroutine[None, None, None], ...]:
        """Background jobs until cancelled. Telemetry is not requested: it would slow the downloads."""
        return (self.link.receive(), self._listen())

    async def _listen(self) -> None:
        while True:
            for sample in self.link.drain():
                if isinstance(sample, HeartbeatSample):
                    self.autopilot, self._armed, self._heard_s = sample.autopilot, sample.armed, sample.received_s
                    self._known.set()
                elif isinstance(sample, TextSample):
                    self._text = sample.text
            await asyncio.sleep(LISTEN_PERIOD_S)

    async def connected(self, system: Any) -> None:  # noqa: ARG002 -- no plugin of mavsdk is needed
        """Waits until its type is known."""
        await self._known.wait()

    async def entries(self) -> tuple[LogEntry, ...]:
        """The list, with at least one log. Raises FlightLogsError."""
        if self._armed:
            raise FlightLogsError(ARMED)
        try:
            listed = await self._logs.entries()
        except NothingCameError as error:
            dialect = DIALECTS[self.autopilot]
            hint = f"; {dialect.NAME} does not answer where it has no logs" if dialect.LOGS.silent_without_logs else ""
            raise FlightLogsError(f"{error}{hint}{self._why()}") from error
        if not listed:
            raise FlightLogsError("it has no logs")
        return listed

    async def wait_until_settled(self, listed: tuple[LogEntry, ...]) -> tuple[LogEntry, ...]:
        """The list when its newest log no longer grows: ArduPilot ends that log when it is read, and begins another.

        Gives up after SETTLED_WITHIN_S, for autopilots that log all the time (LOG_DISARMED). Raises FlightLogsError.
        """
        give_up_s = time.monotonic() + SETTLED_WITHIN_S
        while DIALECTS[self.autopilot].LOGS.ends_when_read and time.monotonic() < give_up_s:
            await asyncio.sleep(LOOK_AGAIN_S)
            before, listed = listed, await self.entries()
            if [(log.id, log.size_bytes) for log in before] == [(log.id, log.size_bytes) for log in listed]:
                break
        return listed

    async def get(self, entry: LogEntry, folder: Path) -> tuple[LogEntry, str]:
        """Download a log: (the log with its file, a line for the report). Raises FlightLogsError."""
        file = folder / file_name(self.vehicle_id, entry, self.autopilot)
        log = replace(entry, file=str(file))
        try:
            if file.exists():
                _check_same(file, entry)
                return log, f"log {entry.id}: {file} exists already"
            await self._download(entry, file)
        except (FlightLogsError, OSError) as error:
            raise FlightLogsError(f"log {entry.id}: {error}") from error
        return log, f"log {entry.id}: {file}"

    async def _download(self, entry: LogEntry, file: Path) -> None:
        """Download to a temporary name, then rename. Raises FlightLogsError and OSError."""
        meter = Meter(entry)
        part = file.with_name(f"{file.name}.part")
        part.unlink(missing_ok=True)
        try:
            async with aclosing(self._logs.download(entry, part)) as sizes:
                async for written_bytes in sizes:
                    if self._armed:
                        raise FlightLogsError(ARMED)
                    meter.show(written_bytes)
            give_name(part, file, entry.size_bytes)
        except NothingCameError as error:
            raise FlightLogsError(f"{error}{self._why()}") from error
        finally:
            part.unlink(missing_ok=True)
            meter.clear()

    def _why(self) -> str:
        """The known reason why no data arrives."""
        if time.monotonic() - self._heard_s > SILENT_AFTER_S:
            return f"; no HEARTBEAT for {SILENT_AFTER_S:g} s"
        return f'; the autopilot reports "{self._text}"' if self._text else ""

    def close(self) -> None:
        self._logs.close()
        super().close()


def _check_same(file: Path, entry: LogEntry) -> None:
    """Raises FlightLogsError."""
    size_bytes = file.stat().st_size
    if size_bytes != entry.size_bytes:
        raise FlightLogsError(
            f"{file} exists already, with {size_bytes} bytes instead of {entry.size_bytes}: move it away, or choose"
            " another --out"
        )


def give_name(part: Path, file: Path, size_bytes: int) -> None:
    """Give a complete file its final name after syncing it to disk. Raises FlightLogsError and OSError."""
    with part.open("rb") as written:
        written_bytes = os.fstat(written.fileno()).st_size
        if written_bytes != size_bytes:
            raise FlightLogsError(f"{written_bytes} of {size_bytes} bytes were written; is the disk full?")
        os.fsync(written.fileno())
    part.rename(file)


class Meter:
    """Progress of a download on standard error: in place on a terminal, else one line per PLAIN_STEP_PERCENT."""

    def __init__(self, entry: LogEntry) -> None:
        self._entry = entry
        self._began_s = time.monotonic()
        self._in_place = sys.stderr.isatty()
        self._next_percent = float(PLAIN_STEP_PERCENT)

    def show(self, written_bytes: int) -> None:
        words = progress_text(self._entry, written_bytes, time.monotonic() - self._began_s)
        percent = 100.0 * written_bytes / max(self._entry.size_bytes, 1)
        if self._in_place:
            print(f"\r\x1b[K{words}", end="", file=sys.stderr, flush=True)
        elif percent >= self._next_percent:
            self._next_percent = percent - percent % PLAIN_STEP_PERCENT + PLAIN_STEP_PERCENT
            print(words, file=sys.stderr)

    def clear(self) -> None:
        if self._in_place:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
