"""Finds and reads the logs of autopilots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.report.autopilot.log import AutopilotLog, LogError
from companion.report.autopilot.match import MatchedLog, match
from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.flight import FlightRecords
from companion.types.notices import Code

ULOG, DATAFLASH = ".ulg", ".bin"
SUFFIXES = (ULOG, DATAFLASH)
MAX_LOG_BYTES = 2_000_000_000


@dataclass(frozen=True, slots=True)
class AutopilotLogs:
    """The logs that belong to the flight, and a finding for each that does not, or of the folder that cannot be read."""

    matched: tuple[MatchedLog, ...] = ()
    left_out: tuple[Finding, ...] = ()


NO_LOGS = AutopilotLogs()


def named_logs(paths: Sequence[Path]) -> tuple[AutopilotLog, ...]:
    """Those that the command line names, each once. Raises LogError, which names the file."""
    return tuple(_named_log(path) for path in {path.resolve(): path for path in paths}.values())


def _named_log(path: Path) -> AutopilotLog:
    try:
        return read_log(path)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error


def log_files(folder: Path, named: Sequence[Path]) -> tuple[Path, ...]:
    """Those in the folder that are not named."""
    known = {path.resolve() for path in named}
    inside = sorted(folder.rglob("*")) if folder.is_dir() else []
    return tuple(path for path in inside if path.suffix.lower() in SUFFIXES and path.resolve() not in known)


def read_logs(files: Sequence[Path], flight: FlightRecords, named: Sequence[AutopilotLog] = ()) -> AutopilotLogs:
    """All logs, and those of the command line, with their vehicles and times."""
    logs, left_out = [*named], []
    for path in files:
        try:
            logs.append(read_log(path))
        except LogError as error:
            left_out.append(_left_out(Code.LOG_UNREADABLE, f"{path.name}: {error}"))
    matched = []
    for log in logs:
        if found := match(log, flight):
            matched.append(found)
        else:
            text = f"{log.name}: no recorded vehicle moved as this log says; it is left out"
            left_out.append(_left_out(Code.LOG_NOT_ALIGNED, text))
    return AutopilotLogs(tuple(sorted(matched, key=lambda one: one.vehicle_id)), tuple(left_out))


def read_log(path: Path) -> AutopilotLog:
    """By its suffix. Raises LogError."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}") from error
    if not path.is_file() or size > MAX_LOG_BYTES:
        raise LogError(f"expected a file of at most {MAX_LOG_BYTES / 1e9:g} GB")
    if path.suffix.lower() == ULOG:
        from companion.report.autopilot.ulog import read_ulog

        return read_ulog(path)
    if path.suffix.lower() == DATAFLASH:
        from companion.report.autopilot.dataflash import read_dataflash

        return read_dataflash(path)
    raise LogError(f"expected a name that ends in {ULOG} (PX4) or {DATAFLASH} (ArduPilot)")


def _left_out(code: Code, text: str) -> Finding:
    return finding(FindingKind.AUTOPILOT, Severity.WARNING, code, None, 0.0, text)
