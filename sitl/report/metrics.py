"""Tracks of vehicles (true positions of stand-ins, reported positions of all others) and the figures of a flight from them.

Pure: arrays in, figures out; tracks are also written and read as CSV files.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import dist
from pathlib import Path
from typing import Literal

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.analysis.prediction import settle_time_s as settle_time_s
from companion.core.reference.blend import ReferenceTrajectory
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


SAMPLE_S = 0.02
FINAL_S = 2.0  # interval of the final figures
MOVES_M = 0.01  # a reference that stays within this is at rest

Pair = tuple[int, int]
Tracks = Mapping[int, Track]  # by vehicle id
TrackSource = Literal["true", "estimated"]  # true positions of stand-ins, or the vehicles' own estimates


@dataclass(frozen=True, slots=True)
class Formation:
    """The interval of a formation, seconds of the tracks' clock: the last vehicle's entry until the command that ended it.

    The reference's own time begins at `reference_start_s`: the leader's entry, less the time flown of it before.
    """

    start_s: float
    end_s: float
    reference_start_s: float

    def times_s(self) -> FloatArray:
        """Sample times (n,), n at least 2, both ends included."""
        count = max(2, round((self.end_s - self.start_s) / SAMPLE_S) + 1)
        return np.linspace(self.start_s, self.end_s, count)


@dataclass(frozen=True, slots=True)
class FormationFlight:
    """One formation as flown, with its slots and reference. `pairs` are those whose distances are reported."""

    law: str
    tracks: Tracks
    slots: Tracks  # d_i0 over time; it changes with the formation
    pairs: Sequence[Pair]
    reference: ReferenceTrajectory
    formation: Formation
    source: TrackSource = "true"

    @property
    def slots_enu_m(self) -> dict[int, Vector3]:
        """The slots d_i0 at the formation's end."""
        at_end = {i: slot.at(np.array([self.formation.end_s]))[0].tolist() for i, slot in self.slots.items()}
        return {i: (x, y, z) for i, (x, y, z) in at_end.items()}


@dataclass(frozen=True, slots=True)
class FormationFigures:
    """Figures over the formation's interval; by pair "1-2" or by vehicle id.

    `settle_s`: from the formation's start to the time from which every vehicle stays within 10 cm of its slot; None if that
    is less than 2 s before the end. `largest_error_m`: of any vehicle in the second half.
    `final_error_m` (RMS distance to the slot) and `final_distance_m` (mean) are of the last 2 s.
    """

    duration_s: float
    wanted_distance_m: dict[str, float]
    max_distance_m: dict[str, float]
    min_distance_m: dict[str, float]
    final_distance_m: dict[str, float]
    reference_moves: bool
    settle_s: float | None
    largest_error_m: float
    final_error_m: float
    final_error_of_vehicle_m: dict[int, float]


def pair_name(pair: Pair) -> str:
    return f"{pair[0]}-{pair[1]}"


def pairs_of(vehicle_ids: Mapping[int, object]) -> list[Pair]:
    """All pairs of vehicles, the smaller id first."""
    return list(combinations(sorted(vehicle_ids), 2))


def neighbouring_pairs(slots_enu_m: Mapping[int, Vector3]) -> list[Pair]:
    """Each vehicle's pairs with the vehicles of the nearest slots: the steps along a line, the sides of a square."""
    wanted_m = {(i, j): dist(slots_enu_m[i], slots_enu_m[j]) for i, j in pairs_of(slots_enu_m)}
    nearest_m = {i: min((d for pair, d in wanted_m.items() if i in pair), default=0.0) for i in slots_enu_m}
    return [pair for pair, d in wanted_m.items() if d <= 1.01 * max(nearest_m[pair[0]], nearest_m[pair[1]])]


def distances_m(tracks: Tracks, pair: Pair, times_s: FloatArray) -> FloatArray:
    """Distance (n,) of two vehicles at these times."""
    apart = tracks[pair[0]].at(times_s) - tracks[pair[1]].at(times_s)
    return np.asarray(np.linalg.norm(apart, axis=1))


def reference_positions_m(reference: ReferenceTrajectory, start_s: float, times_s: FloatArray) -> FloatArray:
    """The RFT's positions (n, 3) at these times. Before its start it is at its beginning, as for the leader."""
    return np.array([reference(max(0.0, time_s - start_s)).position_enu_m for time_s in times_s.tolist()])


def errors_m(track: Track, slot: Track, reference_enu_m: FloatArray, times_s: FloatArray) -> FloatArray:
    """Distance (n,) of a vehicle to its slot r + d_i0. `reference_enu_m` (n, 3) is r at these times."""
    return np.asarray(np.linalg.norm(track.at(times_s) - reference_enu_m - slot.at(times_s), axis=1))


