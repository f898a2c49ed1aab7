"""Flight of B formations of n vehicles at once.

The model is that of lockstep: the same bodies, loops, delays, law and output limits, 250 physics steps per second, and one tick
of every agent in each telemetry period, at the phase of that vehicle. It starts in formation: the vehicles hover over their
starts, have fresh packets and settled PrCs, and fly the law from t = 0.

It leaves out take-off and landing, the ground, the fence, leader changes, the failsafe for a stale leader beacon, and the
plausibility checks of peers (such as `peers.max_speed_m_s`). Delays are exact to the step. Random numbers differ from those
of lockstep but have the same distributions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.stability.arrays import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.batch.columns import BoolArray, columns_of
from sitl.batch.simulation import BatchStart, Simulation, starts_at_rest
from sitl.flight.scenario import Scenario

PROGRESS_EVERY_S = 1.0  # of virtual time


@dataclass(frozen=True, slots=True)
class BatchFlight:
    """True tracks of B formations of n vehicles, in rising order of their ids.

    `times_s` (ticks,) starts at 0 with the law; `positions_enu_m` (ticks, B, n, 3) is float32; `slots_enu_m` is (B, n, 3).
    `reference_enu_m` is r, (ticks, 3) where all formations have the same and (ticks, B, 3) otherwise. `neighbours`
    (ticks, B, n, n) is whether i uses j as a neighbour, None unless requested.
    """

    times_s: FloatArray
    positions_enu_m: NDArray[np.float32]
    slots_enu_m: FloatArray
    reference_enu_m: FloatArray
    neighbours: BoolArray | None

    def reference_of_formations_enu_m(self) -> FloatArray:
        """r as (ticks, B or 1, 3)."""
        return self.reference_enu_m if self.reference_enu_m.ndim == 3 else self.reference_enu_m[:, None, :]

    def errors_m(self) -> FloatArray:
        """Distance (ticks, B, n) of each vehicle to its slot r + d_i0."""
        reference = self.reference_of_formations_enu_m()
        squares = np.zeros(self.positions_enu_m.shape[:3])
        for axis in range(3):
            off = self.positions_enu_m[..., axis] - reference[:, :, None, axis]
            off -= self.slots_enu_m[None, :, :, axis]
            squares += np.square(off, out=off)
        return np.asarray(np.sqrt(squares, out=squares))


def fly_batch(
    scenarios: Sequence[Scenario],
    duration_s: float,
    progress: Callable[[float], None] | None = None,
    *,
    sample_s: float = 0.02,
    keep_neighbours: bool = False,
    start: BatchStart | None = None,
) -> BatchFlight:
    """Fly these scenarios at once for `duration_s`. Calls `progress` with the seconds flown, about once per virtual second.

    Without `start` the vehicles hover at rest over `starts_enu_m` at take-off height. Timelines are ignored. Raises ValueError
    where the scenarios cannot be flown in one batch.
    """
    stride = round(sample_s / DT_S)
    if stride < 1 or abs(stride * DT_S - sample_s) > 1e-9:
        raise ValueError(f"sample_s is {sample_s:g}; it must be a multiple of {DT_S:g} s")
    columns = columns_of(scenarios)
    begin = start or starts_at_rest(scenarios)
    simulation = Simulation(scenarios, columns, begin)
    samples = round(duration_s / DT_S) // stride + 1
    n = columns.vehicles
    positions = np.empty((samples, columns.formations, n, 3), dtype=np.float32)
    neighbours = np.zeros((samples, columns.formations, n, n), dtype=np.bool_) if keep_neighbours else None
    reported_s = 0.0
    for sample in range(samples):
        if sample:
            for _ in range(stride):
                simulation.step()
        positions[sample] = simulation.positions_enu_m()
        if neighbours is not None:
            neighbours[sample] = simulation.neighbours()
        if progress and simulation.time_s >= reported_s + PROGRESS_EVERY_S:
            reported_s = simulation.time_s
            progress(reported_s)
    times_s = np.arange(samples, dtype=np.float64) * (stride * DT_S)
    return BatchFlight(
        times_s=times_s,
        positions_enu_m=positions,
        slots_enu_m=simulation.slots_enu_m,
        reference_enu_m=simulation.references.positions_enu_m(begin.reference_s + times_s),
        neighbours=neighbours,
    )
