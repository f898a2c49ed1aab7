"""Prediction of a formation's errors by the linear model in steps, and when an error has settled.

A vehicle is a double integrator behind a first-order lag (the attitude loop) and a delay
(telemetry, Zenoh, setpoint). Noise, saturation and real attitude control are left out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp

import numpy as np

from companion.analysis.interaction import Coupling, FloatArray
from companion.analysis.response import TICK_S, LinearModel

SUBSTEPS = 4
CHECK_TICKS = 50
DIVERGED_M = 1e6  # the prediction ends at this error, before an overflow
AT_REST = 1e-9  # and where no error, velocity or acceleration is larger than this, in m and s


def errors_over_time(
    coupling: Coupling, start_errors_m: FloatArray, model: LinearModel, duration_s: float
) -> FloatArray:
    """Errors e (ticks, n, axes) [m] from rest at `start_errors_m` (n, axes), every 0.02 s.

    u(k) = -K (G e(k)) + g W u(k - m), with m >= 1 ticks as the delay of the feed-forward. A command
    is held for a tick, which is half a tick of delay; the rest of `delay_s` is transport delay.
    Between commands the motion is exact.
    """
    gains, feedforward = coupling.law.gains, coupling.law.feedforward * coupling.W
    ticks = round(duration_s / TICK_S)
    motion = _motion_of_a_tick(model)
    state = np.zeros((3, start_errors_m.size))  # position, velocity and acceleration of each vehicle and axis
    state[0] = start_errors_m.ravel()
    nothing = np.zeros_like(start_errors_m, dtype=float)
    sent = deque([nothing] * (motion.whole_ticks + 2))  # from the oldest that still arrives to the newest
    arriving = np.zeros((2, start_errors_m.size))
    # Commands that have not reached the neighbours yet.
    fed_forward = deque([nothing] * max(1, round(model.feedforward_delay_s / TICK_S)))
    history = np.empty((ticks, *start_errors_m.shape))
    for tick in range(ticks):
        position, velocity = state[0].reshape(nothing.shape), state[1].reshape(nothing.shape)
        history[tick] = position
        if tick % CHECK_TICKS == 0 and _has_ended(state):
            history[tick:] = position
            break
        command = -(coupling.G @ (gains.position_1_s2 * position + gains.velocity_1_s * velocity))
        if coupling.law.feedforward > 0.0:
            command += feedforward @ fed_forward.popleft()
            fed_forward.append(command)
        sent.popleft()
        sent.append(command)
        arriving[0], arriving[1] = sent[0].ravel(), sent[1].ravel()
        state = motion.of_state @ state + motion.of_commands @ arriving
    return history


def _has_ended(state: FloatArray) -> bool:
    largest = np.abs(state).max()
    return bool(largest < AT_REST or np.abs(state[0]).max() > DIVERGED_M)


@dataclass(frozen=True, slots=True)
class _TickMotion:
    """Exact motion over a tick behind lag and delay: state' = `of_state` state + `of_commands` (older, newer command).

    The newer command was sent `whole_ticks` ticks ago, the older one a tick earlier.
    """

    of_state: FloatArray
    of_commands: FloatArray
    whole_ticks: int


def _motion_of_a_tick(model: LinearModel) -> _TickMotion:
    """A tick in SUBSTEPS. In the first of them the older command still arrives: the delay is no whole number of ticks."""
    dt_s, lag_s = TICK_S / SUBSTEPS, model.attitude_lag_s
    left = exp(-dt_s / lag_s) if lag_s > 0.0 else 0.0  # share of the acceleration's difference left after a substep
    left_for_s = lag_s * (1.0 - left)  # integral of that share over the substep
    left_for_s2 = lag_s * (dt_s - left_for_s)  # and its integral
    substep = np.array([[1.0, dt_s, left_for_s2], [0.0, 1.0, left_for_s], [0.0, 0.0, left]])
    effect = np.array([0.5 * dt_s**2 - left_for_s2, dt_s - left_for_s, 1.0 - left])
    transport_s = max(0.0, model.delay_s - 0.5 * TICK_S)
    whole_ticks, with_older = divmod(round(transport_s / dt_s), SUBSTEPS)
    of_state, of_commands = np.eye(3), np.zeros((3, 2))
    for index in range(SUBSTEPS):
        of_state, of_commands = substep @ of_state, substep @ of_commands
        of_commands[:, 0 if index < with_older else 1] += effect
    return _TickMotion(of_state, of_commands, whole_ticks)


def settled_after_s(errors_m: FloatArray, within_m: float) -> float | None:
    """Time from which every vehicle stays within `within_m` of its slot, s; None if never."""
    times_s = np.arange(len(errors_m), dtype=np.float64) * TICK_S
    return settle_time_s(times_s, np.linalg.norm(errors_m, axis=2).max(axis=1), within_m)


def transient_peak(errors_m: FloatArray) -> float:
    """Largest error of all vehicles and times over the largest error at the start, at least 1."""
    largest_m = np.linalg.norm(errors_m, axis=2).max(axis=1)
    return float(largest_m.max() / largest_m[0]) if largest_m[0] > 0.0 else 1.0


SETTLED_WITHIN_M = 0.10
STAY_S = 2.0


def settle_time_s(
    times_s: FloatArray, error_m: FloatArray, within_m: float = SETTLED_WITHIN_M, stay_s: float = STAY_S
) -> float | None:
    """Seconds from the first of evenly spaced times (n,) until the error (n,) stays within `within_m`.

    None if it is not inside for at least the last `stay_s`: an oscillation that is inside only at
    the end has not settled.
    """
    outside = np.flatnonzero(error_m > within_m)
    first_inside = int(outside[-1]) + 1 if outside.size else 0
    sample_s = float(times_s[1] - times_s[0]) if times_s.size > 1 else 0.0
    if first_inside == times_s.size or times_s[-1] - times_s[first_inside] < stay_s - sample_s / 2:
        return None
    return float(times_s[first_inside] - times_s[0])
