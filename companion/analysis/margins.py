"""Stability of the linear model: whether its errors decay, delay margins and string stability."""

from __future__ import annotations

from cmath import phase
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import exp, inf, log, log10, pi, sqrt

import numpy as np

from companion.analysis.interaction import (
    ComplexArray,
    Coupling,
    FloatArray,
    eigenvalues,
    mode_eigenvalues,
    symmetric_like,
)
from companion.analysis.response import LinearModel

AT_ORIGIN_1_S = 2.0  # (s + AT_ORIGIN_1_S)^2 makes each factor finite at all frequencies
LEAST_LAST_RAD_S = 80.0
SLOWER = 0.02  # times the lowest frequency at which anything turns
PER_DECADE = 30  # grid points
TURN_RAD = 0.8  # largest turn of a factor between two frequencies
HALVINGS = 40
FIRST_DELAY_S, MOST_DELAY_S, CLOSE = 0.02, 1000.0, 5e-4  # search for the margin, and its relative accuracy


class _Loop:
    """Factors of det(plant (I - g z_l F) + feedback (D - z_m W)), with z = e^{-s age} of the neighbours' commands and states.

    In the symmetric form of Lemma 2 the weights are W = V mu V'. With L of leaders that use neighbours D = I + L and
    F = (I - L) W, so all but L has the eigenvectors V, and its determinant is a product: O(n) at a frequency, not O(n^3).
    What L adds is a matrix of the size of its leaders.
    """

    def __init__(self, coupling: Coupling, model: LinearModel) -> None:
        symmetric = symmetric_like(coupling.G)
        own = np.diag(symmetric)
        self._mu, vectors = np.linalg.eigh(np.diag(own) - symmetric)
        self._leading = vectors[own > 1.5]
        self._law, self._model = coupling.law, model

    def directions(self, omega_rad_s: FloatArray) -> ComplexArray:
        """The factors, over their moduli, at these frequencies (k, n + 1)."""
        s = np.asarray(1j * omega_rad_s, dtype=np.complex128)[:, np.newaxis]
        model, mu = self._model, self._mu
        plant = s * (s + model.drag_1_s)
        fed_back = self._feedback(s) * np.exp(-s * model.delay_s)
        forward = self._law.feedforward * np.exp(-s * model.feedforward_delay_s)
        without = 1.0 - forward * mu
        modes = plant * without + fed_back * (1.0 - np.exp(-s * model.neighbour_delay_s) * mu)
        of_leaders = self._of_leaders((fed_back + plant * forward * mu) / modes)
        of_leaders /= self._of_leaders(forward * mu / without)
        factors = np.hstack([modes / without / (s + AT_ORIGIN_1_S) ** 2, of_leaders[:, np.newaxis]])
        return np.asarray(factors / np.abs(factors), dtype=np.complex128)

    def _of_leaders(self, values: ComplexArray) -> ComplexArray:
        """det(I + V_L values V_L') (k,)."""
        rows = self._leading
        return np.asarray(np.linalg.det(np.eye(len(rows)) + (rows * values[:, np.newaxis, :]) @ rows.T))

    def _feedback(self, s: ComplexArray) -> ComplexArray:
        """(k1 + k2 s) and the lag, without the delay."""
        gains = self._law.gains
        return np.asarray((gains.position_1_s2 + gains.velocity_1_s * s) * self._model.flown_share(s))

    def last_rad_s(self) -> float:
        """A frequency from which on the loop has no gain left."""
        omega_rad_s = LEAST_LAST_RAD_S
        while True:
            s = np.array([1j * omega_rad_s])
            gain = abs(self._feedback(s)[0]) / omega_rad_s**2
            if gain * 3.0 / (1.0 - self._law.feedforward) * len(self._mu) < 0.5:
                return omega_rad_s
            omega_rad_s *= 1.5

    def left_of(self, omega_rad_s: float) -> float:
        """The argument at a frequency from which on the loop has no gain: that to infinity is left."""
        s = 1j * omega_rad_s
        return len(self._mu) * phase(s * (s + self._model.drag_1_s) / (s + AT_ORIGIN_1_S) ** 2)

    def grid_rad_s(self, slowest: float) -> FloatArray:
        gains, model = self._law.gains, self._model
        k1, k2 = gains.position_1_s2, gains.velocity_1_s
        first, last = SLOWER * min(1.0, sqrt(k1 * slowest), k1 / k2), self.last_rad_s()
        turning_s = max(model.feedforward_delay_s, model.neighbour_delay_s)
        even = np.arange(1.0, 1.0 + turning_s * last) / turning_s if turning_s > 0.0 else np.empty(0)
        return np.unique(np.concatenate([np.geomspace(first, last, round(PER_DECADE * log10(last / first))), even]))


