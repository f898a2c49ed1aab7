"""What pushes the vehicle besides its own thrust: the hover thrust and the steady disturbance, out of what velocity does.

Model: v' = (T/h) g b3 - g e3 - c v + d with the thrust sent T, the hover thrust h, the measured thrust direction b3, the
airframe's drag rate c and the disturbance d. An observer follows the measured velocity with it; what the model misses goes
into d over ground and into h on z. At one thrust a wrong h and a vertical d look the same: h is the one that is found here,
because weight, battery and motors change it in every flight and a ratio of thrust is what the last gate limits.

What natural drag does is in the model and so never in d: it damps the vehicle as before. With the measured attitude in the
model, its lag is not taken for a disturbance, and what is found comes back into the loop only as far as the model is wrong.
"""

from __future__ import annotations

from math import cos, exp, hypot, sin

from msgspec import Struct

from companion.types import GRAVITY_M_S2, ZERO3, Vector3

HOVER_PARAMETERS = ("MPC_THR_HOVER", "MOT_THST_HOVER")  # of PX4 and of ArduCopter
THRUST_LAG_S = 0.06  # motors and the way to them
LONGEST_GAP_S = 0.2  # after a longer one the velocity is taken as it is, and what was found stays
MAX_DISTURBANCE_M_S2 = 4.0  # over ground: a lean of 22 degrees
MAX_DISTURBANCE_RATE_M_S3 = 3.0
HOVER_RANGE_NORM = (0.1, 0.9)
MAX_HOVER_RATE_1_S = 0.3  # of hover thrust
LARGEST_INNOVATION_M_S = 1.0
RESET_M_S, RESET_M_S2 = 0.5, 30.0  # a velocity that jumps by more than this is of an estimator that was reset


class Motion(Struct, frozen=True, gc=False):
    """One measurement: velocity, attitude (roll, pitch, yaw of FLU in ENU) and the thrust commanded last, at `time_s`."""

    time_s: float
    velocity_enu_m_s: Vector3
    attitude_rad: Vector3
    thrust_norm: float


class DisturbanceObserver:
    """Feed it with `update` while the vehicle flies under its own thrust, and with `pause` otherwise."""

    def __init__(self, hover_thrust_norm: float, drag_1_s: float, bandwidth_1_s: float) -> None:
        """`hover_thrust_norm` to begin with; `drag_1_s` is the airframe's deceleration by drag for each m/s through the air.

        At bandwidth 0 nothing is ever found, and what it began with stays.
        """
        self.hover_thrust_norm = hover_thrust_norm
        self.disturbance_enu_m_s2 = ZERO3  # z is always 0
        self._drag_1_s = drag_1_s
        self._bandwidth_1_s = bandwidth_1_s
        self._last: Motion | None = None
        self._velocity_enu_m_s = ZERO3  # as the model has it
        self._thrust_norm = 0.0  # as the motors give it
        self._has_flown = False

    def start_from(self, hover_thrust_norm: float) -> bool:
        """Begin with another hover thrust; False where it cannot be one, or where a better one was found in flight."""
        low, high = HOVER_RANGE_NORM
        if self._has_flown or self._bandwidth_1_s == 0.0 or not low <= hover_thrust_norm <= high:
            return False
        self.hover_thrust_norm = hover_thrust_norm
        return True

    def pause(self) -> None:
        """The model does not hold now, on the ground or under a thrust that is not known. What was found stays."""
        self._last = None

    def landed(self) -> None:
        """The next flight may be at another place in another wind."""
        self.pause()
        self.disturbance_enu_m_s2 = ZERO3

    def update(self, motion: Motion) -> None:
        """Take in one measurement; one that is no newer than the last changes nothing."""
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
        if max(abs(jump_x), abs(jump_y), abs(jump_z)) > RESET_M_S + RESET_M_S2 * dt_s:
            x, y, z = self._velocity_enu_m_s
            self._velocity_enu_m_s = (x + jump_x, y + jump_y, z + jump_z)
            return
        self._correct(motion, self._predicted(last, motion, dt_s), dt_s)

    def _predicted(self, last: Motion, motion: Motion, dt_s: float) -> Vector3:
        """The model's velocity one step on, m/s."""
        before_x, before_y, before_z = self._acceleration(last)
        self._thrust_norm += (last.thrust_norm - self._thrust_norm) * (1.0 - exp(-dt_s / THRUST_LAG_S))
        after_x, after_y, after_z = self._acceleration(motion)
        (x, y, z), half_s = self._velocity_enu_m_s, 0.5 * dt_s
        return (
            x + half_s * (before_x + after_x),
            y + half_s * (before_y + after_y),
            z + half_s * (before_z + after_z),
        )

    def _acceleration(self, motion: Motion) -> Vector3:
        """What the model says of it, m/s^2."""
        per_mass_m_s2 = self._thrust_norm / self.hover_thrust_norm * GRAVITY_M_S2
        roll_rad, pitch_rad, yaw_rad = motion.attitude_rad
        unrolled_m_s2 = cos(roll_rad) * per_mass_m_s2  # of it in the upright plane of the heading
        ahead_m_s2, left_m_s2 = sin(pitch_rad) * unrolled_m_s2, -sin(roll_rad) * per_mass_m_s2
        cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
        (vx, vy, vz), (dx, dy, _) = motion.velocity_enu_m_s, self.disturbance_enu_m_s2
        return (
            ahead_m_s2 * cos_yaw - left_m_s2 * sin_yaw - self._drag_1_s * vx + dx,
            ahead_m_s2 * sin_yaw + left_m_s2 * cos_yaw - self._drag_1_s * vy + dy,
            cos(pitch_rad) * unrolled_m_s2 - GRAVITY_M_S2 - self._drag_1_s * vz,
        )

    def _correct(self, motion: Motion, predicted: Vector3, dt_s: float) -> None:
        """Both poles of the error at the bandwidth, however long the step."""
        pole = exp(-self._bandwidth_1_s * dt_s)
        to_velocity, to_disturbance = 1.0 - pole**2, (1.0 - pole) ** 2 / dt_s
        (vx, vy, vz), (x, y, z) = motion.velocity_enu_m_s, predicted
        missed_x = _clamped(vx - x, LARGEST_INNOVATION_M_S)
        missed_y = _clamped(vy - y, LARGEST_INNOVATION_M_S)
        missed_z = _clamped(vz - z, LARGEST_INNOVATION_M_S)
        self._velocity_enu_m_s = (x + to_velocity * missed_x, y + to_velocity * missed_y, z + to_velocity * missed_z)
        most = MAX_DISTURBANCE_RATE_M_S3 * dt_s
        self._disturb(_clamped(to_disturbance * missed_x, most), _clamped(to_disturbance * missed_y, most))
        share = _clamped(to_disturbance * missed_z / GRAVITY_M_S2, MAX_HOVER_RATE_1_S * dt_s)
        low, high = HOVER_RANGE_NORM
        self.hover_thrust_norm = min(max(self.hover_thrust_norm * (1.0 - share), low), high)

    def _disturb(self, dx_m_s2: float, dy_m_s2: float) -> None:
        x, y = self.disturbance_enu_m_s2[0] + dx_m_s2, self.disturbance_enu_m_s2[1] + dy_m_s2
        size = hypot(x, y)
        scale = MAX_DISTURBANCE_M_S2 / size if size > MAX_DISTURBANCE_M_S2 else 1.0
        self.disturbance_enu_m_s2 = (x * scale, y * scale, 0.0)


def _clamped(value: float, limit: float) -> float:
    if value > limit:
        return limit
    return -limit if value < -limit else value
