"""The text of `companion replay`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

from companion.recording.reader import Recording
from companion.recording.records import SOFTWARE
from companion.replay.other_settings import Deviation, SettingsComparison
from companion.replay.same_settings import FirstDifference, ReplayResult
from companion.types.values import printable

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
    utc = datetime.fromtimestamp(difference.utc_s, UTC)
    return f"tick {difference.tick} differs, {difference.time_s:.3f} s after the first ({utc:%Y-%m-%d %H:%M:%S.%f} UTC)"


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
