"""The figures of sitl.report.metrics for every formation of a batch, with the same definitions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.analysis.prediction import settle_time_s
from sitl.batch.columns import BoolArray
from sitl.batch.flight import BatchFlight
from sitl.report.metrics import FINAL_S, neighbouring_pairs


@dataclass(frozen=True, slots=True)
class BatchFigures:
    """By formation (B,), in the order of the scenarios; distances are the extremes over time.

    `settle_s` is NaN where a formation never settled. Neighbouring pairs are those whose slots are nearest to each other.
    """

    settle_s: FloatArray
    final_error_m: FloatArray  # of the vehicle with the largest error
    final_error_of_vehicle_m: FloatArray  # (B, n)
    largest_distance_m: FloatArray
    smallest_distance_m: FloatArray
    largest_neighbouring_distance_m: FloatArray
    smallest_neighbouring_distance_m: FloatArray


def batch_figures(flight: BatchFlight) -> BatchFigures:
    errors_m = flight.errors_m()
    final = final_errors_m(flight.times_s, errors_m)
    largest, smallest = distance_extremes_m(flight)
    near, every = neighbouring(flight.slots_enu_m), pairs(flight.slots_enu_m)
    return BatchFigures(
        settle_s=settle_times_s(flight.times_s, errors_m.max(axis=2)),
        final_error_m=np.asarray(final.max(axis=1)),
        final_error_of_vehicle_m=final,
        largest_distance_m=_largest(largest, every),
        smallest_distance_m=_smallest(smallest, every),
        largest_neighbouring_distance_m=_largest(largest, near),
        smallest_neighbouring_distance_m=_smallest(smallest, near),
    )


def settle_times_s(times_s: FloatArray, error_m: FloatArray) -> FloatArray:
    """`settle_time_s` (B,) of errors (ticks, B); NaN where there is none."""
    known = np.where(np.isnan(error_m), np.inf, error_m)  # a formation that ended has not settled
    times = (settle_time_s(times_s, known[:, b]) for b in range(error_m.shape[1]))
    return np.array([np.nan if settled_s is None else settled_s for settled_s in times])


def final_errors_m(times_s: FloatArray, errors_m: FloatArray) -> FloatArray:
    """RMS (B, n) of errors (ticks, B, n) over the last FINAL_S."""
    last = errors_m[times_s >= times_s[-1] - FINAL_S - 1e-9]
    return np.asarray(np.sqrt(np.mean(np.square(last), axis=0)))


def distance_extremes_m(flight: BatchFlight) -> tuple[FloatArray, FloatArray]:
    """The largest and the smallest distance of each pair over time, (B, n, n), symmetric with zeros on the diagonal."""
    _, formations, n, _ = flight.positions_enu_m.shape
    largest, smallest = np.zeros((formations, n, n)), np.zeros((formations, n, n))
    for i, j in combinations(range(n), 2):
        apart = flight.positions_enu_m[:, :, i] - flight.positions_enu_m[:, :, j]
        square = np.einsum("tbk,tbk->tb", apart, apart)
        largest[:, i, j] = largest[:, j, i] = np.sqrt(square.max(axis=0))
        smallest[:, i, j] = smallest[:, j, i] = np.sqrt(square.min(axis=0))
    return largest, smallest


def pairs(slots_enu_m: FloatArray) -> BoolArray:
    """All pairs (B, n, n), each once."""
    formations, n, _ = slots_enu_m.shape
    return np.broadcast_to(np.triu(np.ones((n, n), dtype=np.bool_), 1), (formations, n, n))


def neighbouring(slots_enu_m: FloatArray) -> BoolArray:
    """Pairs (B, n, n), each once, whose slots are nearest to each other."""
    near = np.zeros((*slots_enu_m.shape[:2], slots_enu_m.shape[1]), dtype=np.bool_)
    known: dict[bytes, BoolArray] = {}
    for b, slots in enumerate(slots_enu_m):
        key = slots.tobytes()
        if key not in known:
            known[key] = np.zeros(near.shape[1:], dtype=np.bool_)
            for i, j in neighbouring_pairs({i: (x, y, z) for i, (x, y, z) in enumerate(slots.tolist())}):
                known[key][i, j] = True
        near[b] = known[key]
    return near


def _largest(distances_m: FloatArray, which: BoolArray) -> FloatArray:
    """Largest distance of these pairs (B,); 0 without pairs."""
    return np.asarray(np.where(which, distances_m, 0.0).max(axis=(1, 2)))


def _smallest(distances_m: FloatArray, which: BoolArray) -> FloatArray:
    """Smallest distance of these pairs (B,); infinite without pairs."""
    return np.asarray(np.where(which, distances_m, np.inf).min(axis=(1, 2)))
