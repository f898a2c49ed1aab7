"""The paper's equations without agents, to check the flights: double integrators under u = -K G e at 50 Hz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from companion.assembly import law_of
from companion.config.fleet import EdgeNeighbours
from companion.stability.arrays import FloatArray
from companion.stability.interaction import interaction_matrix
from companion.types.flight import Role
from sitl.paper.flights import FlownPlan
from sitl.paper.theory.graphs import graph_of
from sitl.report.metrics import settle_time_s

STEP_S = 0.005
TICK_STEPS = 4  # 50 Hz


@dataclass(frozen=True, slots=True)
class IdealFigures:
    """Figures of the ideal model. `max_distance_m` is by pair of neighbouring ids, as in `FormationFigures`."""

    max_distance_m: Mapping[str, float]
    settle_s: float | None


def ideal_figures(flown: FlownPlan, delay_s: float) -> IdealFigures:
    """Figures of a flight along x by eq. 2 and the law, from its true start; neighbour states are delayed by `delay_s`."""
    fleet, flight = flown.scenario.fleet, flown.flight()
    if not isinstance(fleet.neighbours, EdgeNeighbours):
        raise TypeError("eq. 18 needs a fixed graph")
    ids = sorted(flight.tracks)
    leaders = {member.id for member in fleet.vehicles if member.role is Role.LEADER}
    matrix = interaction_matrix(graph_of(ids, fleet.neighbours.edges), leaders, law_of(fleet.law))
    slots_m = np.array([flight.slots_enu_m[i][0] for i in ids])
    starts_m = np.array([flown.scenario.starts_enu_m[i][0] for i in ids])
    errors_m = starts_m - flight.reference(0.0).position_enu_m[0] - slots_m
    gains = law_of(fleet.law).gains
    duration_s = flight.formation.end_s - flight.formation.start_s
    history_m = _errors_m(matrix, (gains.position_1_s2, gains.velocity_1_s), errors_m, duration_s, delay_s)
    apart_m = np.abs(np.diff(history_m + slots_m, axis=1)).max(axis=0)
    times_s = STEP_S * np.arange(len(history_m), dtype=np.float64)
    return IdealFigures(
        max_distance_m={f"{i}-{j}": float(d) for i, j, d in zip(ids, ids[1:], apart_m, strict=False)},
        settle_s=settle_time_s(times_s, np.asarray(np.abs(history_m).max(axis=1))),
    )


def _errors_m(
    matrix: FloatArray, gains: tuple[float, float], start_m: FloatArray, duration_s: float, delay_s: float
) -> FloatArray:
    """Errors (steps, n) from rest. The own state is current, those of neighbours (off the diagonal of G) are delayed."""
    own, others = np.diag(np.diag(matrix)), matrix - np.diag(np.diag(matrix))
    late = round(delay_s / STEP_S)
    position_m, velocity_m_s, u = start_m.astype(float), np.zeros(len(start_m)), np.zeros(len(start_m))
    feedback = [gains[0] * position_m]  # K e of every step
    history = []
    for step in range(round(duration_s / STEP_S)):
        history.append(position_m)
        if step % TICK_STEPS == 0:
            u = -(own @ feedback[-1]) - others @ feedback[max(0, len(feedback) - 1 - late)]
        position_m = position_m + velocity_m_s * STEP_S + 0.5 * u * STEP_S**2
        velocity_m_s = velocity_m_s + u * STEP_S
        feedback.append(gains[0] * position_m + gains[1] * velocity_m_s)
    return np.array(history)
