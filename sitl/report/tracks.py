"""Tracks of vehicles as arrays and CSV files: true positions of stand-ins, reported positions of all others."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.stability.arrays import FloatArray
from companion.types.errors import CompanionError
from companion.types.values import Vector3

USED = ("monotonic_s", "x_m", "y_m", "z_m")


@dataclass(frozen=True, slots=True)
class Track:
    """One vehicle's flight: `time_s` (k,) of the machine's monotonic clock, rising; `position_enu_m` (k, 3)."""

    time_s: FloatArray
    position_enu_m: FloatArray

    def at(self, times_s: FloatArray) -> FloatArray:
        """Positions (n, 3) in metres, interpolated; constant beyond the ends of the track."""
        axes = [np.interp(times_s, self.time_s, self.position_enu_m[:, axis]) for axis in range(3)]
        return np.stack(axes, axis=1)


class TrackError(CompanionError):
    """A track that cannot be used. str() is one line."""


def read_track(path: Path) -> Track:
    """Read a stand-in's CSV; an incomplete last line is ignored. Raises TrackError."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return _track(path, csv.reader(file))
    except OSError as error:
        raise TrackError(f"{path}: cannot be read: {error.strerror}") from error


def _track(path: Path, lines: Iterable[list[str]]) -> Track:
    rows = iter(lines)
    header = next(rows, [])
    if missing := [name for name in USED if name not in header]:
        raise TrackError(f"{path}: has no column {', '.join(missing)}")
    columns = [header.index(name) for name in USED]
    whole = [[float(row[column]) for column in columns] for row in rows if len(row) == len(header)]
    if not whole:
        raise TrackError(f"{path}: holds no positions")
    table = np.array(whole)
    return Track(table[:, 0], table[:, 1:])


def reported_track(vehicle_id: int, reported: Sequence[tuple[float, Vector3]]) -> Track:
    """The track of reported (monotonic seconds, position ENU in metres), times rising. Raises TrackError."""
    if not reported:
        raise TrackError(f"vehicle {vehicle_id} reported no position in flight")
    return Track(np.array([time_s for time_s, _ in reported]), np.array([position_m for _, position_m in reported]))


def write_track(path: Path, track: Track) -> None:
    """A CSV file that `read_track` reads."""
    table = np.column_stack([track.time_s, track.position_enu_m])
    np.savetxt(path, table, fmt=["%.6f", "%.4f", "%.4f", "%.4f"], delimiter=",", header=",".join(USED), comments="")
