"""Errors and omissions of the printed paper, with the correct form and the computed result of the printed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import cos, degrees, dist, hypot, pi, radians, sin, tan

import numpy as np
from scipy.optimize import brentq

from companion.analysis.interaction import interaction_matrix
from companion.analysis.response import settled_prcs
from companion.core.control.setpoint import attitude_target
from companion.laws import neighbour_weights
from companion.laws.average_22 import Average22
from companion.laws.average_26 import Average26
from companion.laws.weighted import Weighted
from companion.types.values import GRAVITY_M_S2
from sitl.compare.shapes import chain
from sitl.paper.spectrum import lambda_min
from sitl.paper.theorems import printed_prcs
from sitl.paper.words import erratum_of, words
from sitl.report.claim import Erratum

PLATOON = chain(4).adjacency()
ASKED_M_S2 = (1.0, 0.5, 0.0)  # acceleration with which eq. 8 is tried
ASKED_YAW_RAD = radians(30.0)


def errata() -> list[Erratum]:
    """All errata in the order of the paper."""
    computed = {
        "eq. 8": _equation_8,
        "eq. 11": _equation_11,
        "Algorithm 1, line 3": _algorithm_1,
        "Algorithm 2": _algorithm_2,
        "eq. 16, the line before it": _equation_16,
        "eq. 26": _equation_26,
    }
    return [computed[place]() if place in computed else erratum_of(place) for place in words().errata]


def _equation_8() -> Erratum:
    """Solve both forms of eq. 8 for the attitude, and compute its acceleration by eq. 2 with the thrust of eq. 7."""
    tilt_rad = max(abs(angle) for angle in printed_attitude())
    right_error, printed_error = (
        dist(acceleration_of(*form()), ASKED_M_S2) for form in (right_attitude, printed_attitude)
    )
    return erratum_of(
        "eq. 8",
        asked=hypot(*ASKED_M_S2),
        tilt_deg=degrees(tilt_rad),
        printed_error=printed_error,
        right_error=right_error,
    )


def right_attitude() -> tuple[float, float]:
    """(roll, pitch) [rad] that the agent commands for ASKED_M_S2."""
    target = attitude_target(ASKED_M_S2, ASKED_YAW_RAD, 0.0, 0.0, 0.5)
    return target.roll_rad, target.pitch_rad


def printed_attitude() -> tuple[float, float]:
    """(roll, pitch) [rad] that satisfy eq. 8 as printed for ASKED_M_S2."""
    ux, uy, uz = ASKED_M_S2
    ax, ay = ux / (uz + GRAVITY_M_S2), uy / (uz + GRAVITY_M_S2)
    along, across = ax * cos(ASKED_YAW_RAD) + ay * sin(ASKED_YAW_RAD), ax * sin(ASKED_YAW_RAD) - ay * cos(ASKED_YAW_RAD)
    pitch = _solve(lambda angle: tan(angle) - angle, along)
    return _solve(lambda angle: tan(angle) / cos(pitch) - angle, across), pitch


def acceleration_of(roll_rad: float, pitch_rad: float) -> tuple[float, float, float]:
    """Acceleration [m/s^2] by eq. 2 at ASKED_YAW_RAD, with the thrust of eq. 7 for ASKED_M_S2."""
    thrust = (ASKED_M_S2[2] + GRAVITY_M_S2) / (cos(pitch_rad) * cos(roll_rad))  # per mass
    sin_yaw, cos_yaw = sin(ASKED_YAW_RAD), cos(ASKED_YAW_RAD)
    x = (sin_yaw * sin(roll_rad) + cos_yaw * cos(roll_rad) * sin(pitch_rad)) * thrust
    y = (cos(roll_rad) * sin_yaw * sin(pitch_rad) - cos_yaw * sin(roll_rad)) * thrust
    return x, y, cos(pitch_rad) * cos(roll_rad) * thrust - GRAVITY_M_S2


def _solve(function: Callable[[float], float], value: float) -> float:
    """The angle within +-pi/2 at which a rising function takes `value`."""
    return float(brentq(lambda angle: function(angle) - value, -pi / 2.0, pi / 2.0))


def _equation_11() -> Erratum:
    """As printed, the sum runs over i and uses w_ii, which is zero: no neighbour remains."""
    platoon = interaction_matrix(PLATOON, {1}, Weighted())
    left = platoon.sum(axis=1)  # rows of G add up to w_i^l
    return erratum_of("eq. 11", left=", ".join(f"{abs(round(value, 9)):g}" for value in left))


def _algorithm_1() -> Erratum:
    graph, leaders = PLATOON, {1}
    printed, right = printed_prcs(graph, leaders), settled_prcs(graph, leaders)
    return erratum_of("Algorithm 1, line 3", printed=_by_id(printed), right=_by_id(right))


def _algorithm_2() -> Erratum:
    graph: dict[int, set[int]] = {1: set(), 2: set()}
    matrix = interaction_matrix(graph, {1}, Weighted())
    count = len(neighbour_weights(()))
    return erratum_of("Algorithm 2", count=count, leader=matrix[0, 0], follower=matrix[1, 1])


def _equation_16() -> Erratum:
    """Without the bracket, -K does not change the minus sign of the neighbours' errors."""
    platoon = interaction_matrix(PLATOON, {1}, Weighted())
    return erratum_of("eq. 16, the line before it", without=np.abs(platoon[1]).sum(), right=platoon[1].sum())


def _equation_26() -> Erratum:
    least = [lambda_min(interaction_matrix(PLATOON, {1}, law)) for law in (Average22(), Average26())]
    return erratum_of("eq. 26", least_22=least[0], least_26=least[1])


def _by_id(prcs: Mapping[int, int]) -> str:
    return ", ".join(str(prcs[i]) for i in sorted(prcs))
