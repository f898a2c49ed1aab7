"""companion.core.control.attitude and core.safety.output_limits for many vehicles: acceleration -> limited targets."""

from __future__ import annotations

from collections.abc import Sequence
from math import radians, tan

import numpy as np

from companion.stability.arrays import FloatArray
from companion.types.values import GRAVITY_M_S2
from sitl.batch.columns import Columns
from sitl.batch.rotations import quaternion_of_euler
from sitl.flight.scenario import Scenario


class Commands:
    """The last admitted roll, pitch and thrust of all columns. Yaw stays at its initial value.

    The output limits see no gaps here: every vehicle ticks once in a period.
    """

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, period_s: float) -> None:
        envelopes = [scenario.fleet.envelope for scenario in scenarios]
        hover = columns.spread([scenario.stand_in.hover_thrust_norm for scenario in scenarios])
        tilt_rad = columns.spread([radians(e.max_tilt_deg) for e in envelopes])
        least = columns.spread([e.min_thrust_ratio for e in envelopes])
        most = columns.spread([e.max_thrust_ratio for e in envelopes])
        self.hover_norm = hover
        self._max_tilt_rad = tilt_rad
        self._tan_tilt = columns.spread([tan(radians(e.max_tilt_deg)) for e in envelopes])
        self._least_lift, self._most_lift = least * GRAVITY_M_S2, most * GRAVITY_M_S2
        self._least_norm, self._most_norm = hover * least, np.minimum(1.0, hover * most)
        turn_rad = columns.spread([radians(e.max_tilt_rate_deg_s) * period_s for e in envelopes])
        thrust = columns.spread([e.max_thrust_rate_1_s * period_s for e in envelopes]) * hover
        self._most_change = np.stack([turn_rad, turn_rad, thrust])
        self._yaw_rad = np.zeros(columns.count)
        self._last = np.zeros((3, columns.count))

    def open_at(self, euler_rad: FloatArray) -> None:
        """Start from the estimated attitudes (3, B n)."""
        self._yaw_rad = euler_rad[2].copy()
        share = np.maximum(0.5, np.cos(euler_rad[0]) * np.cos(euler_rad[1]))
        all_columns = slice(0, self._yaw_rad.size)
        self._last = self._within_limits(np.stack([euler_rad[0], euler_rad[1], self.hover_norm / share]), all_columns)

    def limit(self, acceleration: FloatArray, group: slice) -> None:
        """limit_acceleration on (3, G), in place."""
        lift = np.clip(acceleration[2] + GRAVITY_M_S2, self._least_lift[group], self._most_lift[group])
        level = np.hypot(acceleration[0], acceleration[1])
        most = lift * self._tan_tilt[group]
        acceleration[:2] *= most / np.maximum(level, most)
        np.subtract(lift, GRAVITY_M_S2, out=acceleration[2])

    def admitted(
        self, acceleration: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray, group: slice
    ) -> FloatArray:
        """attitude_target and OutputLimiter.admit: (5, G) quaternion and thrust.

        Repeats the last targets of a vehicle that is tilted by more than 90 degrees.
        """
        lift = acceleration[2] + GRAVITY_M_S2
        vertical_share = np.cos(pitch_rad) * np.cos(roll_rad)
        flies = vertical_share > 0.0
        ax, ay = acceleration[:2] / lift
        yaw = self._yaw_rad[group]
        cos_yaw, sin_yaw = np.cos(yaw), np.sin(yaw)
        wanted = np.empty((3, lift.size))
        np.arctan(ax * cos_yaw + ay * sin_yaw, out=wanted[1])
        np.arctan(np.cos(wanted[1]) * (ax * sin_yaw - ay * cos_yaw), out=wanted[0])
        np.divide(self.hover_norm[group] * lift, GRAVITY_M_S2 * np.where(flies, vertical_share, 1.0), out=wanted[2])
        last, most_change = self._last[:, group], self._most_change[:, group]
        change = self._within_limits(wanted, group) - last
        np.clip(change, -most_change, most_change, out=change)
        change *= flies
        last += change
        last[:] = self._within_limits(last, group)
        return self.targets(group)

    def targets(self, group: slice) -> FloatArray:
        """The last admitted targets: (5, G) quaternion (FLU to ENU) and thrust in 0..1."""
        roll, pitch, thrust = self._last[:, group]
        return np.vstack([quaternion_of_euler(roll, pitch, self._yaw_rad[group]), thrust])

    def _within_limits(self, targets: FloatArray, group: slice) -> FloatArray:
        limited = np.empty_like(targets)
        most = self._max_tilt_rad[group]
        tilt = np.maximum(np.hypot(targets[0], targets[1]), most)
        np.multiply(targets[:2], most / tilt, out=limited[:2])
        np.clip(targets[2], self._least_norm[group], self._most_norm[group], out=limited[2])
        return limited
