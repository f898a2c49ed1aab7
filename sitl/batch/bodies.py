"""sitl.vehicle.dynamics for many vehicles: rigid bodies of eq. 1-5 with motor lag and linear drag, in free air.

A state is (17, N): position [m] and velocity [m/s] in ENU, attitude quaternion w x y z (FLU to ENU), body rates [rad/s],
thrust [N] and moments [N m] of the motors. A command is (4, N): thrust [N] and moments [N m]. Rotations are quaternions (4, k).
The loops of attitude and rates (sitl.vehicle.control) make moments of attitude goals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.types.values import GRAVITY_M_S2
from sitl.autopilots.px4.autopilot import Px4
from sitl.batch.columns import IntArray
from sitl.vehicle.config import Airframe

ROWS = 17
POSITION, VELOCITY, ATTITUDE, RATES, MOTORS = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 17)


class Bodies:
    """N vehicles with airframes `airframes[of_column]`. Reuses its working memory between steps."""

    def __init__(self, airframes: Sequence[Airframe], of_column: IntArray) -> None:
        mass = np.array([a.mass_kg for a in airframes])[of_column]
        drag = np.array([a.drag_n_per_m_s for a in airframes])[of_column]
        lag = np.array([a.motor_lag_s for a in airframes])[of_column]
        self.inertia_kg_m2: FloatArray = np.ascontiguousarray(
            np.array([a.inertia_kg_m2 for a in airframes])[of_column].T
        )
        jx, jy, jz = self.inertia_kg_m2
        self._per_inertia = 1.0 / self.inertia_kg_m2
        self._gyro = np.stack([(jz - jy) / jx, (jx - jz) / jy, (jy - jx) / jz])
        self._twice_per_mass = 2.0 / mass
        self._drag_per_mass = drag / mass if drag.any() else None
        self._follow = np.where(lag > 0.0, 1.0 / np.where(lag > 0.0, lag, 1.0), 0.0)
        self._no_lag = lag == 0.0
        self.hover_n: FloatArray = mass * GRAVITY_M_S2
        count = mass.size
        self._rate, self._step = np.empty((ROWS, count)), np.empty((ROWS, count))
        self._turning = np.empty((4, 3, count))
        self._three, self._two, self._two_more = np.empty((3, count)), np.empty((2, count)), np.empty((2, count))
        self._one = np.empty(count)

    def hovering(
        self, position_enu_m: FloatArray, velocity_enu_m_s: FloatArray, wind_enu_m_s: FloatArray
    ) -> FloatArray:
        """States (17, N): no body rates, attitude and thrust that hover in this wind (3, N), heading east."""
        state = np.zeros((ROWS, position_enu_m.shape[1]))
        state[POSITION], state[VELOCITY] = position_enu_m, velocity_enu_m_s
        drag_1_s = 0.0 if self._drag_per_mass is None else self._drag_per_mass
        ahead, left, up = -drag_1_s * wind_enu_m_s
        up = up + GRAVITY_M_S2
        roll, pitch = np.arctan2(-left, np.hypot(ahead, up)), np.arctan2(ahead, up)
        state[ATTITUDE] = quaternion_of_euler(roll, pitch, np.zeros_like(roll))
        state[13] = self.hover_n * (np.sqrt(ahead * ahead + left * left + up * up) / GRAVITY_M_S2)
        return state

    def step(self, state: FloatArray, command: FloatArray, wind_enu_m_s: FloatArray, dt_s: float) -> None:
        """Semi-implicit Euler, as sitl.vehicle.dynamics.Body.step. Changes `state` in place."""
        self.set_motors(state, command)
        step = self._step
        np.multiply(self.rate_of_change(state, command, wind_enu_m_s, self._rate), dt_s, out=step)
        np.multiply(step[VELOCITY], 0.5 * dt_s, out=self._three)
        step[POSITION] += self._three  # position with the mean of old and new velocity
        state += step
        self.normalise(state)

    def set_motors(self, state: FloatArray, command: FloatArray) -> None:
        """Set motors without lag to their command."""
        if self._no_lag.any():
            np.copyto(state[MOTORS], command, where=self._no_lag)

    def rate_of_change(
        self, state: FloatArray, command: FloatArray, wind_enu_m_s: FloatArray, out: FloatArray
    ) -> FloatArray:
        """d(state)/dt into `out` (17, N); wind is (3, N) or (3, 1). Few whole-row operations: each costs a microsecond."""
        attitude, rates = state[ATTITUDE], state[RATES]
        out[POSITION] = state[VELOCITY]
        self._accelerate(state, wind_enu_m_s, out[VELOCITY])

        turning = self._turning  # q_i omega_j / 2
        np.multiply(rates, 0.5, out=self._three)
        np.multiply(attitude[:, None, :], self._three[None, :, :], out=turning)
        dw, dx, dy, dz = out[ATTITUDE]
        np.add(turning[1, 0], turning[2, 1], out=dw)
        dw += turning[3, 2]
        np.negative(dw, out=dw)
        np.add(turning[0, 0], turning[2, 2], out=dx)
        dx -= turning[3, 1]
        np.subtract(turning[0, 1], turning[1, 2], out=dy)
        dy += turning[3, 0]
        np.add(turning[0, 2], turning[1, 1], out=dz)
        dz -= turning[2, 0]

        spin, precession = out[RATES], self._three
        np.multiply(rates[1], rates[2], out=precession[0])
        np.multiply(rates[2], rates[0], out=precession[1])
        np.multiply(rates[0], rates[1], out=precession[2])
        precession *= self._gyro
        np.multiply(state[14:17], self._per_inertia, out=spin)
        spin -= precession

        motors = out[MOTORS]
        np.subtract(command, state[MOTORS], out=motors)
        motors *= self._follow
        return out

    def _accelerate(self, state: FloatArray, wind_enu_m_s: FloatArray, out: FloatArray) -> None:
        """m x'' = -m g e3 + R F e3 - drag (x' - wind)."""
        w, vector = state[6], state[7:10]
        along, across = self._two, self._two_more
        np.multiply(state[13], self._twice_per_mass, out=self._one)
        np.multiply(vector[:2], vector[2], out=along)
        np.multiply(vector[1::-1], w, out=across)
        along[0] += across[0]
        along[1] -= across[1]
        np.multiply(along, self._one, out=out[:2])
        np.square(vector[:2], out=across)
        up = out[2]
        np.add(across[0], across[1], out=up)
        np.subtract(0.5, up, out=up)
        up *= self._one
        up -= GRAVITY_M_S2
        if self._drag_per_mass is not None:
            np.subtract(state[VELOCITY], wind_enu_m_s, out=self._three)
            self._three *= self._drag_per_mass
            out -= self._three

    def normalise(self, state: FloatArray) -> None:
        """Scale the quaternions to unit length."""
        attitude = state[ATTITUDE]
        squares = self._turning[:, 0]
        np.square(attitude, out=squares)
        np.add.reduce(squares, axis=0, out=self._one)
        np.sqrt(self._one, out=self._one)
        attitude /= self._one


def product(first: FloatArray, then: FloatArray) -> FloatArray:
    """The rotation `first`, followed by `then` about the rotated body axes."""
    w, x, y, z = first
    a, b, c, d = then
    turned = np.empty_like(first)
    turned[0] = w * a - x * b - y * c - z * d
    turned[1] = x * a + w * b + y * d - z * c
    turned[2] = y * a + w * c + z * b - x * d
    turned[3] = z * a + w * d + x * c - y * b
    return turned


def quaternion_of_turns(angles_rad: FloatArray) -> FloatArray:
    """Quaternions of small angles (3, k) about the body axes."""
    quaternion = np.empty((4, angles_rad.shape[1]))
    quaternion[0] = 1.0
    np.multiply(angles_rad, 0.5, out=quaternion[1:])
    quaternion /= np.sqrt(np.square(quaternion).sum(axis=0))
    return quaternion


def euler_rad(attitude: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (3, k) of unit quaternions (4, k), FLU in ENU."""
    w, x, y, z = attitude
    euler = np.empty((3, w.size))
    np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y), out=euler[0])
    np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0), out=euler[1])
    np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z), out=euler[2])
    return euler


def quaternion_of_euler(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Quaternions (4, k) of Rz(yaw) Ry(pitch) Rx(roll)."""
    halves = np.empty((3, roll_rad.size))
    halves[0], halves[1], halves[2] = roll_rad, pitch_rad, yaw_rad
    halves *= 0.5
    (cr, cp, cy), (sr, sp, sy) = np.cos(halves), np.sin(halves)
    cc, ss, sc, cs = cr * cp, sr * sp, sr * cp, cr * sp
    quaternion = np.empty((4, roll_rad.size))
    quaternion[0] = cc * cy + ss * sy
    quaternion[1] = sc * cy - cs * sy
    quaternion[2] = cs * cy + sc * sy
    quaternion[3] = cc * sy - ss * cy
    return quaternion


LOOPS = Px4.data.loops
HALF_TURN = 1e-6  # bound of `turn` for an error of half a turn, where either direction is as short
MOST_RAD_S = np.array([[LOOPS.max_rate_rad_s], [LOOPS.max_rate_rad_s], [LOOPS.max_yaw_rate_rad_s]])


def delay_steps(dt_s: float) -> int:
    """Delay of an attitude target in the loops."""
    return max(1, round(LOOPS.delay_s / dt_s))


class AttitudeLoops:
    """Both loops of N vehicles with inertia (3, N). Reuses its working memory between steps."""

    def __init__(self, inertia_kg_m2: FloatArray) -> None:
        count = inertia_kg_m2.shape[1]
        self._gain = inertia_kg_m2 * np.array([[LOOPS.rate_gain_1_s], [LOOPS.rate_gain_1_s], [LOOPS.yaw_rate_gain_1_s]])
        self._products = np.empty((4, 4, count))
        self._error = np.empty((4, count))
        self._turn, self._one = np.empty(count), np.empty(count)

    def moments(self, goal: FloatArray, measured: FloatArray, rates_rad_s: FloatArray, out: FloatArray) -> None:
        """Moments [N m] into `out` (3, N). Attitudes are quaternions (4, N), FLU to ENU."""
        self._wanted_rates(goal, measured, out)
        np.minimum(out, MOST_RAD_S, out=out)
        np.maximum(out, -MOST_RAD_S, out=out)
        out -= rates_rad_s
        out *= self._gain

    def _wanted_rates(self, goal: FloatArray, measured: FloatArray, out: FloatArray) -> None:
        """Gains times sitl.vehicle.control.rotation_error."""
        product, (ew, ex, ey, ez) = self._products, self._error
        np.multiply(measured[:, None, :], goal[None, :, :], out=product)
        np.add(product[0, 0], product[1, 1], out=ew)
        ew += product[2, 2]
        ew += product[3, 3]
        np.subtract(product[0, 1], product[1, 0], out=ex)
        ex -= product[2, 3]
        ex += product[3, 2]
        np.subtract(product[0, 2], product[2, 0], out=ey)
        ey += product[1, 3]
        ey -= product[3, 1]
        np.subtract(product[0, 3], product[3, 0], out=ez)
        ez -= product[1, 2]
        ez += product[2, 1]

        turn, one = self._turn, self._one
        np.square(ew, out=turn)
        np.square(ez, out=one)
        turn += one
        np.sqrt(turn, out=turn)
        upside_down = np.flatnonzero(turn < HALF_TURN) if turn.min() < HALF_TURN else None
        np.maximum(turn, HALF_TURN, out=turn)
        np.divide(2.0 * LOOPS.tilt_gain_1_s, turn, out=turn)

        p, q, r = out
        np.multiply(ew, ex, out=p)
        np.multiply(ez, ey, out=one)
        p -= one
        p *= turn
        np.multiply(ew, ey, out=q)
        np.multiply(ez, ex, out=one)
        q += one
        q *= turn
        np.multiply(ez, turn, out=r)
        r *= LOOPS.yaw_gain_1_s / LOOPS.tilt_gain_1_s
        np.copysign(1.0, ew, out=one)
        r *= one
        if upside_down is not None:
            out[:, upside_down] = 2.0 * LOOPS.tilt_gain_1_s * self._error[1:4, upside_down]
            out[2, upside_down] = 0.0
