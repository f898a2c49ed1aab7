"""The rigid body of eq. 1-5 with motor lag and linear drag. Pure; plain floats, which are faster than small arrays.

State, in this order: position x y z [m] and velocity [m/s] in ENU, attitude quaternion w x y z (FLU body to ENU), body rates
p q r [rad/s], present collective thrust [N] and moments about the body axes [N m] of the motors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from companion.types.vectors import GRAVITY_M_S2, Vector3

State = tuple[float, ...]  # 17 numbers
Derivative = Callable[[State], State]

POSITION, VELOCITY, ATTITUDE, RATES = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)
THRUST = 13


@dataclass(frozen=True, slots=True)
class Body:
    """Parameters of an airframe in the equations of motion."""

    mass_kg: float
    inertia_kg_m2: Vector3
    drag_n_per_m_s: float
    motor_lag_s: float


def at_rest(position_enu_m: Vector3, quaternion: tuple[float, float, float, float]) -> State:
    """The state at rest with motors off."""
    return (*position_enu_m, 0.0, 0.0, 0.0, *quaternion, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def rate_of_change(body: Body, state: State, thrust_n: float, moments_n_m: Vector3, wind_enu_m_s: Vector3) -> State:
    """d(state)/dt for commanded thrust and moments, in free air.

    Eq. 1: m x'' = -m g e3 + R F e3 - drag (x' - wind), R' = R S(Omega), J Omega' + S(Omega) J Omega = tau. The attitude is a
    quaternion, which avoids the singularity of the Euler angles in eq. 3-5.
    """
    mass, drag = body.mass_kg, body.drag_n_per_m_s
    jx, jy, jz = body.inertia_kg_m2
    tx, ty, tz = moments_n_m
    wx, wy, wz = wind_enu_m_s
    follow = 1.0 / body.motor_lag_s if body.motor_lag_s > 0.0 else 0.0
    _, _, _, vx, vy, vz, w, x, y, z, p, q, r, force, mx, my, mz = state
    per_mass, drag_1_s = force / mass, drag / mass
    return (
        vx,
        vy,
        vz,
        2.0 * (x * z + w * y) * per_mass - drag_1_s * (vx - wx),
        2.0 * (y * z - w * x) * per_mass - drag_1_s * (vy - wy),
        (1.0 - 2.0 * (x * x + y * y)) * per_mass - GRAVITY_M_S2 - drag_1_s * (vz - wz),
        0.5 * (-x * p - y * q - z * r),
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q - x * r + z * p),
        0.5 * (w * r + x * q - y * p),
        (mx - (jz - jy) * q * r) / jx,
        (my - (jx - jz) * r * p) / jy,
        (mz - (jy - jx) * p * q) / jz,
        follow * (thrust_n - force),
        follow * (tx - mx),
        follow * (ty - my),
        follow * (tz - mz),
    )


def derivative(body: Body, thrust_n: float, moments_n_m: Vector3, wind_enu_m_s: Vector3) -> Derivative:
    """`rate_of_change` as a function of the state alone, for the integrators."""
    return lambda state: rate_of_change(body, state, thrust_n, moments_n_m, wind_enu_m_s)


def euler(derivative_of: Derivative, state: State, dt_s: float) -> State:
    """One semi-implicit Euler step: position and attitude use the new velocities, which keeps orbits closed at 250 Hz."""
    return advance(state, derivative_of(state), dt_s)


def advance(state: State, rate: State, dt_s: float) -> State:
    """The step of `euler` from a rate of change; the quaternion is normalised.

    Written without loops, because it is the most frequent computation of a flight.
    """
    x, y, z, vx, vy, vz, qw, qx, qy, qz, p, q, r, force, mx, my, mz = state
    dx, dy, dz, ax, ay, az, dqw, dqx, dqy, dqz, dp, dq, dr, dforce, dmx, dmy, dmz = rate
    new_vx, new_vy, new_vz = vx + dt_s * ax, vy + dt_s * ay, vz + dt_s * az
    qw, qx, qy, qz = qw + dt_s * dqw, qx + dt_s * dqx, qy + dt_s * dqy, qz + dt_s * dqz
    norm = sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    half = 0.5 * dt_s  # mean of old and new velocity: exact under constant acceleration
    return (
        x + dt_s * dx + half * (new_vx - vx),
        y + dt_s * dy + half * (new_vy - vy),
        z + dt_s * dz + half * (new_vz - vz),
        new_vx,
        new_vy,
        new_vz,
        qw / norm,
        qx / norm,
        qy / norm,
        qz / norm,
        p + dt_s * dp,
        q + dt_s * dq,
        r + dt_s * dr,
        force + dt_s * dforce,
        mx + dt_s * dmx,
        my + dt_s * dmy,
        mz + dt_s * dmz,
    )


def rk4(derivative_of: Derivative, state: State, dt_s: float) -> State:
    """One classical Runge-Kutta step of fourth order."""
    half = 0.5 * dt_s
    k1 = derivative_of(state)
    k2 = derivative_of(tuple([a + half * b for a, b in zip(state, k1, strict=True)]))
    k3 = derivative_of(tuple([a + half * b for a, b in zip(state, k2, strict=True)]))
    k4 = derivative_of(tuple([a + dt_s * b for a, b in zip(state, k3, strict=True)]))
    sixth = dt_s / 6.0
    return tuple([a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(state, k1, k2, k3, k4, strict=True)])


def normalised(state: State) -> State:
    """The same state with a unit quaternion."""
    w, x, y, z = state[ATTITUDE]
    norm = sqrt(w * w + x * x + y * y + z * z)
    return (*state[:6], w / norm, x / norm, y / norm, z / norm, *state[10:])
