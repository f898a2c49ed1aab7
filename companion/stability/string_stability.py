"""String stability: growth of a disturbance at the leader from level to level.

The smallest eigenvalue of G does not show this growth. y_i is the displacement of vehicle i. The
reference oscillates like sin(omega t), or an acceleration disturbs the leaders only. With one leader
both inputs give the same ratios of y, because the equations of the followers contain y alone. At
low frequencies all vehicles follow and all ratios are 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log, pi, sqrt

import numpy as np

from companion.stability.arrays import ComplexArray, FloatArray
from companion.stability.interaction import Coupling, mode_eigenvalues
from companion.stability.prediction import LinearModel
from companion.stability.state_space import is_stable

POINTS_PER_DECADE = 80
PEAKS = 5  # number of grid peaks that are refined
REFINING_STEPS = 24
FAINT = 1e-6  # share of the leader's amplitude; levels below it are left out


@dataclass(frozen=True, slots=True)
class StringGains:
    """H-infinity norms: largest amplitude ratios over all frequencies, at least 1.

    The amplitude of a level is the largest |y_i| of the vehicles with that PrC. `per_hop` is the
    largest ratio of a level's amplitude to that of the level before. `to_last` is the ratio of the
    farthest level to the leaders. Each has the frequency at which it occurs.
    """

    per_hop: float
    per_hop_rad_s: float
    to_last: float
    to_last_rad_s: float


def response(coupling: Coupling, model: LinearModel, omega_rad_s: float) -> ComplexArray:
    """y (n,) for a reference that oscillates by 1 m at this frequency.

    s^2 (1 + sT) e^{sd} y = u and u = -(k1 + k2 s)(G y - L r) + g W e^{-s tau} u + g s^2 L r, with L = 1 for leaders, hence
    [(I - g W e^{-s tau}) s^2 (1 + sT) e^{sd} + (k1 + k2 s) G] y = (k1 + k2 s + g s^2) L r.
    """
    s = 1j * omega_rad_s
    law = coupling.law
    feedback = law.gains.position_1_s2 + law.gains.velocity_1_s * s
    vehicle = s * s * (1.0 + s * model.attitude_lag_s) * np.exp(s * model.delay_s)
    forward = law.feedforward * np.exp(-s * model.feedforward_delay_s)
    left = vehicle * (np.eye(len(coupling.G)) - forward * coupling.W) + feedback * coupling.G
    right = (feedback + law.feedforward * s * s) * coupling.is_leader
    return np.asarray(np.linalg.solve(left, right), dtype=np.complex128)


def string_gains(coupling: Coupling, model: LinearModel) -> StringGains | None:
    """Gains of a formation; None if all vehicles are leaders or the formation is unstable.

    Every vehicle must have a path to a leader.
    """
    levels = [np.flatnonzero(coupling.prcs == p) for p in range(1, int(coupling.prcs.max()) + 1)]
    if len(levels) < 2 or not is_stable(coupling, model):
        return None

    def ratios(log_omega: float) -> tuple[float, float]:
        amplitudes = np.abs(response(coupling, model, exp(log_omega)))
        by_level = np.array([amplitudes[level].max() for level in levels])
        clear = by_level[:-1] > FAINT * by_level[0]
        return float((by_level[1:][clear] / by_level[:-1][clear]).max()), float(by_level[-1] / by_level[0])

    grid = _grid(coupling)
    values = np.array([ratios(float(x)) for x in grid])
    per_hop, per_hop_at = _largest(lambda x: ratios(x)[0], grid, values[:, 0])
    to_last, to_last_at = _largest(lambda x: ratios(x)[1], grid, values[:, 1])
    return StringGains(max(1.0, per_hop), exp(per_hop_at), max(1.0, to_last), exp(to_last_at))


def _grid(coupling: Coupling) -> FloatArray:
    """log(omega) from 1/10 of the slowest mode, sqrt(k1 mu), to 10 Hz, too fast for any vehicle."""
    k1 = coupling.law.gains.position_1_s2
    slowest = max(float(mode_eigenvalues(coupling)[0]), 1e-9)
    low, high = log(0.1 * sqrt(k1 * slowest)), log(20.0 * pi)
    return np.linspace(low, high, round(POINTS_PER_DECADE * (high - low) / log(10.0)))


def _largest(value: Callable[[float], float], grid: FloatArray, values: FloatArray) -> tuple[float, float]:
    """(largest value, its argument), refined around the highest peaks of the grid.

    The peak of a badly damped mode is narrower than the grid.
    """
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
    for _ in range(REFINING_STEPS):
        if at_a > at_b:
            high, b, at_b = b, a, at_a
            a = high - golden * (high - low)
            at_a = value(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + golden * (high - low)
            at_b = value(b)
    return max((at_a, a), (at_b, b))
