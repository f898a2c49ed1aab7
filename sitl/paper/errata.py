"""Errors and omissions of the printed paper, with the correct form and the computed result of the printed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import cos, degrees, dist, hypot, pi, radians, sin, tan

import numpy as np

from companion.analysis.interaction import interaction_matrix
from companion.analysis.response import settled_prcs
from companion.core.consensus.law import average_22, average_26, neighbour_weights, weighted
from companion.core.control.setpoint import attitude_target
from companion.types.values import GRAVITY_M_S2
from sitl.paper.spectrum import lambda_min
from sitl.paper.theorems import printed_prcs
from sitl.report.claim import Erratum
from sitl.study.shapes import chain

PLATOON = chain(4).adjacency()
ASKED_M_S2 = (1.0, 0.5, 0.0)  # acceleration with which eq. 8 is tried
ASKED_YAW_RAD = radians(30.0)


def errata() -> list[Erratum]:
    """All errata in the order of the paper."""
    return [
        _equation_8(),
        _equation_11(),
        Erratum(
            place="eq. 12",
            printed="e_i = x_i - r - d_i0",
            right="e_i = x_i - R - d_i0 with R = [r, r'], since x_i also contains a velocity",
        ),
        _algorithm_1(),
        _algorithm_2(),
        _equation_16(),
        Erratum(
            place="K in section 5.1.1",
            printed="diag{1.39, 1.2}",
            right="K = [k1, k2], one row: k1 = 1.39 1/s^2 on position, k2 = 1.2 1/s on velocity",
        ),
        _equation_26(),
        Erratum(
            place="text to figure 10",
            printed="followers 1, 2 and 3",
            right="the followers are counted here; these are not the UAV numbers, since UAV 1 or 2 is the leader",
        ),
    ]


def _equation_8() -> Erratum:
    """Solve both forms of eq. 8 for the attitude, and compute its acceleration by eq. 2 with the thrust of eq. 7."""
    tilt_rad = max(abs(angle) for angle in printed_attitude())
    right_error, printed_error = (
        dist(acceleration_of(*form()), ASKED_M_S2) for form in (right_attitude, printed_attitude)
    )
    return Erratum(
        place="eq. 8",
        printed="[tan(phi)/cos(theta) - phi, tan(theta) - theta]",
        right="[tan(phi)/cos(theta), tan(theta)]; inverse, with a = u/(uZ + g): theta = atan(aX cos psi + aY sin psi), "
        "phi = atan(cos(theta) (aX sin psi - aY cos psi))",
        shown=f"for {hypot(*ASKED_M_S2):.2f} m/s^2 the printed form tilts to {degrees(tilt_rad):.0f} deg, with an error of "
        f"{printed_error:.1f} m/s^2; the error of the correct form is {right_error:.1g}",
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
    """The angle within +-pi/2 at which a rising function takes `value`, by bisection."""
    low, high = -pi / 2.0, pi / 2.0
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (middle, high) if function(middle) < value else (low, middle)
    return low


def _equation_11() -> Erratum:
    """As printed, the sum runs over i and uses w_ii, which is zero: no neighbour remains."""
    platoon = interaction_matrix(PLATOON, {1}, weighted())
    left = platoon.sum(axis=1)  # rows of G add up to w_i^l
    listed = ", ".join(f"{abs(round(value, 9)):g}" for value in left)
    return Erratum(
        place="eq. 11",
        printed="z_i = w_i^l (x_i - r) + sum over i of w_ii (x_i - x_j)",
        right="z_i = w_i^l (x_i - R) + sum over j of w_ij (x_i - x_j), with R = [r, r']",
        shown=f"with w_ii = 0 the platoon's G would be diag({listed}): followers would not move",
    )


def _algorithm_1() -> Erratum:
    graph, leaders = PLATOON, {1}
    printed, right = printed_prcs(graph, leaders), settled_prcs(graph, leaders)
    return Erratum(
        place="Algorithm 1, line 3",
        printed="per[j] = p_i(k)",
        right="per[j] = p_j(k), started from p = n (a leader from 1); sigma_n(x) = sgn(x) min(n, |x|)",
        shown=f"PrCs of the platoon are {_listed(printed)} as printed, without effect of the leader, and {_listed(right)} if "
        "corrected",
    )


def _algorithm_2() -> Erratum:
    graph: dict[int, set[int]] = {1: set(), 2: set()}
    matrix = interaction_matrix(graph, {1}, weighted())
    count = len(neighbour_weights([], weighted().weighting))
    return Erratum(
        place="Algorithm 2",
        printed="vehicles without neighbours are not treated: the sum in the denominator is 0",
        right="all its weights are 0: a leader follows the reference alone, a follower gets no command",
        shown=f"{count} weights; G of a leader and a follower out of range of each other is "
        f"diag({matrix[0, 0]:g}, {matrix[1, 1]:g})",
    )


def _equation_16() -> Erratum:
    """Without the bracket, -K does not change the minus sign of the neighbours' errors."""
    platoon = interaction_matrix(PLATOON, {1}, weighted())
    return Erratum(
        place="eq. 16, the line before it",
        printed="u_i = -K (sum w_ij + w_i^l) e_i - sum w_ij e_j), with a bracket missing",
        right="u_i = -K ((sum over j of w_ij + w_i^l) e_i - sum over j of w_ij e_j)",
        shown=f"without the bracket a follower's row of G would add up to {np.abs(platoon[1]).sum():g} instead of "
        f"{platoon[1].sum():g}: followers would need the reference",
    )


def _equation_26() -> Erratum:
    least = [lambda_min(interaction_matrix(PLATOON, {1}, law)) for law in (average_22(), average_26())]
    return Erratum(
        place="eq. 26",
        printed="the average law of the simulations: the leader follows the reference alone",
        right="eq. 22 and eq. 26 are two different laws: G1 of eq. 27 belongs to eq. 26, the proofs use eq. 22; a claim above "
        "treats which of them figures 4 and 6 show",
        shown=f"lambda_min of the platoon is {least[0]:.4f} with eq. 22 and {least[1]:.4f} with eq. 26",
    )


def _listed(prcs: Mapping[int, int]) -> str:
    return ", ".join(str(prcs[i]) for i in sorted(prcs))