def stand_at(slots_enu_m: Mapping[int, Vector3]) -> Tracks:
    """Constant slots, as tracks."""
    return {i: Track(np.zeros(1), np.array([slot])) for i, slot in slots_enu_m.items()}


def formation_figures(
    tracks: Tracks, slots: Tracks, reference: ReferenceTrajectory, formation: Formation
) -> FormationFigures:
    """All figures of one formation. `tracks` and `slots` name the same vehicles; wanted distances are those at the end."""
    times_s = formation.times_s()
    last = times_s >= formation.end_s - FINAL_S
    reference_enu_m = reference_positions_m(reference, formation.reference_start_s, times_s)
    errors = {i: errors_m(tracks[i], slots[i], reference_enu_m, times_s) for i in sorted(tracks)}
    largest_m = np.max(list(errors.values()), axis=0)
    final = {i: rms(error_m[last]) for i, error_m in errors.items()}
    distances = {pair: distances_m(tracks, pair, times_s) for pair in pairs_of(tracks)}
    return FormationFigures(
        duration_s=formation.end_s - formation.start_s,
        wanted_distance_m={pair_name(p): float(distances_m(slots, p, times_s[-1:])[0]) for p in distances},
        max_distance_m={pair_name(p): float(d.max()) for p, d in distances.items()},
        min_distance_m={pair_name(p): float(d.min()) for p, d in distances.items()},
        final_distance_m={pair_name(p): float(d[last].mean()) for p, d in distances.items()},
        reference_moves=bool(np.any(np.ptp(reference_enu_m, axis=0) > MOVES_M)),
        settle_s=settle_time_s(times_s, largest_m),
        largest_error_m=float(largest_m[times_s.size // 2 :].max()),
        final_error_m=max(final.values()),
        final_error_of_vehicle_m=final,
    )


def smallest_distance_m(tracks: Tracks) -> float | None:
    """Of any two vehicles at any time that all tracks cover; None for a single vehicle or without such a time."""
    start_s = max(float(track.time_s[0]) for track in tracks.values())
    end_s = min(float(track.time_s[-1]) for track in tracks.values())
    if len(tracks) < 2 or end_s < start_s:
        return None
    times_s = Formation(start_s, end_s, start_s).times_s()
    return min(float(distances_m(tracks, pair, times_s).min()) for pair in pairs_of(tracks))


Leadership = Mapping[int, Sequence[tuple[float, bool]]]
"""By vehicle: times from which it is leader (True) or follower, seconds of the tracks' clock, rising."""


@dataclass(frozen=True, slots=True)
class Tracking:
    """RMS distances in metres, by vehicle.

    `to_reference_m` is of eq. 12, x_i - r - d_i0. `to_leader_m` is of x_i - d_i0 less the same of the leader, the mean of
    several leaders, over the times when the vehicle follows; None for one that never did.
    """

    to_reference_m: dict[int, float]
    to_leader_m: dict[int, float | None]


def tracking(
    tracks: Tracks, slots: Tracks, reference: ReferenceTrajectory, formation: Formation, leads: Leadership
) -> Tracking:
    """Errors over the second half of a formation. All arguments but `reference` name the same vehicles."""
    times_s = formation.times_s()
    times_s = times_s[times_s.size // 2 :]
    reference_enu_m = reference_positions_m(reference, formation.reference_start_s, times_s)
    ids = sorted(tracks)
    leading = {i: _leads_at(leads[i], times_s) for i in ids}
    positions = {i: tracks[i].at(times_s) - slots[i].at(times_s) for i in ids}
    leaders = np.sum([leading[i] for i in ids], axis=0)
    led = leaders > 0
    led_to_enu_m = np.sum([positions[i] * leading[i][:, None] for i in ids], axis=0) / np.maximum(leaders, 1)[:, None]
    behind_m = {i: np.linalg.norm(positions[i] - led_to_enu_m, axis=1)[led & ~leading[i]] for i in ids}
    return Tracking(
        {i: rms(errors_m(tracks[i], slots[i], reference_enu_m, times_s)) for i in ids},
        {i: rms(behind) if behind.size else None for i, behind in behind_m.items()},
    )


def _leads_at(since: Sequence[tuple[float, bool]], times_s: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether it is leader at these times (n,). Before its first report the first report applies."""
    if not since:
        return np.zeros(times_s.size, dtype=bool)
    index = np.searchsorted([time_s for time_s, _ in since], times_s, side="right") - 1
    return np.array([leads for _, leads in since])[np.maximum(index, 0)]


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
