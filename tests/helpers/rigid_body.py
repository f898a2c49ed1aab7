"""The equations of the rigid body once more, for any integrator: the reference of `sitl.vehicle.dynamics`."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from companion.types.values import GRAVITY_M_S2, Vector3
from sitl.vehicle.dynamics import ATTITUDE, State


@dataclass(frozen=True)
class Equations:
    """d(state)/dt of an airframe under constant commands, in free air."""

    mass_kg: float
    inertia_kg_m2: Vector3
    drag_n_per_m_s: float
    motor_lag_s: float
    thrust_n: float
    moments_n_m: Vector3
    wind_enu_m_s: Vector3

    def rate_of_change(self, state: State) -> State:
        w, x, y, z = state[ATTITUDE]
        p, q, r, force, *moments = state[10:]
        jx, jy, jz = self.inertia_kg_m2
        mx, my, mz = moments
        up = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
        ax, ay, az = (
            (force * e - self.drag_n_per_m_s * (v - wind)) / self.mass_kg
            for e, v, wind in zip(up, state[3:6], self.wind_enu_m_s, strict=True)
        )
        commanded = (self.thrust_n, *self.moments_n_m)
        lag_s = self.motor_lag_s
        motors = [(c - m) / lag_s if lag_s else 0.0 for c, m in zip(commanded, (force, *moments), strict=True)]
        return (
            *state[3:6],
            ax,
            ay,
            az - GRAVITY_M_S2,
            0.5 * (-x * p - y * q - z * r),
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q - x * r + z * p),
            0.5 * (w * r + x * q - y * p),
            (mx - (jz - jy) * q * r) / jx,
            (my - (jx - jz) * r * p) / jy,
            (mz - (jy - jx) * p * q) / jz,
            *motors,
        )

    def after(self, state: State, dt_s: float, steps: int = 1) -> State:
        """The state after so many classical Runge-Kutta steps of fourth order."""
        if self.motor_lag_s == 0.0:
            state = (*state[:13], self.thrust_n, *self.moments_n_m)
        for _ in range(steps):
            k1 = self.rate_of_change(state)
            k2 = self.rate_of_change(_plus(state, 0.5 * dt_s, k1))
            k3 = self.rate_of_change(_plus(state, 0.5 * dt_s, k2))
            k4 = self.rate_of_change(_plus(state, dt_s, k3))
            slope = tuple((a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
            state = _normalised(_plus(state, dt_s, slope))
        return state


def _plus(state: State, seconds: float, rate: State) -> State:
    return tuple(a + seconds * b for a, b in zip(state, rate, strict=True))


def _normalised(state: State) -> State:
    w, x, y, z = state[ATTITUDE]
    norm = sqrt(w * w + x * x + y * y + z * z)
    return (*state[:6], w / norm, x / norm, y / norm, z / norm, *state[10:])
