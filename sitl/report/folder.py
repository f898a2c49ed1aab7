"""Results folders: one per run, never shared by two runs, never emptied under a run that still writes into it.

Also the tables of figures that commands print.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from companion.config.law import BUILT_IN
from companion.types.errors import UnusableError

RUNS = Path("runs")
LAWS = BUILT_IN
OWN_FILES = re.compile(
    r"summary\.json|comparison\.(json|png)|figure_[56]\.png|from_above\.png|(scenario|fleet|vehicle_\d+|autopilot_\d+)\.yaml"
    r"|(truth|estimated)_\d+\.csv|(agent|autopilot)_\d+\.log|(vehicle_\d+|ground)_\d+_\d+\.(mcap|tlog)"
    r"|autopilots_\d+_to_\d+\.log|(true_positions|cameras|mocap|network)\.(yaml|log)"
)


class FolderInUseError(UnusableError):
    """Another run writes into the folder. str() is one line."""


def results_folder(out: Path | None, stem: str) -> Path:
    """`out`, or a new folder runs/STEM-DATE-TIME of this run alone. Raises OSError."""
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        return out
    RUNS.mkdir(exist_ok=True)
    name = f"{stem}-{datetime.now():%Y%m%d-%H%M%S}"
    path, number = RUNS / name, 1
    while True:
        try:
            path.mkdir()
            return path
        except FileExistsError:  # by a run that started in the same second
            number += 1
            path = RUNS / f"{name}-{number}"


@contextmanager
def open_folder(out: Path | None, stem: str) -> Iterator[Path]:
    """The results folder of a flight, reserved until the block ends; files of an older run in it are removed.

    Raises FolderInUseError, OSError.
    """
    folder = results_folder(out, stem)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # released by the system if this process is killed
        except BlockingIOError as error:
            raise FolderInUseError(
                f"{folder}: another run writes into it; wait for it or choose another folder with --out"
            ) from error
        remove_old_run(folder)
        yield folder
    finally:
        os.close(descriptor)


def remove_old_run(folder: Path) -> None:
    """Remove the files of an older run, also those of its laws' folders, so that none remains beside the new ones.

    A folder holds a run if it has the scenario as flown, and tracks or the agents' logs: a flight with external autopilots that
    failed has no tracks. Other files are kept. Raises OSError.
    """
    for place in (folder, *(folder / law for law in LAWS)):
        files = [file for file in place.iterdir() if OWN_FILES.fullmatch(file.name)] if place.is_dir() else []
        names = {file.name for file in files}
        was_flown = any(name.startswith(("truth_", "estimated_", "agent_")) for name in names)
        if "comparison.json" in names or ("scenario.yaml" in names and was_flown):
            for file in files:
                file.unlink()
            if place != folder and not any(place.iterdir()):
                place.rmdir()


Column = tuple[str, str, int]  # two lines of the head, and the width: negative for left alignment


def table_text(columns: Sequence[Column], rows: Iterable[Sequence[str]]) -> str:
    """The head and one line per row. A row has one cell per column."""
    above, below = [first for first, _, _ in columns], [second for _, second, _ in columns]
    return "\n".join(_line(columns, cells) for cells in (above, below, *rows))


def _line(columns: Sequence[Column], cells: Sequence[str]) -> str:
    return "".join(
        f"{cell:<{-width}}" if width < 0 else f"{cell:>{width}}"
        for cell, (_, _, width) in zip(cells, columns, strict=True)
    ).rstrip()
