"""Corrections of what the autopilot's estimator reports: position resets, and a velocity that its position contradicts.

A reset of the estimator or of the local origin moves no vehicle; without this it would move the setpoint. LOCAL_POSITION_NED
carries no reset counter, so a jump is a position change that the velocity does not explain. A new origin and the local
position relative to it may arrive in either order: each alone is a jump, both together are none. So a jump is held back and
added to the used position at a limited rate.
"""

from __future__ import annotations

from math import exp, hypot

from companion.geometry.vectors import plus, shortened
from companion.types.values import ZERO3, Vector3

RELEASE_M_S = 0.2  # rate at which a held-back difference is released: one metre in 5 s
JUMP_M = 0.2  # smallest jump, beyond the distance that the velocities explain
BEND_M_S2 = 10.0  # two velocities may misjudge the distance between them by this times the time squared
LONGEST_GAP_S = 0.5  # between positions; the motion in a longer gap is unknown
LARGEST_JUMP_M = 5.0  # a larger difference is no correction: the vehicle is handed over
ORIGIN_WITHIN_S = 0.5  # unless a new origin of the autopilot explains it within this time


class PositionReset:
    """Removes jumps from the position of a vehicle in flight. `held_back_m` is used position minus reported position."""

    def __init__(self) -> None:
        self.held_back_m: Vector3 = ZERO3
        self._before: tuple[float, Vector3, Vector3] | None = None  # time, position, velocity as reported

    def restart(self) -> None:
        """Use the next reported position unchanged."""
        self.held_back_m = ZERO3
        self._before = None

    def follow(self, time_s: float, position_m: Vector3, velocity_m_s: Vector3) -> tuple[Vector3, float]:
        """(used position, size of a jump of the reported one, else 0). `time_s` is the autopilot's clock and increases."""
        jump_m, before = 0.0, self._before
        if before is not None:
            step_s = time_s - before[0]
            if step_s > LONGEST_GAP_S:
                self.restart()
            else:
                jump_m = self._find_jump(step_s, position_m, velocity_m_s, before[1], before[2])
        self._before = (time_s, position_m, velocity_m_s)
        (x, y, z), (hx, hy, hz) = position_m, self.held_back_m
        return (x + hx, y + hy, z + hz), jump_m

    def _find_jump(
        self, step_s: float, position_m: Vector3, velocity_m_s: Vector3, position0_m: Vector3, velocity0_m_s: Vector3
    ) -> float:
        (x, y, z), (x0, y0, z0), (hx, hy, hz) = position_m, position0_m, self.held_back_m
        (vx, vy, vz), (vx0, vy0, vz0), half_s = velocity_m_s, velocity0_m_s, 0.5 * step_s
        off_x = x - x0 - (vx + vx0) * half_s
        off_y = y - y0 - (vy + vy0) * half_s
        off_z = z - z0 - (vz + vz0) * half_s
        off_m = hypot(off_x, off_y, off_z)
        if off_m > JUMP_M + BEND_M_S2 * step_s * step_s:
            self.held_back_m = (hx - off_x, hy - off_y, hz - off_z)
            return off_m
        if self.held_back_m is not ZERO3:
            distance_m = hypot(hx, hy, hz)
            left = 1.0 - RELEASE_M_S * step_s / distance_m if distance_m > 0.0 else 0.0
            self.held_back_m = (hx * left, hy * left, hz * left) if left > 0.0 else ZERO3
        return 0.0


LARGEST_M_S = 0.6  # largest correction; slow estimator errors are smaller
UNEXPLAINED_M = 0.2  # the position moved without a motion, beyond what the largest correction explains


class VelocityCorrection:
    """Velocity that agrees with the change of the reported position: the correction b, in the axes of the velocity.

    An estimator's velocity may disagree with its own position, slowly varying: real ArduCopter by 0.025 m/s in hover, real PX4
    with its stock EKF2 by up to 0.4 m/s. The law rests where k1 times the position error balances k2 times that velocity, k2/k1
    of it away from the slot. A complementary filter takes the slow part from the position and the fast part from the velocity:
    p' = v + b + 2 w e, b' = w^2 e with e = position - p; used is v + b. Where both agree, b is zero and nothing is changed.
    """

    def __init__(self, bandwidth_1_s: float) -> None:
        """`bandwidth_1_s` is w, above 0."""
        self._bandwidth_1_s = bandwidth_1_s
        self._largest_error_m = UNEXPLAINED_M + LARGEST_M_S / (exp(1.0) * bandwidth_1_s)  # the peak after a step of b
        self._correction_m_s: Vector3 = ZERO3
        self._before: tuple[float, Vector3, Vector3] | None = None  # time, filtered position, velocity as reported

    def restart(self) -> None:
        """Begin with the next position, without a correction."""
        self._correction_m_s, self._before = ZERO3, None

    def follow(self, time_s: float, position_m: Vector3, velocity_m_s: Vector3) -> Vector3:
        """The velocity to be used, m/s. `time_s` is the autopilot's clock and increases from call to call."""
        before, filtered_m = self._before, position_m
        if before is None or time_s - before[0] > LONGEST_GAP_S:
            self.restart()
        else:
            # The prediction p, and the error e
            (fx, fy, fz), (vx0, vy0, vz0), step_s = before[1], before[2], time_s - before[0]
            (x, y, z), (vx, vy, vz), (bx, by, bz) = position_m, velocity_m_s, self._correction_m_s
            px = fx + ((vx0 + vx) * 0.5 + bx) * step_s
            py = fy + ((vy0 + vy) * 0.5 + by) * step_s
            pz = fz + ((vz0 + vz) * 0.5 + bz) * step_s
            ex, ey, ez = x - px, y - py, z - pz
            # A jump of the reported position moves the filtered one and leaves the correction as it is.
            if not hypot(ex, ey, ez) > self._largest_error_m:
                # The continuous filter, sampled: critically damped with both poles at exp(-w step), stable at every step.
                pole = exp(-self._bandwidth_1_s * step_s)
                on_velocity_1_s = (1.0 - pole) * (1.0 - pole) / step_s
                corrected_m_s = (bx + ex * on_velocity_1_s, by + ey * on_velocity_1_s, bz + ez * on_velocity_1_s)
                self._correction_m_s = shortened(corrected_m_s, LARGEST_M_S)
                on_position = 1.0 - pole * pole
                filtered_m = (px + ex * on_position, py + ey * on_position, pz + ez * on_position)
        self._before = (time_s, filtered_m, velocity_m_s)
        return plus(velocity_m_s, self._correction_m_s)
