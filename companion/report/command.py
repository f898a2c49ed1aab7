"""`companion report`: reads a folder, judges the flight, writes the page."""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, tzinfo
from pathlib import Path

from companion.recording.reader import RecordingError
from companion.report.autopilot_logs import LogError, log_files, named_logs, read_logs
from companion.report.findings import Severity, rows_of
from companion.report.load import load
from companion.report.page import page_of, verdict
from companion.report.summary import judge
from companion.tools.output import complete_or_absent, json_text
from companion.types.errors import RefusedCommandError

EXIT_WRITTEN, EXIT_CRITICAL = 0, 1
FILE_NAME = "report.html"


class ReportError(RefusedCommandError):
    """Nothing was written. str() is one line."""


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """`logs` are those of autopilots outside of the folder."""

    folder: Path
    out: Path | None = None
    logs: tuple[Path, ...] = ()
    as_json: bool = False


class Steps:
    """Progress on standard error, with the time since the begin."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()

    def show(self, line: str) -> None:
        print(f"{time.monotonic() - self._began_s:5.1f} s  {line}", file=sys.stderr, flush=True)


def run_report(options: ReportOptions) -> int:
    """The exit code. Raises ReportError, before the recordings are read where an argument cannot be used."""
    steps = Steps()
    out = options.out or (options.folder if options.folder.is_dir() else options.folder.parent) / FILE_NAME
    if options.folder.exists():
        with _refusing_to_write(out):
            _check_writable(out)
    try:
        named = named_logs(options.logs)
        flight = load(options.folder, steps.show)
    except (LogError, RecordingError) as error:
        raise ReportError(str(error)) from error
    steps.show(f"{flight.ends_s:.0f} s of flight are read")
    files = log_files(options.folder, options.logs)
    logs = read_logs(files, flight, named)
    if named or files:
        steps.show(f"{len(logs.matched)} of {len(named) + len(files)} logs of autopilots are used")
    one = judge(flight, logs)
    steps.show("drawing the figures")
    html = page_of(one, _local_zone(flight.begin_unix_s))
    with _refusing_to_write(out), complete_or_absent(out) as file:
        file.write(html)
    if options.as_json:
        print(json_text(one.summary))
    steps.show(f"{verdict(rows_of(one.summary.findings))}: {out}")
    return EXIT_CRITICAL if one.summary.count(Severity.CRITICAL) else EXIT_WRITTEN


def _local_zone(unix_s: float) -> tzinfo:
    """That of this computer at the time of the flight."""
    zone = datetime.fromtimestamp(unix_s).astimezone().tzinfo
    assert zone is not None
    return zone


def _check_writable(out: Path) -> None:
    """Raises OSError."""
    if out.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    trial = out.with_name(f"{out.name}.part")
    trial.touch()
    trial.unlink()


@contextmanager
def _refusing_to_write(out: Path) -> Iterator[None]:
    """Raises ReportError in place of OSError."""
    try:
        yield
    except OSError as error:
        raise ReportError(f"{out}: cannot be written: {error.strerror}; choose another file with --out") from error
