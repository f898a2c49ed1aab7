"""Random numbers for many formations. Each formation has its own generators, so that the rest of the batch has no effect on it.

Formations with the same seed get the same numbers, as in lockstep; studies give each formation its own seed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.batch.columns import Columns

SENSORS, GUSTS, LINKS = 1, 2, 3  # subjects: switching gusts on does not change the sensor noise


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