def is_stable(coupling: Coupling, model: LinearModel) -> bool:
    """Whether all errors of the coupled system decay.

    By the argument principle: the determinant of `_Loop` over (s + a)^2n is 1 at infinity, positive at s = 0, and has no
    pole on the right. So its argument changes by -pi over the frequencies from 0 on for every root there, and by nothing where
    there is none.
    """
    slowest = float(eigenvalues(coupling.G)[0])
    if slowest <= 0.0:
        return False
    loop = _Loop(coupling, model)
    omega = loop.grid_rad_s(slowest)
    directions = loop.directions(omega)
    for _ in range(HALVINGS):
        turns = np.angle(directions[1:] / directions[:-1])
        wide = np.flatnonzero(np.abs(turns).max(axis=1) > TURN_RAD)
        if not wide.size:
            argument = float(np.angle(directions[0].prod()) + turns.sum())
            return abs(argument - loop.left_of(float(omega[-1]))) < 0.5 * pi
        between = 0.5 * (omega[wide] + omega[wide + 1])
        omega = np.insert(omega, wide + 1, between)
        directions = np.insert(directions, wide + 1, loop.directions(between), axis=0)
    return False  # a root on the axis


def delay_margin_with_lag_s(coupling: Coupling, model: LinearModel) -> float:
    """The loop delay d from which on it is unstable, s; 0 if it is unstable without one. `model.delay_s` is not used."""
    return least_delay_margin_s([coupling], [model])


def least_delay_margin_s(couplings: Sequence[Coupling], models: Sequence[LinearModel]) -> float:
    """The smallest margin of these couplings with these models."""
    least_s = inf
    for coupling, model in product(couplings, models):

        def stable_with(delay_s: float, coupling: Coupling = coupling, model: LinearModel = model) -> bool:
            return is_stable(coupling, replace(model, delay_s=delay_s))

        if least_s == inf or not stable_with(least_s):
            least_s = _last(stable_with)
    return least_s


def _last(holds: Callable[[float], bool]) -> float:
    """The largest value up to which it holds; 0 if it never does."""
    if not holds(0.0):
        return 0.0
    low, high = 0.0, FIRST_DELAY_S
    while high < MOST_DELAY_S and holds(high):
        low, high = high, 1.5 * high
    while high - low > CLOSE * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def are_stable(couplings: Sequence[Coupling], models: Sequence[LinearModel], delay_s: float) -> bool:
    """Whether all these couplings are stable with all these models and this loop delay."""
    return all(is_stable(one, replace(model, delay_s=delay_s)) for one, model in product(couplings, models))


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

    (s^2 + c s) e^{sd} / H y = u, where H is the lag, and u = -(k1 + k2 s)((D - W e^{-s m}) y - L r) + g W e^{-s l} u
    + g (s^2 + c s) L r, with L = 1 for leaders, hence [(I - g W e^{-s l}) (s^2 + c s) e^{sd} / H
    + (k1 + k2 s)(D - W e^{-s m})] y = (k1 + k2 s + g (s^2 + c s)) L r.
    """
    s = 1j * omega_rad_s
    law = coupling.law
    feedback = law.position_gain_1_s2 + law.velocity_gain_1_s * s
    plant = s * (s + model.drag_1_s)
    vehicle = plant * np.exp(s * model.delay_s) / model.flown_share(s)
    forward = law.feedforward * np.exp(-s * model.feedforward_delay_s)
    own = np.diag(np.diag(coupling.G))
    loop = own - (own - coupling.G) * np.exp(-s * model.neighbour_delay_s)
    left = vehicle * (np.eye(len(coupling.G)) - forward * coupling.W) + feedback * loop
    right = (feedback + law.feedforward * plant) * coupling.is_leader
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
    k1 = coupling.law.position_gain_1_s2
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
