"""The rigid body of eq. 1-5 with motor lag and linear drag, and rotations by small angles. Pure; plain floats.

State, in this order: position x y z [m] and velocity [m/s] in ENU, attitude quaternion w x y z (FLU body to ENU), body rates
p q r [rad/s], present collective thrust [N] and moments about the body axes [N m] of the motors.
"""

from __future__ import annotations

from math import sqrt

from companion.geometry.frames import Quaternion
from companion.types.values import GRAVITY_M_S2, Vector3

SmallTurn = tuple[float, float, float, float]
"""Half of the angles about x, y and z [rad], and the norm of the quaternion (1, a, b, c) that they make."""

NO_TURN: SmallTurn = (0.0, 0.0, 0.0, 1.0)
State = tuple[float, ...]  # 17 numbers
POSITION, VELOCITY, ATTITUDE, RATES = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)
THRUST = 13


def small_turn(angles_rad: Vector3) -> SmallTurn:
    a, b, c = 0.5 * angles_rad[0], 0.5 * angles_rad[1], 0.5 * angles_rad[2]
    return (a, b, c, sqrt(1.0 + a * a + b * b + c * c))


def back(turn: SmallTurn) -> SmallTurn:
    """The opposite rotation."""
    a, b, c, norm = turn
    return (-a, -b, -c, norm)


def turned(quaternion: Quaternion, turn: SmallTurn) -> Quaternion:
    """A unit quaternion after this rotation."""
    w, x, y, z = quaternion
    a, b, c, norm = turn
    return (
        (w - x * a - y * b - z * c) / norm,
        (x + w * a + y * c - z * b) / norm,
        (y + w * b + z * a - x * c) / norm,
        (z + w * c + x * b - y * a) / norm,
    )


def at_rest(position_enu_m: Vector3, quaternion: tuple[float, float, float, float]) -> State:
    """The state at rest with motors off."""
    return (*position_enu_m, 0.0, 0.0, 0.0, *quaternion, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Body:
    """An airframe in the equations of motion, integrated in steps of `dt_s`."""

    __slots__ = (
        "_drag_1_s", "_dt_s", "_follow_1_s", "_half_dt_s", "_jx", "_jxy", "_jy", "_jyz", "_jz", "_jzx", "inertia_kg_m2",
        "mass_kg",
    )  # fmt: skip

    def __init__(
        self, mass_kg: float, inertia_kg_m2: Vector3, drag_n_per_m_s: float, motor_lag_s: float, dt_s: float
    ) -> None:
        self.mass_kg, self.inertia_kg_m2 = mass_kg, inertia_kg_m2
        self._jx, self._jy, self._jz = jx, jy, jz = inertia_kg_m2
        self._jyz, self._jzx, self._jxy = jz - jy, jx - jz, jy - jx
        self._drag_1_s = drag_n_per_m_s / mass_kg
        self._follow_1_s = 1.0 / motor_lag_s if motor_lag_s > 0.0 else 0.0  # 0.0: without lag
        self._dt_s, self._half_dt_s = dt_s, 0.5 * dt_s

    def step(self, state: State, thrust_n: float, moments_n_m: Vector3, wind_enu_m_s: Vector3) -> State:
        """The state one step later under commanded thrust and moments, in free air.

        Eq. 1: m x'' = -m g e3 + R F e3 - drag (x' - wind), R' = R S(Omega), J Omega' + S(Omega) J Omega = tau. The attitude
        is a quaternion, which avoids the singularity of the Euler angles in eq. 3-5. Semi-implicit: the position uses the mean
        of old and new velocity, which is exact under constant acceleration.

        It is the most frequent computation of a flight: no loops, and what does not change is computed once.
        """
        px, py, pz, vx, vy, vz, w, x, y, z, p, q, r, force, mx, my, mz = state
        tx, ty, tz = moments_n_m
        wx, wy, wz = wind_enu_m_s
        dt_s, half_dt_s, drag_1_s, follow_1_s = self._dt_s, self._half_dt_s, self._drag_1_s, self._follow_1_s
        if follow_1_s == 0.0:
            force, mx, my, mz = thrust_n, tx, ty, tz
        per_mass = force / self.mass_kg
        twice = 2.0 * per_mass
        new_vx = vx + dt_s * ((x * z + w * y) * twice - drag_1_s * (vx - wx))
        new_vy = vy + dt_s * ((y * z - w * x) * twice - drag_1_s * (vy - wy))
        new_vz = vz + dt_s * ((1.0 - 2.0 * (x * x + y * y)) * per_mass - GRAVITY_M_S2 - drag_1_s * (vz - wz))
        new_w = w - half_dt_s * (x * p + y * q + z * r)
        new_x = x + half_dt_s * (w * p + y * r - z * q)
        new_y = y + half_dt_s * (w * q - x * r + z * p)
        new_z = z + half_dt_s * (w * r + x * q - y * p)
        norm = sqrt(new_w * new_w + new_x * new_x + new_y * new_y + new_z * new_z)
        return (
            px + dt_s * vx + half_dt_s * (new_vx - vx),
            py + dt_s * vy + half_dt_s * (new_vy - vy),
            pz + dt_s * vz + half_dt_s * (new_vz - vz),
            new_vx,
            new_vy,
            new_vz,
            new_w / norm,
            new_x / norm,
            new_y / norm,
            new_z / norm,
            p + dt_s * ((mx - self._jyz * q * r) / self._jx),
            q + dt_s * ((my - self._jzx * r * p) / self._jy),
            r + dt_s * ((mz - self._jxy * p * q) / self._jz),
            force + dt_s * (follow_1_s * (thrust_n - force)),
            mx + dt_s * (follow_1_s * (tx - mx)),
            my + dt_s * (follow_1_s * (ty - my)),
            mz + dt_s * (follow_1_s * (tz - mz)),
        )
