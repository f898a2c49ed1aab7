"""companion.core.formation for many vehicles: neighbours' packets, weights and reference -> acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.assembly import law_of
from companion.core.arrays import FloatArray
from companion.types import Role
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.scenario import Scenario


class Laws:
    """What each column flies by. Everything per column is (B n,) or (k, B n)."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        laws = [law_of(scenario.fleet.law) for scenario in scenarios]
        holds = [scenario.fleet.law.altitude == "hold" for scenario in scenarios]
        hold_gains = [scenario.fleet.law.altitude_hold_gains for scenario in scenarios]
        members = [sorted(scenario.fleet.vehicles, key=lambda member: member.id) for scenario in scenarios]
        leads = np.array([[float(member.role is Role.LEADER) for member in row] for row in members])
        slots = np.array([[member.slot_enu_m for member in row] for row in members], dtype=np.float64)
        self.slots_by_vehicle_enu_m: FloatArray = slots
        self.slot_enu_m = columns.in_columns(slots)
        self.leads: BoolArray = columns.in_columns(leads)[0] > 0.0
        self.exponent = columns.spread([law.exponent for law in laws])
        self._vehicles = columns.vehicles
        self._k1 = columns.spread([law.gains.position_1_s2 for law in laws])
        self._k2 = columns.spread([law.gains.velocity_1_s for law in laws])
        self._feedforward = columns.spread([law.feedforward for law in laws])
        heeds = columns.spread([float(law.leader_heeds_neighbours) for law in laws])
        self._heed: FloatArray = np.where(self.leads, heeds, 1.0)
        self._holds: BoolArray = columns.spread([float(hold) for hold in holds]) > 0.0
        self._hold_k1 = columns.spread([gains.position_1_s2 for gains in hold_gains])
        self._hold_k2 = columns.spread([gains.velocity_1_s for gains in hold_gains])

    def shares(self, prcs: FloatArray, group: slice) -> FloatArray:
        """p^-alpha, what a vehicle's PrC is worth to others before they make it a weight."""
        return np.asarray(prcs ** -self.exponent[group])

    def next_prcs(self, neighbour_prcs: FloatArray, members: BoolArray, group: slice) -> FloatArray:
        """Algorithm 1: `neighbour_prcs` and `members` (G, K) -> (G,)."""
        nearest = np.where(members, neighbour_prcs, float(self._vehicles)).min(axis=1)
        prcs = np.minimum(nearest + 1.0, float(self._vehicles))
        prcs[self.leads[group]] = 1.0
        return np.asarray(prcs)

    def acceleration(
        self,
        group: slice,
        own: FloatArray,
        hold_altitude_m: FloatArray,
        together: FloatArray,
        has_neighbours: BoolArray,
        leaders: IntArray,
        reference: FloatArray,
    ) -> FloatArray:
        """u_i (3, G) in ENU before any limit.

        `own` (6, G) is a vehicle's position less its slot and its velocity. `together` (9, G) is the weighted sum over its
        neighbours' places, velocities and acceleration commands. `reference` (9, L) is R and r'' for the columns `leaders`
        (L,) of this group.
        """
        heed = self._heed[group]
        coupled = heed * has_neighbours + self.leads[group]
        error = own * coupled
        error -= together[:6] * heed
        error[:, leaders] -= reference[:6]
        wanted = error[:3] * -self._k1[group]
        wanted -= error[3:] * self._k2[group]
        if self._feedforward.any():
            ahead = together[6:9]
            ahead[:, leaders] = reference[6:9]
            wanted += ahead * self._feedforward[group]
        holds = self._holds[group]
        if holds.any():
            climb_m = own[2] + self.slot_enu_m[2, group] - hold_altitude_m[group]
            kept = -self._hold_k1[group] * climb_m - self._hold_k2[group] * own[5]
            np.copyto(wanted[2], kept, where=holds)
        return wanted
