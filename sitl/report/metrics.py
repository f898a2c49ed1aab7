"""The figures of a flight from tracks. Pure: arrays in, figures out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import dist
from typing import Literal

import numpy as np

from companion.core.reference.trajectories import ReferenceTrajectory
from companion.stability.arrays import FloatArray
from companion.stability.settling import SETTLED_WITHIN_M
from companion.stability.settling import settle_time_s as settle_time_s
from companion.types.values import Vector3
from sitl.report.tracks import Track

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
    is less than 2 s before the end. `first_within_s`: when all were first within 10 cm at once, None if never.
    `least_error_m`: the smallest value over time of the largest error. `final_error_m` (RMS distance to the slot) and
    `final_distance_m` (mean) are of the last 2 s.
    """

    duration_s: float
    wanted_distance_m: dict[str, float]
    max_distance_m: dict[str, float]
    min_distance_m: dict[str, float]
    final_distance_m: dict[str, float]
    reference_moves: bool
    settle_s: float | None
    first_within_s: float | None
    least_error_m: float
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


def standing(slots_enu_m: Mapping[int, Vector3]) -> Tracks:
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
    within = np.flatnonzero(largest_m <= SETTLED_WITHIN_M)
    final = {i: float(np.sqrt(np.mean(error_m[last] ** 2))) for i, error_m in errors.items()}
    distances = {pair: distances_m(tracks, pair, times_s) for pair in pairs_of(tracks)}
    return FormationFigures(
        duration_s=formation.end_s - formation.start_s,
        wanted_distance_m={pair_name(p): float(distances_m(slots, p, times_s[-1:])[0]) for p in distances},
        max_distance_m={pair_name(p): float(d.max()) for p, d in distances.items()},
        min_distance_m={pair_name(p): float(d.min()) for p, d in distances.items()},
        final_distance_m={pair_name(p): float(d[last].mean()) for p, d in distances.items()},
        reference_moves=bool(np.any(np.ptp(reference_enu_m, axis=0) > MOVES_M)),
        settle_s=settle_time_s(times_s, largest_m),
        first_within_s=float(times_s[within[0]] - times_s[0]) if within.size else None,
        least_error_m=float(largest_m.min()),
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
