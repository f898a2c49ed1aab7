"""Stability of the linear model: its state matrix x' = A x, the worst transient peak, delay margins and string stability.

Delays are first-order Pade filters, (1 - s d/2) / (1 + s d/2). Their phase matches the delay up to
1/d and beyond, which is faster than any formation responds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from itertools import pairwise
from math import atan2, exp, inf, log, pi, sqrt

import numpy as np

from companion.analysis.interaction import (
    ComplexArray,
    Coupling,
    FloatArray,
    eigenvalues,
    lag_margin_s,
    mode_eigenvalues,
    mode_figures,
)
from companion.analysis.response import LinearModel
from companion.core.consensus.law import Gains

SHORTEST_S = 1e-3  # lower limit of lag and delays, so that every filter has a state
STEP_S = 0.1
# (factor of the step length, number of steps): waves along a chain come before slow oscillations
WATCHED = ((1, 150), (5, 300), (8, 60))


def state_matrix(coupling: Coupling, model: LinearModel) -> FloatArray:
    """A (5n, 5n) of x = [e, e', e'', z, z_f]; z filters the command on its way to the motors.

    z_f filters the command on its way to the neighbours. The output of a Pade filter is 2 z - input,
    with z' = (2/d)(input - z): u = -K (G e) + g W (2 z_f - u), so
    (I + g W) u = -G (k1 e + k2 e') + 2 g W z_f, which can be solved because g < 1.
    """
    n = len(coupling.G)
    one, zero = np.eye(n), np.zeros((n, n))
    gains = coupling.law.gains
    lag_s, delay_s, forward_delay_s = (
        max(value, SHORTEST_S) for value in (model.attitude_lag_s, model.delay_s, model.feedforward_delay_s)
    )
    forward = coupling.law.feedforward * coupling.W
    to_u = np.linalg.inv(one + forward)
    fed_back = -to_u @ coupling.G
    u = np.hstack([gains.position_1_s2 * fed_back, gains.velocity_1_s * fed_back, zero, zero, 2.0 * to_u @ forward])
    e2 = np.hstack([zero, zero, one, zero, zero])
    to_motors = np.hstack([zero, zero, zero, one, zero])
    to_neighbours = np.hstack([zero, zero, zero, zero, one])
    velocity = np.hstack([zero, one, zero, zero, zero])
    return np.vstack(
        [
            velocity,
            e2,
            (2.0 * to_motors - u - e2) / lag_s,
            (u - to_motors) * (2.0 / delay_s),
            (u - to_neighbours) * (2.0 / forward_delay_s),
        ]
    )


def is_stable(coupling: Coupling, model: LinearModel) -> bool:
    """Whether all errors of the coupled system decay.

    Without feed-forward each eigenvalue of G is checked as a system of its own.
    """
    systems = [coupling]
    if coupling.law.feedforward == 0.0:
        alone = np.zeros((1, 1))
        systems = [replace(coupling, G=np.array([[value]]), W=alone) for value in eigenvalues(coupling.G)]
    return all(np.linalg.eigvals(state_matrix(system, model)).real.max() < 0.0 for system in systems)


def worst_transient_peak(coupling: Coupling, model: LinearModel) -> float | None:
    """sup over t of |exp(A t)|, positions to positions, in the maximum norm; None if A is unstable.

    It is the largest error [m] that a start from rest with errors up to 1 m can lead to.
    """
    if not is_stable(coupling, model):
        return None
    n = len(coupling.G)
    matrix = state_matrix(coupling, model)
    states = np.vstack([np.eye(n), np.zeros((4 * n, n))])
    peak = 1.0
    transition = _exponential(matrix * STEP_S)
    for longer, steps in WATCHED:
        transition = np.linalg.matrix_power(transition, longer)
        for _ in range(steps):
            states = transition @ states
            peak = max(peak, float(np.abs(states[:n]).sum(axis=1).max()))
    return peak


def _exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential by scaling and squaring of a Taylor series."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(matrix).sum(axis=1).max(), 1e-300)))) + 2)
    small = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, 13):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


COARSE, PER_E_FOLD = 24, 6  # minimum number of grid points, in total and per e-fold
CLOSE = 1e-6  # relative width of the frequency interval at which the search ends


def delay_margin_with_lag_s(coupling: Coupling, model: LinearModel) -> float:
    """The smallest loop delay d at which a mode is undamped, s; 0 if the lag alone is unstable.

    A root of det(I + Lambda(s) e^{-sd}) = 0 reaches the imaginary axis at s = j omega if an
    eigenvalue of Lambda has modulus 1 and d = (pi + arg) / omega. For a system that is stable at
    d = 0 the margin is the smallest such d. `model.delay_s` is not used.

    The loop is Lambda(s) e^{-sd} with Lambda = N (k1 + k2 s) / (s^2 (1 + sT)) and N = (I - g W e^{-s tau})^-1 G. Without
    feed-forward N = G: each eigenvalue has its own loop, and its margin has a closed form. With feed-forward the eigenvalues of
    N depend on the frequency, and the margin is found by a search.
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

    The smallest eigenvalue of G does not show this growth. y_i is the displacement of vehicle i. The reference oscillates like
    sin(omega t), or an acceleration disturbs the leaders only. With one leader both inputs give the same ratios of y, because
    the equations of the followers contain y alone. At low frequencies all vehicles follow and all ratios are 1.
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
