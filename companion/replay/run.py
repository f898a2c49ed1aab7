"""`companion replay`: the recordings of a folder, one after the other."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import msgspec

from companion.config.file import ConfigError
from companion.recording.reader import Recording, RecordingError, recordings
from companion.replay.other_settings import CommandPair, compare
from companion.replay.report import compared_lines, name_of, replayed_lines
from companion.replay.same_settings import Progress, ReplayResult, replay
from companion.types.autopilot import AttitudeTarget
from companion.types.errors import UnusableError
from companion.types.values import printable, printable_lines

EXIT_EQUAL, EXIT_DIFFERENT, EXIT_UNUSABLE = 0, 1, 2
SHOWN_EVERY = 500  # ticks
CLEAR_LINE = "\r\x1b[K"
VALUES = ("roll_deg", "pitch_deg", "yaw_deg", "thrust_norm")
COLUMNS = ("vehicle", "session", "time_s", *(f"{which}_{value}" for which in ("recorded", "other") for value in VALUES))


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """`overrides`: KEY=VALUE of other settings. `vehicle_id` None: all."""

    folder: Path
    vehicle_id: int | None = None
    overrides: Sequence[str] = ()
    csv_file: Path | None = None
    as_json: bool = False


def run_replay(options: ReplayOptions) -> int:
    """Prints the result and returns the exit code. Raises UnusableError."""
    left_out: list[str] = []
    try:
        found = [one for one in recordings(options.folder, left_out.append) if one.vehicle_id]
    except RecordingError as error:
        raise UnusableError("\n".join([*left_out, str(error)])) from error
    for line in left_out:
        _warn(line)
    ids = sorted({one.vehicle_id for one in found})
    if options.vehicle_id is not None:
        found = [one for one in found if one.vehicle_id == options.vehicle_id]
    if not found:
        known = f"expected one of {', '.join(map(str, ids))}" if ids else "only the ground recorded here"
        raise UnusableError(f"{printable(str(options.folder))}: no recording of that vehicle; {known}")
    exit_code = _compare_all(options, found) if options.overrides else _replay_all(options, found)
    return EXIT_UNUSABLE if left_out and exit_code == EXIT_EQUAL else exit_code


# ------------------------------------------------------------ the recorded settings


def _replay_all(options: ReplayOptions, found: Sequence[Recording]) -> int:
    results = []
    for recording in found:
        name = name_of(recording, found)
        with _shown_progress(name) as progress:
            result = _replayed(recording, progress)
        results.append(result)
        if not options.as_json:
            print("\n".join(replayed_lines(name, result)), flush=True)
    equal = all(result.difference is None and not result.unusable for result in results)
    if options.as_json:
        _print_json({"equal": equal, "vehicles": results})
    if any(result.difference for result in results):
        return EXIT_DIFFERENT
    return EXIT_EQUAL if equal else EXIT_UNUSABLE


def _replayed(recording: Recording, progress: Progress) -> ReplayResult:
    try:
        return replay(recording, progress, _warn)
    except ConfigError as error:
        header = recording.header
        return ReplayResult(
            vehicle_id=header.vehicle_id, session=header.session, software=header.software, ticks=0, unusable=str(error)
        )


# ------------------------------------------------------------ other settings


def _compare_all(options: ReplayOptions, found: Sequence[Recording]) -> int:
    names, results = [name_of(recording, found) for recording in found], []
    with _rows_to(options.csv_file) as row:
        for name, recording in zip(names, found, strict=True):
            try:
                with _shown_progress(name) as progress:
                    results.append(compare(recording, options.overrides, row, progress, _warn))
            except ConfigError as error:
                raise UnusableError(str(error)) from error
    if options.as_json:
        _print_json({"settings": options.overrides, "vehicles": results})
    else:
        print("\n".join(compared_lines(names, results, options.overrides)))
    return EXIT_UNUSABLE if any(result.unusable for result in results) else EXIT_EQUAL


@contextmanager
def _rows_to(path: Path | None) -> Iterator[Callable[[CommandPair], None]]:
    """A function that writes the rows of a CSV file, if there is to be one. Raises UnusableError."""
    if path is None:
        yield lambda _: None
        return
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            yield lambda row: writer.writerow(_cells(row))
    except OSError as error:
        raise UnusableError(f"--csv: {printable(str(path))}: {error.strerror}") from error


def _cells(row: CommandPair) -> list[object]:
    return [row.vehicle_id, row.session, row.time_s, *_command(row.recorded), *_command(row.computed)]


def _command(target: AttitudeTarget | None) -> list[object]:
    """Empty cells without a command."""
    if target is None:
        return [""] * 4
    return [degrees(target.roll_rad), degrees(target.pitch_rad), degrees(target.yaw_rad), target.thrust_norm]


# ------------------------------------------------------------ output


def _warn(line: str) -> None:
    print(line, file=sys.stderr)


def _print_json(result: object) -> None:
    print(printable_lines(msgspec.json.format(msgspec.json.encode(result), indent=2).decode()))


@contextmanager
def _shown_progress(name: str) -> Iterator[Progress]:
    """On a terminal one line that changes, and is gone at the end."""
    live = sys.stderr.isatty()

    def show(ticks: int, time_s: float) -> None:
        if live and ticks % SHOWN_EVERY == 0:
            print(f"{CLEAR_LINE}{name}: {ticks} ticks, {time_s:.0f} s", end="", file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        if live:
            print(CLEAR_LINE, end="", file=sys.stderr, flush=True)
