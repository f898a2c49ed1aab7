"""The folder of recordings: names of files, and how much of the disk they use.

A flight is one start of one agent, or of one program on the ground. Its files are `vehicle_3_0042_001.mcap`: the source, the
number of the flight, and the part. The number counts on from the flights in the folder, because a clock on board may be wrong.
"""

from __future__ import annotations

import re
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.config.vehicle import RecordingSettings

MCAP, TLOG = "mcap", "tlog"
GROUND = "ground"
MB = 1_000_000
NAME = re.compile(rf"(?P<source>{GROUND}|vehicle_\d{{1,3}})_(?P<flight>\d{{4,9}})_(?P<part>\d{{3,9}})\.({MCAP}|{TLOG})")
IN_USE_S = 60.0  # a file that was written so recently belongs to a flight that still goes on
STATE_FOLDER = "recordings"  # in the state folder of systemd


def recordings_folder(vehicle_file: Path, recording: RecordingSettings, environment: Mapping[str, str]) -> Path | None:
    """Where an agent records; None where it does not. Without a configured folder it is in the unit's state folder."""
    if not recording.enabled:
        return None
    if recording.folder is not None:
        return vehicle_file.parent / recording.folder
    state, _, _ = environment.get("STATE_DIRECTORY", "").partition(":")
    return Path(state) / STATE_FOLDER if state else None


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """One file of a flight. `written_s` is its last change by the clock of the file system."""

    path: Path
    source: str
    flight: int
    part: int
    bytes: int
    written_s: float


def recorded_files(folder: Path) -> list[RecordedFile]:
    """All files of recordings in a folder; other files are left out. Raises OSError."""
    files = []
    for path in folder.iterdir():
        if match := NAME.fullmatch(path.name):
            try:
                state = path.stat()
            except FileNotFoundError:  # removed by another agent
                continue
            source, flight, part = match["source"], int(match["flight"]), int(match["part"])
            files.append(RecordedFile(path, source, flight, part, state.st_size, state.st_mtime))
    return files


class FlightFiles:
    """The files of one flight that is recorded now, in a folder that may use `keep_bytes`."""

    def __init__(
        self, folder: Path, source: str, keep_bytes: int, system_time_s: Callable[[], float] = time.time
    ) -> None:
        """`source`: `ground`, or `vehicle_3`. Nothing is touched before the first file."""
        self._folder = folder
        self._source = source
        self._keep_bytes = keep_bytes
        self._system_time_s = system_time_s
        self._number: int | None = None

    def path(self, part: int, kind: str) -> Path:
        """Path of a part. Makes the folder where it is missing. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if self._number is None:
            before = [file.flight for file in recorded_files(self._folder) if file.source == self._source]
            self._number = 1 + max(before, default=0)
        return self._folder / f"{self._source}_{self._number:04d}_{part:03d}.{kind}"

    def make_room(self, more_bytes: int) -> None:
        """Remove the oldest whole flights until all files and `more_bytes` fit; then the oldest parts of this flight.

        Flights of others that are being written stay, and the newest part of this one. Raises OSError.
        """
        files = recorded_files(self._folder)
        excess = sum(file.bytes for file in files) + more_bytes - self._keep_bytes
        for group in self._oldest_first(files):
            if excess <= 0:
                return
            for file in group:
                file.path.unlink(missing_ok=True)
                excess -= file.bytes

    def _oldest_first(self, files: list[RecordedFile]) -> list[list[RecordedFile]]:
        """What may be removed: the flights that are over, oldest first, and after them each part of this one."""
        flights: dict[tuple[int, str], list[RecordedFile]] = defaultdict(list)
        for file in files:
            flights[file.flight, file.source].append(file)
        own = flights.pop((self._number or 0, self._source), [])
        now_s = self._system_time_s()
        over = [group for group in flights.values() if all(abs(now_s - file.written_s) > IN_USE_S for file in group)]
        over.sort(key=lambda group: (group[0].flight, max(file.written_s for file in group), group[0].source))
        newest = {file.path.suffix: file.part for file in sorted(own, key=lambda file: file.part)}
        older = [file for file in own if file.part < newest[file.path.suffix]]
        return over + [[file] for file in sorted(older, key=lambda file: file.part)]
