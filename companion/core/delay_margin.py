"""The longest loop delay that a formation bears, with attitude lag and feed-forward.

The loop is Lambda(s) e^{-sd} with Lambda = N (k1 + k2 s) / (s^2 (1 + sT)) and N = (I - g W e^{-s tau})^-1 G. Without
feed-forward N = G and every eigenvalue has a loop of its own; with it the eigenvalues of N move with the frequency.
"""

from __future__ import annotations

from math import log, pi

import numpy as np
from numpy.typing import NDArray

from companion.core.interaction import Coupling, FloatArray, eigenvalues, lag_margin_s, mode_eigenvalues, mode_figures
from companion.core.prediction import LinearModel
from companion.core.state_space import is_stable

ComplexArray = NDArray[np.complex128]
COARSE, PER_E_FOLD, FINE, CLOSER = 24, 6, 16, 2  # points of the grid, of a part of it, and how often a part is taken


def delay_margin_with_lag_s(coupling: Coupling, model: LinearModel) -> float:
    """The delay d at which the first mode begins to swing for ever; 0 where the lag alone makes the formation unstable.

    A root of det(I + Lambda(s) e^{-sd}) = 0 reaches the axis at s = j omega where an eigenvalue of Lambda has modulus 1 and
    d = (pi + arg) / omega. From a system that is stable at d = 0 the smallest such d is the margin. `model.delay_s` does not
    count.
    """
    if not _stable_without_delay(coupling, model):
        return 0.0
    spectrum = _Spectrum(coupling, model)
    grid = spectrum.range_rad_s()
    margin_s, k = spectrum.first_crossing(grid)
    for _ in range(CLOSER):
        grid = np.geomspace(grid[max(k - 1, 0)], grid[min(k + 2, len(grid) - 1)], FINE)
        margin_s, k = spectrum.first_crossing(grid)
    return margin_s


def _stable_without_delay(coupling: Coupling, model: LinearModel) -> bool:
    if eigenvalues(coupling.G)[0] <= 0.0:
        return False
    if coupling.law.feedforward == 0.0:
        return model.attitude_lag_s < lag_margin_s(coupling.law.gains)
    return is_stable(coupling, LinearModel(model.attitude_lag_s, 0.0, model.feedforward_delay_s))


class _Spectrum:
    """Eigenvalues of Lambda(j omega)."""

    def __init__(self, coupling: Coupling, model: LinearModel) -> None:
        self._coupling = coupling
        self._model = model
        self._constant = eigenvalues(coupling.G).astype(complex) if coupling.law.feedforward == 0.0 else None

    def at(self, omega_rad_s: float) -> ComplexArray:
        """(n,), the largest modulus first. Sorted so, each one's modulus is continuous in the frequency."""
        s = 1j * omega_rad_s
        coupling, gains = self._coupling, self._coupling.law.gains
        values: ComplexArray | None = self._constant
        if values is None:
            heard = coupling.law.feedforward * np.exp(-s * self._model.feedforward_delay_s)
            loop = np.linalg.solve(np.eye(len(coupling.G)) - heard * coupling.W, coupling.G)
            values = np.asarray(np.linalg.eigvals(loop), dtype=np.complex128)
        feedback = gains.position_1_s2 + gains.velocity_1_s * s
        vehicle = s * s * (1.0 + s * self._model.attitude_lag_s)
        values = np.asarray(values * (feedback / vehicle), dtype=np.complex128)
        return values[np.argsort(-np.abs(values))]

    def range_rad_s(self) -> FloatArray:
        """From where every modulus is above 1 to where every one is below."""
        modes, gains = mode_eigenvalues(self._coupling), self._coupling.law.gains
        low = high = pi / (2.0 * mode_figures(gains, float(modes[-1])).delay_margin_s)
        while np.abs(self.at(low)).min() <= 1.0:
            low /= 1.5
        while np.abs(self.at(high)).max() >= 1.0:
            high *= 1.5
        return np.geomspace(low, high, max(COARSE, round(PER_E_FOLD * log(high / low))))

    def first_crossing(self, grid: FloatArray) -> tuple[float, int]:
        """The smallest d of all moduli that fall below 1 between two points of the grid, and between which."""
        values = np.array([self.at(float(omega)) for omega in grid])
        above = np.abs(values) >= 1.0
        crosses = above[:-1] & ~above[1:]
        delays = np.where(crosses, (pi + np.angle(values[:-1])) / grid[:-1, np.newaxis], np.inf)
        k = int(np.argmin(delays.min(axis=1)))
        return float(delays[k].min()), k
