"""Prediction of a formation's errors: the linear model with attitude lag and loop delay, in steps.

A vehicle is a double integrator behind a first-order lag (the attitude loop) and a delay
(telemetry, Zenoh, setpoint). Noise, saturation and real attitude control are left out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp

import numpy as np

from companion.stability.arrays import FloatArray
from companion.stability.interaction import Coupling
from companion.stability.settling import settle_time_s

TICK_S = 0.02
SUBSTEPS = 4
DIVERGED_M = 1e6  # the prediction ends at this error, before an overflow


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Lag and delays of the loop; the defaults are measured values of PX4 and a local network.

    `delay_s` is the delay of the whole loop, including the half tick of the zero-order hold.
    `feedforward_delay_s` is the age of a neighbour's acceleration command at its use: one tick of
    the neighbour, and the network.
    """

    attitude_lag_s: float = 0.2
    delay_s: float = 0.05
    feedforward_delay_s: float = TICK_S


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
    dt_s = TICK_S / SUBSTEPS
    position, velocity = start_errors_m.astype(float), np.zeros_like(start_errors_m, dtype=float)
    acceleration = np.zeros_like(position)
    transport_s = max(0.0, model.delay_s - 0.5 * TICK_S)
    waiting = deque([np.zeros_like(position)] * round(transport_s / dt_s))  # commands not yet at the motors
    lag_s = model.attitude_lag_s
    left = exp(-dt_s / lag_s) if lag_s > 0.0 else 0.0  # share of a difference that is left after a substep
    left_for_s = lag_s * (1.0 - left)  # integral of that share over the substep
    # Commands that have not reached the neighbours yet.
    fed_forward = deque([np.zeros_like(position)] * max(1, round(model.feedforward_delay_s / TICK_S)))
    history = np.empty((ticks, *position.shape))
    for tick in range(ticks):
        history[tick] = position
        if np.abs(position).max() > DIVERGED_M:
            history[tick:] = position
            break
        command = -(coupling.G @ (gains.position_1_s2 * position + gains.velocity_1_s * velocity))
        if coupling.law.feedforward > 0.0:
            command += feedforward @ fed_forward.popleft()
            fed_forward.append(command)
        for _ in range(SUBSTEPS):
            waiting.append(command)
            arrived = waiting.popleft()
            beyond = acceleration - arrived
            position = position + velocity * dt_s + 0.5 * arrived * dt_s**2 + beyond * (lag_s * (dt_s - left_for_s))
            velocity = velocity + arrived * dt_s + beyond * left_for_s
            acceleration = arrived + beyond * left
    return history


def settled_after_s(errors_m: FloatArray, within_m: float) -> float | None:
    """Time from which every vehicle stays within `within_m` of its slot, s; None if never."""
    times_s = np.arange(len(errors_m), dtype=np.float64) * TICK_S
    return settle_time_s(times_s, np.linalg.norm(errors_m, axis=2).max(axis=1), within_m)


def transient_peak(errors_m: FloatArray) -> float:
    """Largest error of all vehicles and times over the largest error at the start, at least 1."""
    largest_m = np.linalg.norm(errors_m, axis=2).max(axis=1)
    return float(largest_m.max() / largest_m[0]) if largest_m[0] > 0.0 else 1.0
