"""Whether a disturbance at the leader grows from level to level: what the smallest eigenvalue does not tell.

y_i is how far vehicle i is from where it stood. The reference swings like sin(omega t), or an acceleration disturbs the
leaders, and nobody else is touched. With one leader both give the same ratios of y, because the followers' equations hold y
alone, and so no ratio tells which of the two it was. Where the swing is slow everybody goes along and all ratios are 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from companion.core.arrays import FloatArray
from companion.core.interaction import Coupling, mode_eigenvalues
from companion.core.prediction import LinearModel
from companion.core.state_space import is_stable

ComplexArray = NDArray[np.complex128]
POINTS_PER_DECADE = 80
PEAKS = 5  # of the grid, looked at more closely
CLOSER_STEPS = 24
FAINT = 1e-6  # of the leader's swing; what such a level does to the next is of no interest


@dataclass(frozen=True, slots=True)
class StringGains:
    """H-infinity norms, the largest ratio over all frequencies; 1 is the least, since slow swings pass unchanged.

    The swing of a level is the largest |y_i| of the vehicles with that PrC. `per_hop` is the largest ratio of one level's swing
    to that of the level before, `to_last` that of the farthest level's to the leaders'. Both at their frequencies.
    """

    per_hop: float
    per_hop_rad_s: float
    to_last: float
    to_last_rad_s: float


def response(coupling: Coupling, model: LinearModel, omega_rad_s: float) -> ComplexArray:
    """y (n,) for a reference that swings by 1 m at this frequency.

    s^2 (1 + sT) e^{sd} y = u and u = -(k1 + k2 s)(G y - L r) + g W e^{-s tau} u + g s^2 L r, with L = 1 for leaders, hence
    [(I - g W e^{-s tau}) s^2 (1 + sT) e^{sd} + (k1 + k2 s) G] y = (k1 + k2 s + g s^2) L r.
    """
    s = 1j * omega_rad_s
    law = coupling.law
    feedback = law.gains.position_1_s2 + law.gains.velocity_1_s * s
    vehicle = s * s * (1.0 + s * model.attitude_lag_s) * np.exp(s * model.delay_s)
    heard = law.feedforward * np.exp(-s * model.feedforward_delay_s)
    left = vehicle * (np.eye(len(coupling.G)) - heard * coupling.W) + feedback * coupling.G
    right = (feedback + law.feedforward * s * s) * coupling.leads
    return np.asarray(np.linalg.solve(left, right), dtype=np.complex128)


def string_gains(coupling: Coupling, model: LinearModel) -> StringGains | None:
    """None where all vehicles lead, and there is no hop, and where the formation is unstable: its swings have no largest.

    Every vehicle must have a path to a leader.
    """
    levels = [np.flatnonzero(coupling.prcs == p) for p in range(1, int(coupling.prcs.max()) + 1)]
    if len(levels) < 2 or not is_stable(coupling, model):
        return None

    def ratios(log_omega: float) -> tuple[float, float]:
        swings = np.abs(response(coupling, model, exp(log_omega)))
        swing = np.array([swings[level].max() for level in levels])
        heard = swing[:-1] > FAINT * swing[0]
        return float((swing[1:][heard] / swing[:-1][heard]).max()), float(swing[-1] / swing[0])

    grid = _grid(coupling)
    values = np.array([ratios(float(x)) for x in grid])
    per_hop, per_hop_at = _largest(lambda x: ratios(x)[0], grid, values[:, 0])
    to_last, to_last_at = _largest(lambda x: ratios(x)[1], grid, values[:, 1])
    return StringGains(max(1.0, per_hop), exp(per_hop_at), max(1.0, to_last), exp(to_last_at))


def _grid(coupling: Coupling) -> FloatArray:
    """log(omega) from well below the slowest mode, sqrt(k1 mu), to where no vehicle can follow any more."""
    k1 = coupling.law.gains.position_1_s2
    slowest = max(float(mode_eigenvalues(coupling)[0]), 1e-9)
    low, high = log(0.1 * sqrt(k1 * slowest)), log(20.0 * pi)
    return np.linspace(low, high, round(POINTS_PER_DECADE * (high - low) / log(10.0)))


def _largest(value: Callable[[float], float], grid: FloatArray, values: FloatArray) -> tuple[float, float]:
    """The largest value and where, around the highest peaks of the grid. A badly damped mode's peak lies between its points."""
    inner = np.arange(1, len(grid) - 1)
    peaks = inner[(values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])]
    peaks = peaks[np.argsort(values[peaks])[::-1][:PEAKS]]
    best = int(np.argmax(values))
    found = [(float(values[best]), float(grid[best]))]
    found += [_golden(value, float(grid[k - 1]), float(grid[k + 1])) for k in peaks]
    return max(found)


def _golden(value: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Golden-section search for a maximum between two points."""
    golden = (sqrt(5.0) - 1.0) / 2.0
    a, b = high - golden * (high - low), low + golden * (high - low)
    at_a, at_b = value(a), value(b)
    for _ in range(CLOSER_STEPS):
        if at_a > at_b:
            high, b, at_b = b, a, at_a
            a = high - golden * (high - low)
            at_a = value(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + golden * (high - low)
            at_b = value(b)
    return max((at_a, a), (at_b, b))
