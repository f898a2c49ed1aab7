"""What flies beside the law, for many vehicles: `DisturbanceObserver` and `VelocityCorrection` of companion.core.estimation.

Every vehicle has a measurement in each period, so there are no gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.core.estimation.corrections import LARGEST_M_S, UNEXPLAINED_M
from companion.core.estimation.wind import (
    HOVER_RANGE_NORM,
    LARGEST_INNOVATION_M_S,
    MAX_DISTURBANCE_M_S2,
    MAX_DISTURBANCE_RATE_M_S3,
    MAX_HOVER_RATE_1_S,
    RESET_M_S,
    RESET_M_S2,
    THRUST_LAG_S,
)
from companion.geometry.vectors import between, shortened
from companion.types.values import GRAVITY_M_S2
from sitl.autopilots.autopilot import known_or
from sitl.autopilots.types import hover_thrust_norm
from sitl.batch.columns import Columns
from sitl.batch.packets import PERIOD_S
from sitl.flight.files import known_drag_1_s
from sitl.flight.scenario import Scenario

THRUST_FOLLOWS = 1.0 - exp(-PERIOD_S / THRUST_LAG_S)
LARGEST_JUMP_M_S = RESET_M_S + RESET_M_S2 * PERIOD_S


class DisturbanceObservers:
    """Estimates of all columns: `hover_norm` (B n,) and the horizontal `disturbance_enu_m_s2` (2, B n), changed in place.

    They begin as after some time of hovering in the mean wind; those that are off keep what the vehicle file says.
    """

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        bandwidths_1_s = np.array([scenario.fleet.law.disturbance_bandwidth_1_s for scenario in scenarios])
        settled = np.array([_settled(scenario) for scenario in scenarios])[columns.formation].T
        self.disturbance_enu_m_s2, self.hover_norm = settled[:2].copy(), settled[2].copy()
        pole = columns.spread(np.exp(-bandwidths_1_s * PERIOD_S).tolist())
        self._to_velocity, self._to_disturbance = 1.0 - pole**2, (1.0 - pole) ** 2 / PERIOD_S
        self._drag = 0.5 * PERIOD_S * columns.spread([known_drag_1_s(scenario) for scenario in scenarios])
        self._is_off = not bandwidths_1_s.any()
        self._last_enu_m_s = np.zeros((3, columns.count))  # measured
        self._velocity_enu_m_s = np.zeros((3, columns.count))  # of the model
        self._sent_norm, self._thrust_norm = np.zeros(columns.count), np.zeros(columns.count)
        self._thrust = np.zeros((3, columns.count))  # the last measured direction, times the thrust of the model

    def update(self, tick: int, group: slice, telemetry: FloatArray, sent_norm: FloatArray) -> None:
        """Correct the estimates of this group with one measurement (9, G) and the thrust (G,) sent before it."""
        if self._is_off:
            return
        measured, direction = telemetry[3:6], thrust_direction(telemetry[6:9])
        last, velocity = self._last_enu_m_s[:, group], self._velocity_enu_m_s[:, group]
        thrust_norm, thrust = self._thrust_norm[group], self._thrust[:, group]
        if tick == 0:
            velocity[:], thrust_norm[:], thrust[:] = measured, sent_norm, direction * sent_norm
        else:
            jump = measured - last
            jumps = np.abs(jump, out=jump).max(axis=0) > LARGEST_JUMP_M_S
            follows = (self._sent_norm[group] - thrust_norm) * THRUST_FOLLOWS
            if has_jumps := jumps.any():
                follows[jumps] = 0.0
            thrust_norm += follows
            thrusts = thrust.copy()
            np.multiply(direction, thrust_norm, out=thrust)
            thrusts += thrust
            predicted = self._moved(group, thrusts, last + measured)
            predicted += velocity
            if has_jumps:  # a reset of the autopilot's estimator
                predicted[:, jumps] = (velocity + measured - last)[:, jumps]
            error = limited(measured - predicted, LARGEST_INNOVATION_M_S)
            if has_jumps:
                error[:, jumps] = 0.0
            np.multiply(self._to_velocity[group], error, out=velocity)
            velocity += predicted
            self._correct(group, error)
        last[:], self._sent_norm[group] = measured, sent_norm

    def _moved(self, group: slice, thrusts: FloatArray, velocities_enu_m_s: FloatArray) -> FloatArray:
        """Change of the model's velocity in a period, by the sums of what was at its begin and at its end."""
        moved: FloatArray = thrusts * (0.5 * PERIOD_S * GRAVITY_M_S2 / self.hover_norm[group])
        moved -= self._drag[group] * velocities_enu_m_s
        moved[:2] += PERIOD_S * self.disturbance_enu_m_s2[:, group]
        moved[2] -= PERIOD_S * GRAVITY_M_S2
        return moved

    def _correct(self, group: slice, error_m_s: FloatArray) -> None:
        disturbance, hover_norm = self.disturbance_enu_m_s2[:, group], self.hover_norm[group]
        change = self._to_disturbance[group] * error_m_s
        disturbance += limited(change[:2], MAX_DISTURBANCE_RATE_M_S3 * PERIOD_S)
        shorten(disturbance, MAX_DISTURBANCE_M_S2)
        hover_norm *= 1.0 - limited(change[2] / GRAVITY_M_S2, MAX_HOVER_RATE_1_S * PERIOD_S)
        np.maximum(hover_norm, HOVER_RANGE_NORM[0], out=hover_norm)
        np.minimum(hover_norm, HOVER_RANGE_NORM[1], out=hover_norm)


