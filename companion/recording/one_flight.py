"""Which recordings belong to one flight: a folder with all files of a board has those of other days as well."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from companion.recording.alignment import RecordingClock
from companion.recording.mcap_file import Warn
from companion.recording.reader import Recording

APART_S = 3600.0  # what begins by more before or after all of a flight is none of it
NAMED = 5  # of those that are left out


def of_one_flight(
    recordings: Sequence[Recording], clocks: Sequence[RecordingClock], warn: Warn
) -> list[tuple[Recording, RecordingClock]]:
    """Those whose clocks are aligned, and what begins near them; without any, the latest and what begins near it.

    `warn` gets one line where others are left out. There is at least one recording.
    """
    pairs = list(zip(recordings, clocks, strict=True))
    begins_s = [clock.common_s(one.header.monotonic_s) for one, clock in pairs]
    of_flight_s = [s for s, clock in zip(begins_s, clocks, strict=True) if clock.is_aligned] or [max(begins_s)]
    first_s, last_s = min(of_flight_s) - APART_S, max(of_flight_s) + APART_S
    others = [one for (one, _), s in zip(pairs, begins_s, strict=True) if not first_s <= s <= last_s]
    if others:
        warn(_left_out(others))
    return [pair for pair, s in zip(pairs, begins_s, strict=True) if first_s <= s <= last_s]


def _left_out(others: Sequence[Recording]) -> str:
    named = ", ".join(f"{one.name} of {_date(one.header.unix_s)}" for one in others[:NAMED])
    more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
    count = "1 recording" if len(others) == 1 else f"{len(others)} recordings"
    return (
        f"{count} of more than an hour before or after this flight, by the clocks on board, left out: {named}{more};"
        " give each flight its own folder"
    )


def _date(unix_s: float) -> str:
    return f"{datetime.fromtimestamp(unix_s, UTC):%Y-%m-%d %H:%M} UTC"
