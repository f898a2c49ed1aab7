"""Which recordings in a folder belong to one flight."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from companion.recording.alignment import RecordingClock, of_one_flight
from companion.recording.reader import RecordedPart, Recording
from recordings import HEADER

DAY_S = 86_400.0


def recording(vehicle_id: int, unix_s: float) -> Recording:
    return Recording((RecordedPart(Path("a.mcap"), replace(HEADER, vehicle_id=vehicle_id, unix_s=unix_s)),))


def chosen(*starts: tuple[Recording, bool]) -> tuple[list[Recording], list[str]]:
    """Of recordings with whether their clocks are aligned, and what is said."""
    said: list[str] = []
    clocks = [
        RecordingClock(one.header.monotonic_s, one.header.unix_s, 0.0, 0.01 if aligned else None)
        for one, aligned in starts
    ]
    return [one for one, _ in of_one_flight([one for one, _ in starts], clocks, said.append)], said


def test_nothing_is_said_of_a_flight_alone() -> None:
    pair = [recording(1, 0.0), recording(2, 1800.0)]
    assert chosen((pair[0], True), (pair[1], False)) == (pair, [])


def test_other_days_are_left_out_and_named() -> None:
    flown, before, after = recording(1, 5 * DAY_S), recording(1, 0.0), recording(2, 9 * DAY_S)
    kept, said = chosen((before, False), (flown, True), (after, False))
    assert kept == [flown]
    (line,) = said
    assert line.startswith("2 recordings of more than an hour before or after this flight")
    assert "vehicle 1 of 1970-01-01 00:00 UTC, vehicle 2 of 1970-01-10 00:00 UTC" in line


def test_without_aligned_clocks_it_is_the_latest() -> None:
    old, new, near = recording(1, 0.0), recording(1, DAY_S), recording(2, DAY_S - 60.0)
    assert chosen((old, False), (new, False), (near, False))[0] == [new, near]


def test_only_some_are_named() -> None:
    many = [(recording(1, number * DAY_S), False) for number in range(9)]
    assert "and 3 more; give each flight its own folder" in chosen(*many)[1][0]
