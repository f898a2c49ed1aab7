"""What a formation will do before anyone flies it: the linear model with attitude lag and loop delay, step by step.

Vehicles are double integrators behind a first-order lag (the attitude loop) and a delay (telemetry, Zenoh, setpoint). Noise,
saturation and real attitude control are left out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp

import numpy as np

from companion.core.arrays import FloatArray
from companion.core.interaction import Coupling
from companion.core.settling import settle_time_s

TICK_S = 0.02
SUBSTEPS = 4
LOST_M = 1e6  # errors beyond this have long been a failure; they are not followed until numbers end


@dataclass(frozen=True, slots=True)
class LinearModel:
    """`attitude_lag_s` and `delay_s` default to what PX4 and a local network were measured to have.

    `delay_s` is the whole of the loop's, that of holding a command from tick to tick included. `feedforward_delay_s` is the
    age of a neighbour's acceleration command when it is added to the own one: a tick of the neighbour, and the network.
    """

    attitude_lag_s: float = 0.2
    delay_s: float = 0.05
    feedforward_delay_s: float = TICK_S


def errors_over_time(
    coupling: Coupling, start_errors_m: FloatArray, model: LinearModel, duration_s: float
) -> FloatArray:
    """Errors e (ticks, n, axes) [m] from rest at `start_errors_m` (n, axes), every 0.02 s.

    u(k) = -K (G e(k)) + g W u(k - m), where m >= 1 ticks make the feed-forward's delay. Commands are held for a tick, which
    is half a tick of delay: the rest of `delay_s` they are under way. Between commands the motion is exact.
    """
    gains, feedforward = coupling.law.gains, coupling.law.feedforward * coupling.W
    ticks = round(duration_s / TICK_S)
    dt_s = TICK_S / SUBSTEPS
    position, velocity = start_errors_m.astype(float), np.zeros_like(start_errors_m, dtype=float)
    acceleration = np.zeros_like(position)
    under_way_s = max(0.0, model.delay_s - 0.5 * TICK_S)
    waiting = deque([np.zeros_like(position)] * round(under_way_s / dt_s))  # commands on their way to the motors
    lag_s = model.attitude_lag_s
    left = exp(-dt_s / lag_s) if lag_s > 0.0 else 0.0  # after a step, of what was there beyond the command
    left_for_s = lag_s * (1.0 - left)  # as long it would act if it stayed whole
    heard = deque(
        [np.zeros_like(position)] * max(1, round(model.feedforward_delay_s / TICK_S))
    )  # and to the neighbours
    history = np.empty((ticks, *position.shape))
    for tick in range(ticks):
        history[tick] = position
        if np.abs(position).max() > LOST_M:
            history[tick:] = position
            break
        command = -(coupling.G @ (gains.position_1_s2 * position + gains.velocity_1_s * velocity))
        if coupling.law.feedforward > 0.0:
            command += feedforward @ heard.popleft()
            heard.append(command)
        for _ in range(SUBSTEPS):
            waiting.append(command)
            arrived = waiting.popleft()
            beyond = acceleration - arrived
            position = position + velocity * dt_s + 0.5 * arrived * dt_s**2 + beyond * (lag_s * (dt_s - left_for_s))
            velocity = velocity + arrived * dt_s + beyond * left_for_s
            acceleration = arrived + beyond * left
    return history


def settled_after_s(errors_m: FloatArray, within_m: float) -> float | None:
    """From when on every vehicle stays within `within_m` of its place; None where that does not come."""
    times_s = np.arange(len(errors_m), dtype=np.float64) * TICK_S
    return settle_time_s(times_s, np.linalg.norm(errors_m, axis=2).max(axis=1), within_m)


def transient_peak(errors_m: FloatArray) -> float:
    """The largest error of any vehicle at any time over the largest at the start; 1 where nothing ever grows past that."""
    largest_m = np.linalg.norm(errors_m, axis=2).max(axis=1)
    return float(largest_m.max() / largest_m[0]) if largest_m[0] > 0.0 else 1.0
