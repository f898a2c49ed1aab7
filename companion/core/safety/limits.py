"""Output limits: the last stage before MAVLink. Every attitude setpoint passes through it."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, isfinite, pi

from companion.geometry.airspace import Fence
from companion.geometry.frames import wrap_pi
from companion.geometry.vectors import between, clamped
from companion.types.autopilot import AttitudeTarget

LONGEST_SLEW_S = 0.1  # a longer gap between setpoints allows no larger change: five ticks


@dataclass(frozen=True, slots=True)
class OutputLimits:
    """Limits of attitude setpoints and of speeds, and the fence. Thrust as ratio of hover thrust."""

    max_tilt_rad: float
    max_tilt_rate_rad_s: float
    min_thrust_ratio: float
    max_thrust_ratio: float
    max_thrust_rate_1_s: float
    fence: Fence
    max_speed_m_s: float = inf  # horizontal
    max_climb_m_s: float = inf
    max_descent_m_s: float = inf


class OutputLimiter:
    """Limits tilt, thrust and their rates of change, and refuses setpoints that are not finite.

    Thrust limits scale with the present hover thrust estimate, so a wrong estimate narrows the usable range.
    """

    def __init__(self, limits: OutputLimits) -> None:
        self._limits = limits
        self._last: AttitudeTarget | None = None
        self._last_s = float("-inf")

    def open_at(self, now_s: float, current: AttitudeTarget, hover_thrust_norm: float) -> None:
        """Begin a stream at the vehicle's present attitude and thrust, so that the first step is small."""
        if _finite(current):
            self._last = self._within_limits(current, hover_thrust_norm)
            self._last_s = now_s

    def admit(self, now_s: float, wanted: AttitudeTarget, hover_thrust_norm: float) -> AttitudeTarget | None:
        """The allowed setpoint nearest to the wanted one. None where it is not finite or no stream was begun."""
        last = self._last
        if last is None or not _finite(wanted):
            return None
        # After a gap the slew still starts from the last setpoint: without setpoints a vehicle has not turned far.
        elapsed_s = now_s - self._last_s
        if not 0.0 <= elapsed_s <= LONGEST_SLEW_S:
            elapsed_s = between(elapsed_s, 0.0, LONGEST_SLEW_S)
        # Slewing each angle separately can leave the tilt circle slightly, so the tilt is limited again.
        allowed = self._within_limits(wanted, hover_thrust_norm)
        slewed = self._slewed(last, allowed, elapsed_s, hover_thrust_norm)
        self._last_s = now_s
        self._last = admitted = self._within_limits(slewed, hover_thrust_norm)
        return admitted

    def _within_limits(self, target: AttitudeTarget, hover_thrust_norm: float) -> AttitudeTarget:
        roll, pitch, yaw = target.roll_rad, target.pitch_rad, target.yaw_rad
        if not (-pi <= roll < pi and -pi <= pitch < pi and -pi <= yaw < pi):
            roll, pitch, yaw = wrap_pi(roll), wrap_pi(pitch), wrap_pi(yaw)
        # The tilt acos(cos(roll) cos(pitch)) never exceeds hypot(roll, pitch), so this limit is safe and smooth.
        tilt, limits = hypot(roll, pitch), self._limits
        if tilt > limits.max_tilt_rad:
            scale = limits.max_tilt_rad / tilt
            roll, pitch = roll * scale, pitch * scale
        thrust = target.thrust_norm
        least, most = hover_thrust_norm * limits.min_thrust_ratio, hover_thrust_norm * limits.max_thrust_ratio
        if most > 1.0:
            most = 1.0
        if not least <= thrust <= most:
            thrust = between(thrust, least, most)
        return AttitudeTarget(roll, pitch, yaw, thrust)

    def _slewed(
        self, last: AttitudeTarget, wanted: AttitudeTarget, elapsed_s: float, hover_thrust_norm: float
    ) -> AttitudeTarget:
        """`wanted`, no farther from `last` than the rates allow. Yaw is wrapped by `_within_limits`."""
        angle = self._limits.max_tilt_rate_rad_s * elapsed_s
        thrust = self._limits.max_thrust_rate_1_s * hover_thrust_norm * elapsed_s
        d_roll, d_pitch = wanted.roll_rad - last.roll_rad, wanted.pitch_rad - last.pitch_rad
        d_yaw, d_thrust = wanted.yaw_rad - last.yaw_rad, wanted.thrust_norm - last.thrust_norm
        if not -pi <= d_yaw < pi:
            d_yaw = wrap_pi(d_yaw)
        if not (-angle <= d_roll <= angle and -angle <= d_pitch <= angle and -angle <= d_yaw <= angle):
            d_roll, d_pitch, d_yaw = clamped(d_roll, angle), clamped(d_pitch, angle), clamped(d_yaw, angle)
        if not -thrust <= d_thrust <= thrust:
            d_thrust = clamped(d_thrust, thrust)
        return AttitudeTarget(
            last.roll_rad + d_roll, last.pitch_rad + d_pitch, last.yaw_rad + d_yaw, last.thrust_norm + d_thrust
        )


def _finite(target: AttitudeTarget) -> bool:
    return (
        isfinite(target.roll_rad)
        and isfinite(target.pitch_rad)
        and isfinite(target.yaw_rad)
        and isfinite(target.thrust_norm)
    )
