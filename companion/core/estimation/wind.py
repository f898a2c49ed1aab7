"""Disturbance observer: estimates hover thrust and steady horizontal disturbance from the measured velocity.

Model: v' = (T/h) g b3 - g e3 - c v + d, with commanded thrust T, hover thrust h, measured thrust direction b3, drag rate c
of the airframe and disturbance d. The velocity error of the model corrects d horizontally and h vertically. At one thrust a
wrong h and a vertical d look the same. h is estimated because weight, battery and motors change it in every flight, and
because the output limits are ratios of it.

Drag is part of the model and therefore never part of d: it damps the vehicle as before. The model uses the measured
attitude, so attitude lag is not taken for a disturbance. The estimate acts on the loop only where the model is wrong.
"""

from __future__ import annotations

from math import cos, exp, sin

from msgspec import Struct

from companion.geometry.vectors import between, clamped, shortened
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

THRUST_LAG_S = 0.06  # lag of the motors and transport delay of the setpoints
LONGEST_GAP_S = 0.2  # a longer gap in the measurements restarts the velocity; the estimates are kept
MAX_DISTURBANCE_M_S2 = 4.0  # horizontal: a tilt of 22 degrees
MAX_DISTURBANCE_RATE_M_S3 = 3.0
HOVER_RANGE_NORM = (0.1, 0.9)
MAX_HOVER_RATE_1_S = 0.3  # the hover thrust estimate changes by at most this share of itself per second
LARGEST_INNOVATION_M_S = 1.0
RESET_M_S, RESET_M_S2 = 0.5, 30.0  # a larger velocity jump means that the autopilot's estimator was reset


class FlightSample(Struct, frozen=True, gc=False):
    """Velocity, attitude (roll, pitch, yaw of FLU in ENU) and last commanded thrust, measured at `time_s`."""

    time_s: float
    velocity_enu_m_s: Vector3
    attitude_rad: Vector3
    thrust_norm: float