def limited(values: FloatArray, most: float | FloatArray) -> FloatArray:
    """These values in [-most, most], in place: faster than numpy.clip."""
    np.minimum(values, most, out=values)
    np.maximum(values, -most, out=values)
    return values


def shorten(vectors: FloatArray, most: float) -> None:
    """Scale those (k, G) down to this length that are longer, in place."""
    squares = np.einsum("kg,kg->g", vectors, vectors)
    if not squares.max() <= most * most:
        vectors *= most / np.sqrt(np.maximum(squares, most * most))


def thrust_direction(euler_rad: FloatArray) -> FloatArray:
    """Upwards of the body in ENU (3, k) at this roll, pitch and yaw (3, k)."""
    (cos_roll, cos_pitch, cos_yaw), (sin_roll, sin_pitch, sin_yaw) = np.cos(euler_rad), np.sin(euler_rad)
    ahead = sin_pitch * cos_roll
    direction = np.empty_like(euler_rad)
    direction[0] = ahead * cos_yaw + sin_roll * sin_yaw
    direction[1] = ahead * sin_yaw - sin_roll * cos_yaw
    direction[2] = cos_pitch * cos_roll
    return direction


def _settled(scenario: Scenario) -> tuple[float, float, float]:
    """Disturbance (east, north) and hover thrust that fit a hover in the mean wind."""
    true_norm, airframe = hover_thrust_norm(scenario.stand_in), scenario.stand_in.airframe
    if scenario.fleet.law.disturbance_bandwidth_1_s == 0.0:
        return 0.0, 0.0, known_or(scenario.assumed.hover_thrust_norm, true_norm)
    x, y, z = (airframe.drag_n_per_m_s / airframe.mass_kg * wind for wind in scenario.stand_in.wind.mean_enu_m_s)
    share = max(0.1, 1.0 - z / GRAVITY_M_S2)  # of the true hover thrust: the wind carries the rest
    low, high = HOVER_RANGE_NORM
    x, y, _ = shortened((x / share, y / share, 0.0), MAX_DISTURBANCE_M_S2)
    return x, y, between(true_norm * share, low, high)


class VelocityCorrections:
    """Velocities that agree with the change of the reported positions, of all columns."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        bandwidths_1_s = np.array([scenario.fleet.law.velocity_correction_1_s for scenario in scenarios])
        pole = columns.spread(np.exp(-bandwidths_1_s * PERIOD_S).tolist())
        self._on_position, self._on_velocity_1_s = 1.0 - pole**2, (1.0 - pole) ** 2 / PERIOD_S
        # Where it is off the correction stays zero, whatever the error.
        peaks_m = [LARGEST_M_S / (exp(1.0) * w) if w > 0.0 else 0.0 for w in bandwidths_1_s.tolist()]
        self._largest_error_m2 = (UNEXPLAINED_M + columns.spread(peaks_m)) ** 2
        self._is_off = not bandwidths_1_s.any()
        self._correction_m_s = np.zeros((3, columns.count))
        self._filtered_m = np.zeros((3, columns.count))
        self._before_m_s = np.zeros((3, columns.count))  # velocity as reported

    def follow(self, tick: int, group: slice, telemetry: FloatArray) -> None:
        """Correct the velocities of this group's telemetry (9, G) in place. The first ones stay as they are."""
        if self._is_off:
            return
        position_m, velocity_m_s = telemetry[:3], telemetry[3:6]
        filtered_m, correction_m_s = self._filtered_m[:, group], self._correction_m_s[:, group]
        before_m_s = self._before_m_s[:, group]
        if tick == 0:
            filtered_m[:], before_m_s[:] = position_m, velocity_m_s
            return
        before_m_s += velocity_m_s
        before_m_s *= 0.5
        before_m_s += correction_m_s
        filtered_m += before_m_s * PERIOD_S
        before_m_s[:] = velocity_m_s
        error_m = position_m - filtered_m
        jumps = np.einsum("kg,kg->g", error_m, error_m) > self._largest_error_m2[group]
        if jumps.any():  # it moves the filtered position and leaves the correction as it is
            filtered_m[:, jumps], error_m[:, jumps] = position_m[:, jumps], 0.0
        filtered_m += self._on_position[group] * error_m
        correction_m_s += self._on_velocity_1_s[group] * error_m
        shorten(correction_m_s, LARGEST_M_S)
        velocity_m_s += correction_m_s
