"""The last gate: nothing reaches the autopilot but through here, whatever the controller computed."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite

from companion.frames import wrap_pi
from companion.types import AttitudeTarget, Vector3


@dataclass(frozen=True, slots=True)
class EnvelopeLimits:
    """Thrust as ratios of hover thrust; the fence is a box in the fleet frame."""

    max_tilt_rad: float
    max_tilt_rate_rad_s: float
    min_thrust_ratio: float
    max_thrust_ratio: float
    max_thrust_rate_1_s: float
    fence_min_enu_m: Vector3
    fence_max_enu_m: Vector3

    def inside_fence(self, position_enu_m: Vector3) -> bool:
        """False for NaN, too."""
        x, y, z = position_enu_m
        low_x, low_y, low_z = self.fence_min_enu_m
        high_x, high_y, high_z = self.fence_max_enu_m
        return low_x <= x <= high_x and low_y <= y <= high_y and low_z <= z <= high_z


class LastGate:
    """Limits tilt, thrust and their slew, and refuses what is not finite.

    Thrust is limited by the hover thrust that is believed just now, so a wrong one narrows what can be flown.
    """

    def __init__(self, limits: EnvelopeLimits) -> None:
        self._limits = limits
        self._last: AttitudeTarget | None = None
        self._last_s = float("-inf")

    def open_at(self, now_s: float, current: AttitudeTarget, hover_thrust_norm: float) -> None:
        """Begin a stream from the attitude and thrust that the vehicle has now, so that the first step is small."""
        if _finite(current):
            self._last = self._within_limits(current, hover_thrust_norm)
            self._last_s = now_s

    def admit(self, now_s: float, wanted: AttitudeTarget, hover_thrust_norm: float) -> AttitudeTarget | None:
        """The allowed target nearest to the wanted one, or None where it is not finite or the gate was never opened."""
        if self._last is None or not _finite(wanted):
            return None
        # After a gap the slew still starts from the last command: a silent vehicle has not turned far meanwhile.
        elapsed_s = min(max(now_s - self._last_s, 0.0), 0.1)
        # Slewing each angle by itself can leave the tilt circle by a little, so the limit has the last word.
        allowed = self._within_limits(wanted, hover_thrust_norm)
        slewed = self._slewed(self._last, allowed, elapsed_s, hover_thrust_norm)
        self._last = self._within_limits(slewed, hover_thrust_norm)
        self._last_s = now_s
        return self._last

    def _within_limits(self, target: AttitudeTarget, hover_thrust_norm: float) -> AttitudeTarget:
        roll, pitch = wrap_pi(target.roll_rad), wrap_pi(target.pitch_rad)
        # The tilt acos(cos(roll) cos(pitch)) is never more than hypot(roll, pitch), so this limit is safe and smooth.
        tilt = hypot(roll, pitch)
        if tilt > self._limits.max_tilt_rad:
            scale = self._limits.max_tilt_rad / tilt
            roll, pitch = roll * scale, pitch * scale
        least = hover_thrust_norm * self._limits.min_thrust_ratio
        most = min(1.0, hover_thrust_norm * self._limits.max_thrust_ratio)
        return AttitudeTarget(roll, pitch, wrap_pi(target.yaw_rad), min(max(target.thrust_norm, least), most))

    def _slewed(
        self, last: AttitudeTarget, wanted: AttitudeTarget, elapsed_s: float, hover_thrust_norm: float
    ) -> AttitudeTarget:
        angle = self._limits.max_tilt_rate_rad_s * elapsed_s
        thrust = self._limits.max_thrust_rate_1_s * hover_thrust_norm * elapsed_s
        return AttitudeTarget(
            last.roll_rad + _clamped(wanted.roll_rad - last.roll_rad, angle),
            last.pitch_rad + _clamped(wanted.pitch_rad - last.pitch_rad, angle),
            wrap_pi(last.yaw_rad + _clamped(wrap_pi(wanted.yaw_rad - last.yaw_rad), angle)),
            last.thrust_norm + _clamped(wanted.thrust_norm - last.thrust_norm, thrust),
        )


def _clamped(value: float, limit: float) -> float:
    if value > limit:
        return limit
    return -limit if value < -limit else value


def _finite(target: AttitudeTarget) -> bool:
    return (
        isfinite(target.roll_rad)
        and isfinite(target.pitch_rad)
        and isfinite(target.yaw_rad)
        and isfinite(target.thrust_norm)
    )
