"""companion.core.consensus.law for many vehicles: packets of the neighbours, weights and reference -> acceleration.

Each distinct reference trajectory is evaluated once per time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.config.law import feedback_law_of
from companion.config.reference import Reference
from companion.core.reference.blend import ReferenceTrajectory
from companion.types.flight import Role
from companion.types.formation import FormationState
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.flight.files import known_drag_1_s
from sitl.flight.scenario import Scenario, reference_of


class BatchLaws:
    """Law, role and slot of each column. Arrays per column are (B n,) or (k, B n)."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        laws = [feedback_law_of(scenario.fleet.law) for scenario in scenarios]
        holds = [scenario.fleet.law.altitude == "hold" for scenario in scenarios]
        hold_gains = [scenario.fleet.law.altitude_hold_gains for scenario in scenarios]
        members = [sorted(scenario.fleet.vehicles, key=lambda member: member.id) for scenario in scenarios]
        leaders = np.array([[float(member.role is Role.LEADER) for member in row] for row in members])
        slots = np.array([[member.slot_enu_m for member in row] for row in members], dtype=np.float64)
        self.slots_by_vehicle_enu_m: FloatArray = slots
        self.slot_enu_m = columns.in_columns(slots)
        self.is_leader: BoolArray = columns.in_columns(leaders)[0] > 0.0
        self._exponent = columns.spread([law.exponent for law in laws])
        self._ratio = columns.spread([law.weight_ratio for law in laws])
        self._vehicles = columns.vehicles
        self._k1 = columns.spread([law.position_gain_1_s2 for law in laws])
        self._k2 = columns.spread([law.velocity_gain_1_s for law in laws])
        self._feedforward = columns.spread([law.feedforward for law in laws])
        self._drag_1_s = columns.spread([known_drag_1_s(scenario) for scenario in scenarios])
        coupled = columns.spread([float(law.leader_uses_neighbours) for law in laws])
        self._uses_neighbours: FloatArray = np.where(self.is_leader, coupled, 1.0)
        self._holds: BoolArray = columns.spread([float(hold) for hold in holds]) > 0.0
        self._hold_k1 = columns.spread([gains.position_1_s2 for gains in hold_gains])
        self._hold_k2 = columns.spread([gains.velocity_1_s for gains in hold_gains])

    def shares(self, prcs: FloatArray, group: slice) -> FloatArray:
        """p^-alpha (G,): the part of its weights that a vehicle can tell its neighbours."""
        return np.asarray(prcs ** -self._exponent[group])

    def by_hops(self, shares: FloatArray, prcs: FloatArray, fresh: BoolArray, group: slice) -> FloatArray:
        """`shares` (G, K) of the neighbours times rho^p, counted from the nearest one; 0 for those that are not `fresh`."""
        shares = shares * fresh
        ratio = self._ratio[group]
        if (ratio == 1.0).all():
            return np.asarray(shares)
        least = np.where(fresh, prcs, np.inf).min(axis=1, initial=np.inf)
        hops = np.where(fresh, prcs - least[:, None], 0.0)
        return np.asarray(shares * ratio[:, None] ** hops)

    def next_prcs(self, neighbour_prcs: FloatArray, members: BoolArray, group: slice) -> FloatArray:
        """Algorithm 1: PrCs (G,) after one tick from `neighbour_prcs` and `members` (G, K)."""
        nearest = np.where(members, neighbour_prcs, float(self._vehicles)).min(axis=1)
        prcs = np.minimum(nearest + 1.0, float(self._vehicles))
        prcs[self.is_leader[group]] = 1.0
        return np.asarray(prcs)

    def acceleration(
        self,
        group: slice,
        own: FloatArray,
        hold_altitude_m: FloatArray,
        weighted_sum: FloatArray,
        has_neighbours: BoolArray,
        leaders: IntArray,
        reference: FloatArray,
    ) -> FloatArray:
        """u_i (3, G) in ENU before any limit.

        `own` (6, G) is a vehicle's position minus its slot, and its velocity. `weighted_sum` (9, G) is the weighted sum over
        the neighbours of position minus slot, velocity and acceleration command. `reference` (9, L) is R and r'' for the
        columns `leaders` (L,) of this group.
        """
        coupling = self._uses_neighbours[group]
        error = own * (coupling * has_neighbours + self.is_leader[group])
        error -= weighted_sum[:6] * coupling
        error[:, leaders] -= reference[:6]
        acceleration = error[:3] * -self._k1[group]
        acceleration -= error[3:] * self._k2[group]
        if self._feedforward.any():
            fed_forward = weighted_sum[6:9]
            fed_forward[:, leaders] = reference[6:9] + reference[3:6] * self._drag_1_s[group][leaders]
            acceleration += fed_forward * self._feedforward[group]
        holds = self._holds[group]
        if holds.any():
            climb_m = own[2] + self.slot_enu_m[2, group] - hold_altitude_m[group]
            vertical = -self._hold_k1[group] * climb_m - self._hold_k2[group] * own[5]
            np.copyto(acceleration[2], vertical, where=holds)
        return acceleration


class References:
    """References of all columns, constant before t = 0. `leaders[g]` (L,) are the columns of group g with a reference."""

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
        self.leaders: list[IntArray] = []
        self._kinds: list[IntArray] = []  # the distinct references of each group
        self._which: list[IntArray] = []  # for each leader, the index of its reference in `_kinds`
        of_column = of_formation[columns.formation]
        for group in columns.groups:
            leaders = np.flatnonzero(is_leader[group])
            distinct, which = np.unique(of_column[group][leaders], return_inverse=True)
            self.leaders.append(leaders)
            self._kinds.append(distinct)
            self._which.append(which)

    def at(self, group: int, reference_s: float) -> FloatArray:
        """R and r'' (9, L) for the leaders of this group."""
        rows = np.array([_row(self._trajectories[kind](max(0.0, reference_s))) for kind in self._kinds[group].tolist()])
        return rows.reshape(-1, 9)[self._which[group]].T

    def positions_enu_m(self, reference_s: FloatArray) -> FloatArray:
        """r (ticks, 3) where all formations have the same, else (ticks, B, 3)."""
        times_s = np.maximum(0.0, reference_s).tolist()
        of_kind = np.array(
            [[reference(time_s).position_enu_m for reference in self._trajectories] for time_s in times_s]
        )
        return of_kind[:, 0] if len(self._trajectories) == 1 else of_kind[:, self._of_formation]


def _row(place: FormationState) -> tuple[float, ...]:
    return (*place.position_enu_m, *place.velocity_enu_m_s, *place.acceleration_enu_m_s2)
