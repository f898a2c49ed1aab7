"""Report of `companion logs`: the list, the choice of logs, file names and progress."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from companion.link.flight_logs import LogEntry
from companion.tools.doctor_report import AUTOPILOT_NAMES
from companion.types.autopilot import AutopilotKind

ALL, LAST = "all", "last"  # in place of an id
SUFFIXES = {AutopilotKind.PX4: ".ulg", AutopilotKind.ARDUPILOT: ".bin"}


@dataclass(frozen=True, slots=True)
class FlightLog:
    """One log; `file` is its copy after --get."""

    id: int
    date_utc: datetime | None
    size_bytes: int
    file: str = ""


@dataclass(frozen=True, slots=True)
class LogsReport:
    """Result for one vehicle, as `--json` prints it.

    `logs` are those listed, or with --get those now in the folder. `failure` is the reason why some are missing.
    """

    vehicle: int
    autopilot: AutopilotKind
    mavlink: str
    logs: tuple[FlightLog, ...] = ()
    failure: str = ""


class NoSuchLogError(Exception):
    """An id that is not in the list. `str()` names it and the existing ones."""


def choose(logs: Sequence[LogEntry], wanted: Sequence[int | str], autopilot: AutopilotKind) -> tuple[LogEntry, ...]:
    """The wanted logs, each once, in the order of the list. Raises NoSuchLogError."""
    if ALL in wanted:
        return tuple(logs)
    ids = {newest(logs, autopilot).id if one == LAST else one for one in wanted}
    if missing := sorted(ids - {log.id for log in logs}):
        raise NoSuchLogError(f"no log {', '.join(map(str, missing))}; {_there(logs)}")
    return tuple(log for log in logs if log.id in ids)


def _there(logs: Sequence[LogEntry]) -> str:
    return f"there are {logs[0].id} to {logs[-1].id}" if len(logs) > 1 else f"there is only {logs[0].id}"


def newest(logs: Sequence[LogEntry], autopilot: AutopilotKind) -> LogEntry:
    """The newest log. ArduPilot numbers logs in order of time, independent of its clock; PX4 in order of its folders."""
    if autopilot is AutopilotKind.ARDUPILOT:
        return logs[-1]
    return max(logs, key=lambda log: (log.date_utc.timestamp() if log.date_utc else 0.0, log.id))


def file_name(vehicle_id: int, log: LogEntry, autopilot: AutopilotKind) -> Path:
    """Name of a log's file. It contains the id, because the date may be unknown or the same for two logs."""
    date = f"_{log.date_utc:%Y-%m-%d_%H-%M-%S}" if log.date_utc else ""
    return Path(f"vehicle-{vehicle_id}{date}_log-{log.id}{SUFFIXES[autopilot]}")


def heading(report: LogsReport) -> str:
    """The first line of the report."""
    return f"vehicle {report.vehicle}, {AUTOPILOT_NAMES[report.autopilot]} at {report.mavlink}"


def listing(logs: Sequence[FlightLog]) -> Iterator[str]:
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
