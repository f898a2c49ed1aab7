"""What a formation will do before anyone flies it: the linear model with attitude lag and loop delay, step by step.

Vehicles are double integrators behind a first-order lag (the attitude loop) and a delay (telemetry, Zenoh, setpoint). Noise,
saturation and real attitude control are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.formation import Gains

FloatArray = NDArray[np.float64]
TICK_S = 0.02
SUBSTEPS = 4


@dataclass(frozen=True, slots=True)
class LinearModel:
    """`attitude_lag_s` and `delay_s` default to what PX4 and a local network were measured to have."""

    attitude_lag_s: float = 0.2
    delay_s: float = 0.05


def errors_over_time(
    matrix: FloatArray, gains: Gains, start_errors_m: FloatArray, model: LinearModel, duration_s: float
) -> FloatArray:
    """Errors e (ticks, n, axes) [m] under u = -K (G e) from rest at `start_errors_m` (n, axes), every 0.02 s."""
    ticks = round(duration_s / TICK_S)
    delay_ticks = round(model.delay_s / TICK_S * SUBSTEPS)
    dt_s = TICK_S / SUBSTEPS
    position, velocity = start_errors_m.astype(float), np.zeros_like(start_errors_m, dtype=float)
    acceleration = np.zeros_like(position)
    waiting = [np.zeros_like(position)] * (delay_ticks + 1)  # commands on their way
    history = np.empty((ticks, *position.shape))
    for tick in range(ticks):
        history[tick] = position
        command = -(matrix @ (gains.position_1_s2 * position + gains.velocity_1_s * velocity))
        for _ in range(SUBSTEPS):
            waiting.append(command)
            arrived = waiting.pop(0)
            if model.attitude_lag_s > 0.0:
                acceleration = acceleration + (arrived - acceleration) * (dt_s / model.attitude_lag_s)
            else:
                acceleration = arrived
            position = position + velocity * dt_s + 0.5 * acceleration * dt_s**2
            velocity = velocity + acceleration * dt_s
    return history


def settled_after_s(errors_m: FloatArray, within_m: float) -> float | None:
    """From when on every vehicle stays within `within_m` of its place; None where that does not come."""
    outside = np.flatnonzero(np.linalg.norm(errors_m, axis=2).max(axis=1) > within_m)
    if outside.size == 0:
        return 0.0
    if outside[-1] == len(errors_m) - 1:
        return None
    return float(outside[-1] + 1) * TICK_S
