"""Stability of the linear model: whether its errors decay, delay margins and string stability."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import exp, inf, log, log10, pi, sqrt

import numpy as np

from companion.analysis.interaction import ComplexArray, Coupling, FloatArray
from companion.analysis.loop import AT_ORIGIN_1_S
from companion.analysis.response import TICK_S, LinearModel

NOTHING = 1e-12  # an eigenvalue or pole at zero
ALL = 1.0 + 1e-9  # of what is handed on, with rounding: more would grow by itself
SAMPLED_RAD_S = 0.9 * pi / TICK_S  # below half the rate of the ticks
LEAST_LAST_RAD_S = 80.0
SLOWER = 0.02  # times the lowest frequency at which anything turns
PER_DECADE = 30  # grid points
TURN_RAD = 0.8  # largest turn of a factor between two frequencies
BEND_RAD = 0.1  # and by which two turns may differ: a root of two pivots at once turns by nothing or by a whole turn
REFINEMENTS = 20
SPLITS = np.array([[0.25], [0.5], [0.75]])  # of a step that is too wide
FIRST_DELAY_S, MOST_DELAY_S, CLOSE = 0.02, 1000.0, 5e-4  # search for the margin, and its relative accuracy


def is_stable(coupling: Coupling, model: LinearModel) -> bool:
    """Whether all errors of the coupled system decay.

    By the argument principle: the determinant over (s + a)^2n is positive at s = 0, and has no pole on the right. At high
    frequencies it is that of what laws hand on to each other. From 0 to there it turns by -pi more than that for every root on
    the right, and by as much where there is none.
    """
    loop = coupling.loop
    position, velocity, handed_on = loop.gains
    if np.abs(coupling.spectrum).min() < NOTHING or (handed_on > ALL and coupling.hands_on > ALL):
        return False
    omega = _grid_rad_s(coupling, model, position, velocity, handed_on)
    whole = _followed(lambda at: loop.pivots(at, model), omega)
    # Without gain the pivots are those of each memory and of what little is handed on: they begin on the right of zero, and
    # remain there unless more than ALL is handed on.
    rest = _followed(lambda at: loop.pivots_without_gain(at, model), omega if handed_on > ALL else omega[-1:])
    if whole is None or rest is None:
        return False
    s = 1j * omega[-1]
    moved = len(coupling.prcs) * np.angle(s * (s + model.drag_1_s) / (s + AT_ORIGIN_1_S) ** 2)
    argument, expected = np.angle(whole[0].prod()) + whole[1], np.angle(rest[0]).sum() + rest[1] + moved
    return bool(abs(argument - expected) < 0.5 * pi)


def _followed(pivots: Callable[[FloatArray], ComplexArray], omega: FloatArray) -> tuple[ComplexArray, float] | None:
    """Their directions at the first frequency, and by how much all turn up to the last; None with a root on the axis."""

    def directions(at: FloatArray) -> ComplexArray:
        found = pivots(at)
        return np.asarray(found / np.abs(found), dtype=np.complex128)

    found = directions(omega)
    for _ in range(REFINEMENTS):
        turns, steps = np.angle(found[1:] / found[:-1]), np.diff(np.log(omega))
        bends = np.abs(np.diff(turns / steps[:, np.newaxis], axis=0)).max(axis=1) * np.minimum(steps[1:], steps[:-1])
        bent = np.concatenate([[0.0], bends, [0.0]])
        wide = np.flatnonzero((np.abs(turns).max(axis=1) > TURN_RAD) | (np.maximum(bent[1:], bent[:-1]) > BEND_RAD))
        if not wide.size:
            return found[0], float(turns.sum())
        between = (omega[wide] + SPLITS * (omega[wide + 1] - omega[wide])).ravel()
        order = np.argsort(omega := np.concatenate([omega, between]))
        omega, found = omega[order], np.concatenate([found, directions(between)])[order]
    return None


def _grid_rad_s(
    coupling: Coupling, model: LinearModel, position: float, velocity: float, handed_on: float
) -> FloatArray:
    """From below the slowest mode to where the loop has no gain left."""
    speeds = np.abs(coupling.modes)
    first, last = SLOWER * min(1.0, float(speeds[speeds > NOTHING].min(initial=1.0))), LEAST_LAST_RAD_S
    grown = len(coupling.prcs) / max(1.0 - handed_on, 0.01)
    while abs((position + 1j * velocity * last) * model.flown_share(1j * last)) / last**2 * grown > 0.5:
        last *= 1.5
    if coupling.law.memory:  # beyond, a state that is sampled has poles of its own, at every multiple of its rate
        last = min(last, SAMPLED_RAD_S)
    turning_s = max(model.feedforward_delay_s, model.neighbour_delay_s, TICK_S if coupling.law.memory else 0.0)
    even = np.arange(1.0, 1.0 + turning_s * last) / turning_s if turning_s > 0.0 else np.empty(0)
    return np.unique(np.concatenate([np.geomspace(first, last, round(PER_DECADE * log10(last / first))), even]))


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


IDEAL = LinearModel(0.0, 0.0, 0.0)  # without lag and link


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
        amplitudes = np.abs(coupling.loop.response(exp(log_omega), model))
        by_level = np.array([amplitudes[level].max() for level in levels])
        clear = by_level[:-1] > FAINT * by_level[0]
        return float((by_level[1:][clear] / by_level[:-1][clear]).max()), float(by_level[-1] / by_level[0])

    grid = _grid(coupling)
    values = np.array([ratios(float(x)) for x in grid])
    per_hop, per_hop_at = _largest(lambda x: ratios(x)[0], grid, values[:, 0])
    to_last, to_last_at = _largest(lambda x: ratios(x)[1], grid, values[:, 1])
    return StringGains(max(1.0, per_hop), exp(per_hop_at), max(1.0, to_last), exp(to_last_at))


def _grid(coupling: Coupling) -> FloatArray:
    """log(omega) from 1/10 of the slowest mode to 10 Hz, too fast for any vehicle."""
    speeds = np.abs(coupling.modes)
    low, high = log(0.1 * float(speeds[speeds > NOTHING].min())), log(20.0 * pi)
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
