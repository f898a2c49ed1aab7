"""References of the leaders of a batch. Each distinct trajectory is evaluated once per time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.config.reference import Reference
from companion.core.reference.blend import ReferenceTrajectory
from companion.types.formation import FormationState
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.flight.scenario import Scenario, reference_of


class References:
    """References of all columns, constant before t = 0."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, is_leader: BoolArray) -> None:
        kinds: dict[Reference, int] = {}
        self._trajectories: list[ReferenceTrajectory] = []
        of_formation = np.zeros(len(scenarios), dtype=np.int64)
        for b, scenario in enumerate(scenarios):
            if scenario.reference not in kinds:
                kinds[scenario.reference] = len(self._trajectories)
                self._trajectories.append(reference_of(scenario))
            of_formation[b] = kinds[scenario.reference]
        self._of_formation = of_formation
        self._groups = columns.groups
        self._leaders: list[IntArray] = []
        self._kinds: list[IntArray] = []  # the distinct references of each group
        self._which: list[IntArray] = []  # for each leader, the index of its reference in `_kinds`
        of_column = of_formation[columns.formation]
        for group in columns.groups:
            leaders = np.flatnonzero(is_leader[group])
            distinct, which = np.unique(of_column[group][leaders], return_inverse=True)
            self._leaders.append(leaders)
            self._kinds.append(distinct)
            self._which.append(which)

    def at(self, phase: int, reference_s: float) -> FloatArray:
        """R and r'' (9, G) for the leaders of the group of this phase, NaN for the others."""
        group = self._groups[phase]
        rows = np.array([_row(self._trajectories[kind](max(0.0, reference_s))) for kind in self._kinds[phase].tolist()])
        of_all = np.full((9, group.stop - group.start), np.nan)
        of_all[:, self._leaders[phase]] = rows.reshape(-1, 9)[self._which[phase]].T
        return of_all

    def positions_enu_m(self, reference_s: FloatArray) -> FloatArray:
        """r (ticks, 3) where all formations have the same, else (ticks, B, 3)."""
        times_s = np.maximum(0.0, reference_s).tolist()
        of_kind = np.array(
            [[reference(time_s).position_enu_m for reference in self._trajectories] for time_s in times_s]
        )
        return of_kind[:, 0] if len(self._trajectories) == 1 else of_kind[:, self._of_formation]


def _row(place: FormationState) -> tuple[float, ...]:
    return (*place.position_enu_m, *place.velocity_enu_m_s, *place.acceleration_enu_m_s2)
