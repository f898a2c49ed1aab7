"""Delay margin of a formation with attitude lag and feed-forward.

The loop is Lambda(s) e^{-sd} with Lambda = N (k1 + k2 s) / (s^2 (1 + sT)) and
N = (I - g W e^{-s tau})^-1 G. Without feed-forward N = G: each eigenvalue has its own loop, and its
margin has a closed form. With feed-forward the eigenvalues of N depend on the frequency, and the
margin is found by a search.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import pairwise
from math import atan2, inf, log, pi, sqrt

import numpy as np

from companion.core.consensus.law import Gains
from companion.stability.arrays import ComplexArray, FloatArray
from companion.stability.interaction import Coupling, eigenvalues, lag_margin_s, mode_eigenvalues, mode_figures
from companion.stability.prediction import LinearModel
from companion.stability.state_space import is_stable

COARSE, PER_E_FOLD = 24, 6  # minimum number of grid points, in total and per e-fold
CLOSE = 1e-6  # relative width of the frequency interval at which the search ends


def delay_margin_with_lag_s(coupling: Coupling, model: LinearModel) -> float:
    """The smallest loop delay d at which a mode is undamped, s; 0 if the lag alone is unstable.

    A root of det(I + Lambda(s) e^{-sd}) = 0 reaches the imaginary axis at s = j omega if an
    eigenvalue of Lambda has modulus 1 and d = (pi + arg) / omega. For a system that is stable at
    d = 0 the margin is the smallest such d. `model.delay_s` is not used.
    """
    if not _stable_without_delay(coupling, model):
        return 0.0
    if coupling.law.feedforward == 0.0:
        gains, lag_s = coupling.law.gains, model.attitude_lag_s
        return min(_mode_margin_s(gains, lag_s, float(value)) for value in eigenvalues(coupling.G))
    return _Spectrum(coupling, model).first_crossing_s()


def _stable_without_delay(coupling: Coupling, model: LinearModel) -> bool:
    if eigenvalues(coupling.G)[0] <= 0.0:
        return False
    if coupling.law.feedforward == 0.0:
        return model.attitude_lag_s < lag_margin_s(coupling.law.gains)
    return is_stable(coupling, LinearModel(model.attitude_lag_s, 0.0, model.feedforward_delay_s))


def _mode_margin_s(gains: Gains, lag_s: float, eigenvalue: float) -> float:
    """Delay margin of one eigenvalue lambda > 0 of G, without feed-forward and with T < k2/k1.

    The loop has gain one at x = omega^2, the only positive root of
    T^2 x^3 + x^2 = lambda^2 (k2^2 x + k1^2). There d = (atan(a omega) - atan(T omega)) / omega with
    a = k2/k1.
    """
    k1, k2 = gains.position_1_s2, gains.velocity_1_s
    roots = np.roots([lag_s**2, 1.0, -((eigenvalue * k2) ** 2), -((eigenvalue * k1) ** 2)])
    omega_rad_s = sqrt(float(roots.real.max()))
    a = k2 / k1
    return atan2((a - lag_s) * omega_rad_s, 1.0 + a * lag_s * omega_rad_s**2) / omega_rad_s


class _Spectrum:
    """Eigenvalues of Lambda(j omega), computed once per frequency."""

    def __init__(self, coupling: Coupling, model: LinearModel) -> None:
        self._coupling = coupling
        self._model = model
        self._known: dict[float, ComplexArray] = {}

    def first_crossing_s(self) -> float:
        """The smallest d of all eigenvalues whose modulus passes 1.

        Best-first search: the interval with the smallest bound is halved until it is narrower
        than `CLOSE`.
        """
        waiting = [(self._soonest_s(low, high), low, high) for low, high in pairwise(self._grid_rad_s().tolist())]
        heapify(waiting)
        while True:
            margin_s, low, high = heappop(waiting)
            if high < low * (1.0 + CLOSE):
                return margin_s
            middle = sqrt(low * high)
            for part in ((low, middle), (middle, high)):
                heappush(waiting, (self._soonest_s(*part), *part))

    def _soonest_s(self, low: float, high: float) -> float:
        """Lower bound of d for the moduli that pass 1 between two frequencies, from both ends."""
        left, right = self._at(low), self._at(high)
        passes = (np.abs(left) >= 1.0) != (np.abs(right) >= 1.0)
        ends = [(pi + np.angle(values[passes])) / omega for values, omega in ((left, low), (right, high))]
        return float(np.min(ends, initial=inf))

    def _at(self, omega_rad_s: float) -> ComplexArray:
        """Eigenvalues (n,) by falling modulus, so that each modulus is continuous in the frequency."""
        if omega_rad_s not in self._known:
            s = 1j * omega_rad_s
            coupling, gains = self._coupling, self._coupling.law.gains
            forward = coupling.law.feedforward * np.exp(-s * self._model.feedforward_delay_s)
            loop = np.linalg.solve(np.eye(len(coupling.G)) - forward * coupling.W, coupling.G)
            feedback = gains.position_1_s2 + gains.velocity_1_s * s
            vehicle = s * s * (1.0 + s * self._model.attitude_lag_s)
            values = np.asarray(np.linalg.eigvals(loop) * (feedback / vehicle), dtype=np.complex128)
            self._known[omega_rad_s] = values[np.argsort(-np.abs(values))]
        return self._known[omega_rad_s]

    def _grid_rad_s(self) -> FloatArray:
        """Frequencies from all moduli above 1 to all below 1, rad/s."""
        modes, gains = mode_eigenvalues(self._coupling), self._coupling.law.gains
        low = high = pi / (2.0 * mode_figures(gains, float(modes[-1])).delay_margin_s)
        while np.abs(self._at(low)).min() <= 1.0:
            low /= 1.5
        while np.abs(self._at(high)).max() >= 1.0:
            high *= 1.5
        return np.geomspace(low, high, max(COARSE, round(PER_E_FOLD * log(high / low))))
