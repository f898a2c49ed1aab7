"""The array layout of a batch: one column per vehicle.

Columns are in the order of the vehicles' phases, so that all vehicles that tick in the same step form one slice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from companion.analysis.interaction import FloatArray
from companion.config.reference import TargetReference
from sitl.flight.files import ids_of
from sitl.flight.lockstep import TELEMETRY_STEPS, phase_steps
from sitl.flight.scenario import Scenario

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Columns:
    """B formations of n vehicles in B n columns.

    `order` (B n,) is the vehicle of each column, as b n + i with i by rising ids; `column_of` is its inverse.
    `formation` (B n,) is b, `phase_steps` (B n,) the step within a period in which a column ticks, `groups` the slices of the
    phases.
    """

    formations: int
    vehicles: int
    order: IntArray
    column_of: IntArray
    formation: IntArray
    phase_steps: IntArray
    groups: tuple[slice, ...]

    @property
    def count(self) -> int:
        return self.formations * self.vehicles

    def in_columns(self, of_vehicles: FloatArray) -> FloatArray:
        """(B, n, k) by vehicle -> (k, B n) by column."""
        flat = of_vehicles.reshape(self.count, -1)
        return np.ascontiguousarray(flat[self.order].T)

    def by_vehicle(self, rows: FloatArray) -> FloatArray:
        """(k, B n) by column -> (B, n, k)."""
        return rows.take(self.column_of, axis=1).T.reshape(self.formations, self.vehicles, -1)

    def spread(self, of_formations: Sequence[float]) -> FloatArray:
        """One number per formation -> (B n,)."""
        return np.array(of_formations, dtype=np.float64)[self.formation]


def columns_of(scenarios: Sequence[Scenario]) -> Columns:
    """The columns of these scenarios. Raises ValueError where they cannot be flown in one batch."""
    _check(scenarios)
    ids = [ids_of(scenario) for scenario in scenarios]
    count, vehicles = len(scenarios), len(ids[0])
    phases = np.array([[phase_steps(s.stand_in.seed, i) for i in own] for s, own in zip(scenarios, ids, strict=True)])
    order = np.argsort(phases.ravel(), kind="stable")
    column_of = np.empty_like(order)
    column_of[order] = np.arange(order.size)
    sorted_phases = phases.ravel()[order]
    ends = np.searchsorted(sorted_phases, np.arange(TELEMETRY_STEPS + 1))
    groups = tuple(slice(int(a), int(b)) for a, b in pairwise(ends))
    return Columns(count, vehicles, order, column_of, order // vehicles, sorted_phases, groups)


NOT_MODELLED = dict.fromkeys(
    (
        "stand_in.batteries",
        "stand_in.estimator_resets",
        "stand_in.pilots",
        "stand_in.refusals",
        "stand_in.position_losses",
        "stand_in.failsafes",
        "stand_in.homes",
        "stand_in.rally_points",
        "stand_in.vehicles",
    ),
    "sitl run or sitl fly",
) | dict.fromkeys(("agent_ends", "links.partitions", "links.late_telemetry", "links.lies"), "sitl run")


def _check(scenarios: Sequence[Scenario]) -> None:
    if not scenarios:
        raise ValueError("a batch needs at least one scenario")
    counts = sorted({len(scenario.fleet.vehicles) for scenario in scenarios})
    if len(counts) > 1:
        raise ValueError(f"all formations of a batch need the same number of vehicles; these have {counts}")
    if any(scenario.stand_in.positioning != "gps" for scenario in scenarios):
        raise ValueError("a batch does not model stand_in.positioning; use sitl run or sitl fly")
    for key, instead in NOT_MODELLED.items():
        if any(map(attrgetter(key), scenarios)):
            raise ValueError(f"a batch does not model {key}; use {instead}")
    if any(isinstance(scenario.reference, TargetReference) for scenario in scenarios):
        raise ValueError("a batch does not model targets to be followed; use sitl run or sitl fly")
    kinds = sorted({scenario.stand_in.airframe.attitude for scenario in scenarios})
    if len(kinds) > 1:
        raise ValueError(f"all formations of a batch need the same kind of attitude control; these have {kinds}")


SENSORS, GUSTS, LINKS, LINKS_TO_ALL = 1, 2, 3, 4  # subjects: switching gusts on does not change the sensor noise


class Gaussians:
    """Standard normal numbers (rows, B n), drawn in blocks because one call per formation and tick takes too long.

    The numbers of a quiet formation are zero.
    """

    def __init__(
        self, seeds: Sequence[int], quiet: Sequence[bool], subject: int, columns: Columns, rows: int, length: int
    ) -> None:
        """`length` is the number of draws in a block; it must not depend on the batch."""
        self._generators = [
            None if still else np.random.default_rng([seed, subject]) for seed, still in zip(seeds, quiet, strict=True)
        ]
        self._columns = columns
        self._drawn = np.zeros((length, rows, columns.formations, columns.vehicles))
        self._block = np.empty((length, rows, columns.count))
        self._used = length

    def next(self) -> FloatArray:
        """The next numbers (rows, B n), valid until the next call."""
        if self._used == len(self._block):
            self._refill()
        self._used += 1
        block: FloatArray = self._block[self._used - 1]
        return block

    def _refill(self) -> None:
        length, rows, _, n = self._drawn.shape
        for b, generator in enumerate(self._generators):
            if generator is not None:
                self._drawn[:, :, b] = generator.standard_normal((length, rows, n))
        self._drawn.reshape(length, rows, -1).take(self._columns.order, axis=2, out=self._block)
        self._used = 0


class BatchGaussMarkov:
    """sitl.vehicle.disturbances.GaussMarkov for (rows, B n) numbers, started from their stationary distributions."""

    def __init__(self, sd: FloatArray, time_s: FloatArray, dt_s: float, first: FloatArray) -> None:
        """`first` holds standard normal numbers; all arrays have its shape."""
        self._keep = np.exp(-dt_s / time_s)
        self._kick = sd * np.sqrt(1.0 - self._keep**2)
        self.value: FloatArray = sd * first

    def step(self, gaussian: FloatArray) -> None:
        self.value *= self._keep
        self.value += self._kick * gaussian
