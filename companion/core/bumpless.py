"""A position that stays where the autopilot's jumps: the difference is held back and let in at a limited rate.

An estimator that resets, or a local frame that begins elsewhere, moves no vehicle; without this it would move the setpoint.
PX4's LOCAL_POSITION_NED counts no resets, so a jump is what the velocity does not explain. A new origin and the local
position about it may come in either order: each alone is a jump, and both together are none.
"""

from __future__ import annotations

from math import hypot

from companion.types import ZERO3, Vector3

LET_IN_M_S = 0.2  # a metre within 5 s
JUMP_M = 0.2  # beside the way that the velocities explain
BEND_M_S2 = 10.0  # what two velocities may miss of the way between them: this times the time squared
LONGEST_GAP_S = 0.5  # of positions; what was flown in a longer one is not known
LARGEST_JUMP_M = 5.0  # a larger difference is no correction: the vehicle is handed over
ORIGIN_WITHIN_S = 0.5  # unless the autopilot's new origin explains it within this


class BumplessPosition:
    """Follows one vehicle's position in flight. `held_back_m` is position used less position told."""

    def __init__(self) -> None:
        self.held_back_m: Vector3 = ZERO3
        self._before: tuple[float, Vector3, Vector3] | None = None  # time, position, velocity as told

    def begin_anew(self) -> None:
        """What is told next is used as it is."""
        self.held_back_m = ZERO3
        self._before = None

    def follow(self, time_s: float, position_m: Vector3, velocity_m_s: Vector3) -> tuple[Vector3, float]:
        """(position used, how far the one told jumped, 0 where it did not). `time_s` is the autopilot's own and rises."""
        jump_m = 0.0
        if self._before is not None:
            step_s = time_s - self._before[0]
            if step_s > LONGEST_GAP_S:
                self.begin_anew()
            else:
                jump_m = self._look_for_jump(step_s, position_m, velocity_m_s, *self._before[1:])
        self._before = (time_s, position_m, velocity_m_s)
        (x, y, z), (hx, hy, hz) = position_m, self.held_back_m
        return (x + hx, y + hy, z + hz), jump_m

    def _look_for_jump(
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
            left = 1.0 - LET_IN_M_S * step_s / distance_m if distance_m > 0.0 else 0.0
            self.held_back_m = (hx * left, hy * left, hz * left) if left > 0.0 else ZERO3
        return 0.0
