"""The files of flights on this computer, for download by vehicle. A request names one by the id that the list gave it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from hashlib import sha256
from itertools import islice
from pathlib import Path

from companion.monitor.api import LogFileView, LogsView
from companion.recording.files import GROUND, MCAP, NAME, TLOG

MOST_FILES = 2000
DOWNLOADED = re.compile(r"vehicle-(?P<id>\d{1,3})_[A-Za-z0-9_.-]{1,100}\.(ulg|bin)")  # by `companion logs`
KINDS = {f".{MCAP}": "recording", f".{TLOG}": "MAVLink"}


class GroundLogs:
    """Those in a folder and the folders inside it, or one file; None for none. Each call looks again: some still grow."""

    def __init__(self, where: Path | None = None) -> None:
        self._where = where

    def listed(self) -> LogsView:
        """The newest first. Blocks for as long as the disk takes."""
        files = sorted(self._found(), key=lambda found: found[1].written_s, reverse=True)
        return LogsView(self._where is not None, tuple(view for _, view in files))

    def path(self, log_id: str) -> Path | None:
        """Of a file of the list; None where there is none with this id."""
        return next((path for path, view in self._found() if view.id == log_id), None)

    def _found(self) -> Iterator[tuple[Path, LogFileView]]:
        if self._where is None:
            return
        top = self._where if self._where.is_dir() else self._where.parent
        paths = top.rglob("*") if self._where.is_dir() else (self._where,)
        named = ((path, who) for path in paths if (who := _vehicle_of(path.name)) is not None)
        for path, vehicle_id in islice(named, MOST_FILES):
            try:
                if not path.is_file() or not path.resolve().is_relative_to(top.resolve()):
                    continue
                state = path.stat()
            except OSError:  # removed meanwhile
                continue
            log_id = sha256(str(path.relative_to(top)).encode()).hexdigest()[:16]
            kind = KINDS.get(path.suffix, "autopilot")
            yield path, LogFileView(log_id, path.name, vehicle_id or None, kind, state.st_size, state.st_mtime)


def _vehicle_of(name: str) -> int | None:
    """The id in the name of such a file, 0 of the ground; None for any other file."""
    if found := NAME.fullmatch(name):
        source = found["source"]
        return 0 if source == GROUND else int(source.removeprefix("vehicle_"))
    found = DOWNLOADED.fullmatch(name)
    return int(found["id"]) if found else None
