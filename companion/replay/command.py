"""`companion replay`: the recordings of a folder, one after the other, and the text about them."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from math import degrees
from pathlib import Path
from shlex import join

import msgspec

from companion.config.code_file import UnreadCodeError, read_beside
from companion.config.file import ConfigError
from companion.recording.alignment import FIRST_DATE_UNIX_S
from companion.recording.reader import Recording, RecordingError, recordings
from companion.recording.records import SOFTWARE
from companion.replay.comparison import (
    CommandPair,
    Deviation,
    FirstDifference,
    Progress,
    ReplayResult,
    SettingsComparison,
    compare,
    replay,
)
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
            result = _replayed(options.folder, recording, progress)
        results.append(result)
        if not options.as_json:
            print("\n".join(replayed_lines(name, result)), flush=True)
    equal = all(result.difference is None and not result.unusable for result in results)
    if options.as_json:
        _print_json({"equal": equal, "vehicles": results})
    if any(result.difference for result in results):
        return EXIT_DIFFERENT
    return EXIT_EQUAL if equal else EXIT_UNUSABLE


def _replayed(folder: Path, recording: Recording, progress: Progress) -> ReplayResult:
    try:
        return replay(recording, progress, _warn)
    except UnreadCodeError as error:
        flown = f"it was flown with {error.file} (SHA-256 {error.sha256}), and a recording has no code"
        command = join(["companion", "replay", str(folder), "--code", _code_beside(recording, error)])
        unusable = f"{flown}; look at it, then: {command}"
    except ConfigError as error:
        unusable = str(error)
    header = recording.header
    return ReplayResult(
        vehicle_id=header.vehicle_id, session=header.session, software=header.software, ticks=0, unusable=unusable
    )


def _code_beside(recording: Recording, wanted: UnreadCodeError) -> str:
    """The file of this name beside the recording, where `sitl run --record` leaves it, if it has the content that was flown;
    else the name that it had. It is named and not run: who has made the recording may have made the file.
    """
    file = recording.parts[0].path.parent / Path(wanted.file).name
    if file.is_file() and sha256(read_beside(Path(file.name), recording.parts[0].path)).hexdigest() == wanted.sha256:
        return str(file)
    return wanted.file


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


HEADING = (
    f"{'':20} {'commands':>8}  {'roll max, RMS':>15}  {'pitch max, RMS':>15}  {'thrust max, RMS':>15}  first difference"
)


def name_of(recording: Recording, all_of_them: Sequence[Recording]) -> str:
    """The vehicle, with the number of the start where its agent started several times."""
    vehicle = (recording.header.fleet, recording.vehicle_id)
    starts = [one for one in all_of_them if (one.header.fleet, one.vehicle_id) == vehicle]
    fleets = {one.header.fleet for one in all_of_them}
    name = f"vehicle {recording.vehicle_id}" + (f" of {recording.header.fleet}" if len(fleets) > 1 else "")
    return printable(name + (f", start {starts.index(recording) + 1}" if len(starts) > 1 else ""))


def replayed_lines(name: str, result: ReplayResult) -> Iterator[str]:
    """The result for one start of one vehicle."""
    if not result.ticks:
        yield f"{name}: cannot be replayed: {printable(result.unusable)}"
    elif result.difference:
        yield f"{name}: {_place(result.difference)}: {printable(result.difference.field)}"
        yield f"  recorded {printable(result.difference.recorded)}"
        yield f"  computed {printable(result.difference.computed)}"
        if result.software != SOFTWARE:
            recorded_by = printable(result.software)
            yield f"  recorded by {recorded_by}, computed by {SOFTWARE}: that may be the reason"
    else:
        ends = f"; it ends there: {printable(result.unusable)}" if result.unusable else ""
        without = f", {result.not_recorded} of them without a recorded output" if result.not_recorded else ""
        yield f"{name}: {result.ticks} ticks, all equal{without}{ends}"


def _place(difference: FirstDifference) -> str:
    place = f"tick {difference.tick} differs, {difference.time_s:.3f} s after the first"
    if difference.utc_s < FIRST_DATE_UNIX_S:
        return place
    return f"{place} ({datetime.fromtimestamp(difference.utc_s, UTC):%Y-%m-%d %H:%M:%S.%f} UTC)"


def compared_lines(
    names: Sequence[str], results: Sequence[SettingsComparison], overrides: Sequence[str]
) -> Iterator[str]:
    """A table: how far the commands with other settings are from the recorded ones."""
    yield f"with {printable(', '.join(overrides))}, against the recorded commands (roll and pitch in degrees, thrust 0 to 1):"
    yield HEADING
    for name, result in zip(names, results, strict=True):
        figures = "  ".join(map(_figures, (result.roll_deg, result.pitch_deg, result.thrust_norm)))
        first = "none" if result.first_tick is None else f"tick {result.first_tick}, {result.first_s:.3f} s"
        yield f"{name:20} {result.commands:8}  {figures}  {first}"
    for name, result in zip(names, results, strict=True):
        if result.only_recorded or result.only_computed:
            recorded, other = result.only_recorded, result.only_computed
            yield f"{name}: a command only in the recording in {recorded} ticks, only with the other settings in {other}"
        if result.unusable:
            yield f"{name}: ends after {result.ticks} ticks: {printable(result.unusable)}"


def _figures(deviation: Deviation) -> str:
    return f"{deviation.largest:7.3f} {deviation.rms:7.3f}"
