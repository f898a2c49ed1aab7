"""sitl.vehicle.control for many vehicles: attitude goals -> moments about the body axes."""

from __future__ import annotations

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.vehicle.control import PX4_LOOPS as LOOPS

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
