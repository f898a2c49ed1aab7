"""State of a vehicle ahead by its attitude lag, for checks that must act in time.

A vehicle follows its commanded acceleration u with a lag T: a' = (u - a)/T. With q = p + T v and w = v + T a it is an exact
double integrator, q' = w and w' = u, and p and v follow q and w by a low pass of T. What holds for q and w at all times thus
holds for p and v.
"""

from __future__ import annotations

from msgspec import Struct

from companion.types.autopilot import VehicleState
from companion.types.values import ZERO3, Vector3

LAG_S = 0.2  # from a commanded to the flown acceleration: the mean delay of the attitude step response


class Ahead(Struct, frozen=True, gc=False):
    """q and w of the fleet frame."""

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3


class Lag:
    """Follows the flown acceleration of one vehicle."""

    def __init__(self) -> None:
        self._acceleration_enu_m_s2 = ZERO3
        self._last_s: float | None = None

    def step(self, now_s: float, vehicle: VehicleState, commanded_enu_m_s2: Vector3) -> Ahead:
        """`commanded_enu_m_s2` is the command of the last tick."""
        elapsed_s = now_s - self._last_s if self._last_s is not None else 0.0
        self._last_s = now_s
        share = elapsed_s / (LAG_S + elapsed_s) if elapsed_s > 0.0 else 0.0
        (ax, ay, az), (ux, uy, uz) = self._acceleration_enu_m_s2, commanded_enu_m_s2
        ax, ay, az = ax + share * (ux - ax), ay + share * (uy - ay), az + share * (uz - az)
        self._acceleration_enu_m_s2 = (ax, ay, az)
        (x, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        ahead_s = now_s - vehicle.position_time_s + LAG_S
        return Ahead(
            (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s),
            (vx + ax * ahead_s, vy + ay * ahead_s, vz + az * ahead_s),
        )
