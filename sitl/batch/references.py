"""The reference trajectories of many formations: each distinct one is asked once for a time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.config.reference import Reference
from companion.core.arrays import FloatArray
from companion.core.formation import Place
from companion.core.reference import ReferenceTrajectory
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.scenario import Scenario, reference_of


class References:
    """Before its beginning an RFT stands still. `leaders[g]` (L,) are those columns of group g that know a reference."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, leads: BoolArray) -> None:
        kinds: dict[Reference, int] = {}
        self._trajectories: list[ReferenceTrajectory] = []
        of_formation = np.zeros(len(scenarios), dtype=np.int64)
        for b, scenario in enumerate(scenarios):
            if scenario.reference not in kinds:
                kinds[scenario.reference] = len(self._trajectories)
                self._trajectories.append(reference_of(scenario))
            of_formation[b] = kinds[scenario.reference]
        self._of_formation = of_formation
        self.leaders: list[IntArray] = []
        self._kinds: list[IntArray] = []  # the distinct references of a group, and which of them each leader has
        self._which: list[IntArray] = []
        of_column = of_formation[columns.formation]
        for group in columns.groups:
            places = np.flatnonzero(leads[group])
            distinct, which = np.unique(of_column[group][places], return_inverse=True)
            self.leaders.append(places)
            self._kinds.append(distinct)
            self._which.append(which)

    def at(self, group: int, reference_s: float) -> FloatArray:
        """R and r'' (9, L) for the leaders of this group: position, velocity, acceleration."""
        rows = np.array([_row(self._trajectories[kind](max(0.0, reference_s))) for kind in self._kinds[group].tolist()])
        return rows.reshape(-1, 9)[self._which[group]].T

    def positions_enu_m(self, reference_s: FloatArray) -> FloatArray:
        """r (ticks, 3) where all formations have the same, else (ticks, B, 3)."""
        of_kind = np.array(
            [
                [trajectory(t).position_enu_m for trajectory in self._trajectories]
                for t in np.maximum(0.0, reference_s).tolist()
            ]
        )
        return of_kind[:, 0] if len(self._trajectories) == 1 else of_kind[:, self._of_formation]


def _row(place: Place) -> tuple[float, ...]:
    return (*place.position_enu_m, *place.velocity_enu_m_s, *place.acceleration_enu_m_s2)