class DisturbanceObserver:
    """Estimates of hover thrust and horizontal disturbance.

    Call `update` while the vehicle flies under thrust commands of the agent, and `pause` otherwise.
    """

    def __init__(self, hover_thrust_norm: float, drag_1_s: float, bandwidth_1_s: float) -> None:
        """Start with `hover_thrust_norm` and no disturbance; `drag_1_s` is deceleration by drag per m/s of airspeed.

        Bandwidth 0 disables the observer: the initial values are kept.
        """
        self.hover_thrust_norm = hover_thrust_norm
        self.disturbance_enu_m_s2 = ZERO3  # z is always 0
        self._drag_1_s = drag_1_s
        self._bandwidth_1_s = bandwidth_1_s
        self._last: FlightSample | None = None
        self._velocity_enu_m_s = ZERO3  # velocity predicted by the model
        self._thrust_norm = 0.0  # thrust of the motors in the model, after their lag
        self._has_flown = False

    def start_from(self, hover_thrust_norm: float) -> bool:
        """Replace the initial hover thrust. Returns False where it is out of range or was already estimated in flight."""
        low, high = HOVER_RANGE_NORM
        if self._has_flown or self._bandwidth_1_s == 0.0 or not low <= hover_thrust_norm <= high:
            return False
        self.hover_thrust_norm = hover_thrust_norm
        return True

    def pause(self) -> None:
        """Stop while the model does not hold: on the ground, or under an unknown thrust. The estimates are kept."""
        self._last = None

    def landed(self) -> None:
        """Pause and clear the disturbance: the wind may differ in the next flight."""
        self.pause()
        self.disturbance_enu_m_s2 = ZERO3

    def update(self, motion: FlightSample) -> None:
        """Correct the estimates with one measurement. A measurement no newer than the last changes nothing."""
        if self._bandwidth_1_s == 0.0:
            return
        last = self._last
        if last is None or motion.time_s - last.time_s > LONGEST_GAP_S:
            self._last, self._velocity_enu_m_s, self._thrust_norm = motion, motion.velocity_enu_m_s, motion.thrust_norm
            return
        dt_s = motion.time_s - last.time_s
        if dt_s <= 0.0:
            return
        self._last, self._has_flown = motion, True
        (vx, vy, vz), (last_x, last_y, last_z) = motion.velocity_enu_m_s, last.velocity_enu_m_s
        jump_x, jump_y, jump_z = vx - last_x, vy - last_y, vz - last_z
        most = RESET_M_S + RESET_M_S2 * dt_s
        if not (-most <= jump_x <= most and -most <= jump_y <= most and -most <= jump_z <= most):
            x, y, z = self._velocity_enu_m_s
            self._velocity_enu_m_s = (x + jump_x, y + jump_y, z + jump_z)
            return
        self._correct(motion, self._predicted(last, motion, dt_s), dt_s)

    def _predicted(self, last: FlightSample, motion: FlightSample, dt_s: float) -> Vector3:
        """Velocity of the model after one step, m/s."""
        before_x, before_y, before_z = self._acceleration(last)
        self._thrust_norm += (last.thrust_norm - self._thrust_norm) * (1.0 - exp(-dt_s / THRUST_LAG_S))
        after_x, after_y, after_z = self._acceleration(motion)
        (x, y, z), half_s = self._velocity_enu_m_s, 0.5 * dt_s
        return (x + half_s * (before_x + after_x), y + half_s * (before_y + after_y), z + half_s * (before_z + after_z))

    def _acceleration(self, motion: FlightSample) -> Vector3:
        """Acceleration of the model, m/s^2."""
        per_mass_m_s2 = self._thrust_norm / self.hover_thrust_norm * GRAVITY_M_S2
        roll_rad, pitch_rad, yaw_rad = motion.attitude_rad
        unrolled_m_s2 = cos(roll_rad) * per_mass_m_s2  # part of the thrust in the vertical plane through the heading
        ahead_m_s2, left_m_s2 = sin(pitch_rad) * unrolled_m_s2, -sin(roll_rad) * per_mass_m_s2
        cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
        (vx, vy, vz), (dx, dy, _) = motion.velocity_enu_m_s, self.disturbance_enu_m_s2
        return (
            ahead_m_s2 * cos_yaw - left_m_s2 * sin_yaw - self._drag_1_s * vx + dx,
            ahead_m_s2 * sin_yaw + left_m_s2 * cos_yaw - self._drag_1_s * vy + dy,
            cos(pitch_rad) * unrolled_m_s2 - GRAVITY_M_S2 - self._drag_1_s * vz,
        )

    def _correct(self, motion: FlightSample, predicted: Vector3, dt_s: float) -> None:
        """Correct velocity, disturbance and hover thrust. Both error poles are at the bandwidth for any step length."""
        pole = exp(-self._bandwidth_1_s * dt_s)
        to_velocity, to_disturbance = 1.0 - pole**2, (1.0 - pole) ** 2 / dt_s
        (vx, vy, vz), (x, y, z) = motion.velocity_enu_m_s, predicted
        error_x, error_y, error_z, most = vx - x, vy - y, vz - z, LARGEST_INNOVATION_M_S
        if not (-most <= error_x <= most and -most <= error_y <= most and -most <= error_z <= most):
            error_x, error_y, error_z = clamped(error_x, most), clamped(error_y, most), clamped(error_z, most)
        self._velocity_enu_m_s = (x + to_velocity * error_x, y + to_velocity * error_y, z + to_velocity * error_z)
        most = MAX_DISTURBANCE_RATE_M_S3 * dt_s
        (x, y, _), dx, dy = self.disturbance_enu_m_s2, to_disturbance * error_x, to_disturbance * error_y
        if not (-most <= dx <= most and -most <= dy <= most):
            dx, dy = clamped(dx, most), clamped(dy, most)
        self.disturbance_enu_m_s2 = shortened((x + dx, y + dy, 0.0), MAX_DISTURBANCE_M_S2)
        share = clamped(to_disturbance * error_z / GRAVITY_M_S2, MAX_HOVER_RATE_1_S * dt_s)
        self.hover_thrust_norm = between(self.hover_thrust_norm * (1.0 - share), *HOVER_RANGE_NORM)
