"""State matrix of the linear model, x' = A x: stability and worst-case transient peak.

Delays are first-order Pade filters, (1 - s d/2) / (1 + s d/2). Their phase matches the delay up to
1/d and beyond, which is faster than any formation responds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.stability.arrays import FloatArray
from companion.stability.interaction import Coupling, eigenvalues
from companion.stability.prediction import LinearModel

SHORTEST_S = 1e-3  # lower limit of lag and delays, so that every filter has a state
STEP_S = 0.1
# (factor of the step length, number of steps): waves along a chain come before slow oscillations
WATCHED = ((1, 150), (5, 300), (8, 60))


def state_matrix(coupling: Coupling, model: LinearModel) -> FloatArray:
    """A (5n, 5n) of x = [e, e', e'', z, z_f]; z filters the command on its way to the motors.

    z_f filters the command on its way to the neighbours. The output of a Pade filter is 2 z - input,
    with z' = (2/d)(input - z): u = -K (G e) + g W (2 z_f - u), so
    (I + g W) u = -G (k1 e + k2 e') + 2 g W z_f, which can be solved because g < 1.
    """
    n = len(coupling.G)
    one, zero = np.eye(n), np.zeros((n, n))
    gains = coupling.law.gains
    lag_s, delay_s, forward_delay_s = (
        max(value, SHORTEST_S) for value in (model.attitude_lag_s, model.delay_s, model.feedforward_delay_s)
    )
    forward = coupling.law.feedforward * coupling.W
    to_u = np.linalg.inv(one + forward)
    fed_back = -to_u @ coupling.G
    u = np.hstack([gains.position_1_s2 * fed_back, gains.velocity_1_s * fed_back, zero, zero, 2.0 * to_u @ forward])
    e2 = np.hstack([zero, zero, one, zero, zero])
    to_motors = np.hstack([zero, zero, zero, one, zero])
    to_neighbours = np.hstack([zero, zero, zero, zero, one])
    velocity = np.hstack([zero, one, zero, zero, zero])
    return np.vstack(
        [
            velocity,
            e2,
            (2.0 * to_motors - u - e2) / lag_s,
            (u - to_motors) * (2.0 / delay_s),
            (u - to_neighbours) * (2.0 / forward_delay_s),
        ]
    )


def is_stable(coupling: Coupling, model: LinearModel) -> bool:
    """Whether all errors of the coupled system decay.

    Without feed-forward each eigenvalue of G is checked as a system of its own.
    """
    systems = [coupling]
    if coupling.law.feedforward == 0.0:
        alone = np.zeros((1, 1))
        systems = [replace(coupling, G=np.array([[value]]), W=alone) for value in eigenvalues(coupling.G)]
    return all(np.linalg.eigvals(state_matrix(system, model)).real.max() < 0.0 for system in systems)


def worst_transient_peak(coupling: Coupling, model: LinearModel) -> float | None:
    """sup over t of |exp(A t)|, positions to positions, in the maximum norm; None if A is unstable.

    It is the largest error [m] that a start from rest with errors up to 1 m can lead to.
    """
    if not is_stable(coupling, model):
        return None
    n = len(coupling.G)
    matrix = state_matrix(coupling, model)
    states = np.vstack([np.eye(n), np.zeros((4 * n, n))])
    peak = 1.0
    transition = _exponential(matrix * STEP_S)
    for longer, steps in WATCHED:
        transition = np.linalg.matrix_power(transition, longer)
        for _ in range(steps):
            states = transition @ states
            peak = max(peak, float(np.abs(states[:n]).sum(axis=1).max()))
    return peak


def _exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential by scaling and squaring of a Taylor series."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(matrix).sum(axis=1).max(), 1e-300)))) + 2)
    small = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, 13):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total
