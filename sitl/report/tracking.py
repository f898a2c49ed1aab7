"""Tracking errors of vehicles in formation, about the RFT and about the leader.

Followers do not know the RFT: they can only keep their slot about the leader. Both errors are taken over the second half of a
formation, when its initial errors have settled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.reference.trajectories import ReferenceTrajectory
from companion.stability.arrays import FloatArray
from sitl.report.metrics import Formation, Tracks, errors_m, reference_positions_m

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
    return Tracking(
        {i: _rms(errors_m(tracks[i], slots[i], reference_enu_m, times_s)) for i in ids},
        {i: _rms_or_none(np.linalg.norm(positions[i] - led_to_enu_m, axis=1)[led & ~leading[i]]) for i in ids},
    )


def _leads_at(since: Sequence[tuple[float, bool]], times_s: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether it is leader at these times (n,). Before its first report the first report applies."""
    if not since:
        return np.zeros(times_s.size, dtype=bool)
    index = np.searchsorted([time_s for time_s, _ in since], times_s, side="right") - 1
    return np.array([leads for _, leads in since])[np.maximum(index, 0)]


def _rms(distances_m: FloatArray) -> float:
    return float(np.sqrt(np.mean(distances_m**2)))


def _rms_or_none(distances_m: FloatArray) -> float | None:
    return _rms(distances_m) if distances_m.size else None
