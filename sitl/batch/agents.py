"""companion.core.agent in formation, for many vehicles: what a group of them knows -> its attitude targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.core.arrays import FloatArray
from sitl.autopilot import DT_S
from sitl.batch.candidates import Candidates
from sitl.batch.columns import BoolArray, Columns
from sitl.batch.commands import Commands
from sitl.batch.laws import Laws
from sitl.batch.packets import ACCELERATION, PLACE, PRC, SHARE, VELOCITY, WIDTH, Heard, Packets
from sitl.batch.references import References
from sitl.scenario import Scenario
from sitl.world import TELEMETRY_STEPS


class Agents:
    """All agents of a batch. `told` (9, k) is what autopilots tell: position, velocity, roll, pitch, yaw of FLU in ENU."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        columns: Columns,
        laws: Laws,
        references: References,
        candidates: Candidates,
        told: FloatArray,
    ) -> None:
        self._columns = columns
        self._laws = laws
        self._references = references
        self._candidates = candidates
        self._commands = Commands(scenarios, columns, DT_S * TELEMETRY_STEPS)
        self._commands.open_at(told[6:9])
        self._hold_altitude_m = told[2].copy()
        slots = laws.slot_enu_m.T
        self._slots_apart_m = slots[candidates.sender] - slots[:, None, :] if candidates.by_range else np.zeros(0)
        packets = np.zeros((WIDTH, columns.count))
        packets[PLACE], packets[VELOCITY] = told[:3] - laws.slot_enu_m, told[3:6]
        self._members = self._first_members(packets)
        packets[PRC] = self._first_prcs()
        packets[SHARE] = laws.shares(packets[PRC], slice(0, columns.count))
        self._packets = Packets(scenarios, columns, candidates, packets)

    def targets(self, group: slice) -> FloatArray:
        """What was commanded last: (5, G) quaternion and thrust."""
        return self._commands.targets(group)

    def decide(self, tick: int, phase: int, reference_s: float, told: FloatArray) -> FloatArray:
        """One tick of the agents of this phase, so far into the RFT: (5, G) quaternion and thrust."""
        group, laws = self._columns.groups[phase], self._laws
        own = told[:6].copy()
        own[:3] -= laws.slot_enu_m[:, group]
        heard = self._packets.hear(tick, group)
        heeded = self._heeded(group, own[:3], heard)
        packets = self._packets.packets(heeded)
        prcs = laws.next_prcs(packets[:, :, PRC], heeded.fresh, group)
        together, has_neighbours = _together(heeded, packets)
        acceleration = laws.acceleration(
            group,
            own,
            self._hold_altitude_m,
            together,
            has_neighbours,
            self._references.leaders[phase],
            self._references.at(phase, reference_s),
        )
        self._commands.limit(acceleration, group)
        told_to_peers = np.empty((WIDTH, prcs.size))
        told_to_peers[:6], told_to_peers[ACCELERATION], told_to_peers[PRC] = own, acceleration, prcs
        told_to_peers[SHARE] = laws.shares(prcs, group)
        self._packets.send(tick, group, told_to_peers)
        return self._commands.admitted(acceleration, told[6], told[7], group)

    def relation(self) -> BoolArray:
        """Who heeds whom (B, n, n), by rising ids."""
        columns, n = self._columns, self._columns.vehicles
        receiver, place = np.nonzero(self._members)
        sender = self._candidates.sender[receiver, place]
        relation = np.zeros((columns.count, n), dtype=np.bool_)
        relation[columns.order[receiver], columns.order[sender] % n] = True
        return relation.reshape(columns.formations, n, n)

    def _heeded(self, group: slice, own_place_enu_m: FloatArray, heard: Heard) -> Heard:
        """N_i of these vehicles, remembered for the hysteresis."""
        if not self._candidates.by_range:
            self._members[group] = heard.fresh
            return heard
        members = self._in_range(group, own_place_enu_m, self._packets.places_now_enu_m(heard))
        members &= heard.fresh
        self._members[group] = members
        return heard.only(members)

    def _in_range(self, group: slice, own_place_enu_m: FloatArray, places_enu_m: FloatArray) -> BoolArray:
        """`own_place_enu_m` (3, G), `places_enu_m` (G, K, 3), both less their slots."""
        apart_m = places_enu_m - own_place_enu_m.T[:, None, :]
        apart_m += self._slots_apart_m[group]
        square_m2 = np.einsum("gkx,gkx->gk", apart_m, apart_m)
        candidates = self._candidates
        limit_m = np.where(self._members[group], candidates.leave_m[group, None], candidates.join_m[group, None])
        return np.asarray(square_m2 <= np.square(limit_m, out=limit_m))

    def _first_members(self, packets: FloatArray) -> BoolArray:
        """As after a while of hovering within earshot."""
        everybody = slice(0, self._columns.count)
        self._members = np.zeros(self._candidates.valid.shape, dtype=np.bool_)
        if not self._candidates.by_range:
            return self._candidates.valid.copy()
        places = packets[PLACE].T[self._candidates.sender]
        return np.asarray(self._in_range(everybody, packets[PLACE], places) & self._candidates.valid)

    def _first_prcs(self) -> FloatArray:
        """Where Algorithm 1 comes to rest among the first neighbours."""
        everybody, n = slice(0, self._columns.count), self._columns.vehicles
        prcs = np.full(self._columns.count, float(n))
        for _ in range(n):
            prcs = self._laws.next_prcs(prcs[self._candidates.sender], self._members, everybody)
        return prcs


def _together(heeded: Heard, packets: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Algorithm 2: weighted sums (9, G) of the neighbours' places carried on, velocities and accelerations; are there any?"""
    weights = packets[:, :, SHARE] * heeded.fresh
    total = weights.sum(axis=1)
    has_neighbours = total > 0.0
    weights /= np.where(has_neighbours, total, 1.0)[:, None]
    sums = np.matmul(weights[:, None, :], packets[:, :, :9])[:, 0].T
    if heeded.age_s is not None:
        way = np.matmul((weights * heeded.age_s)[:, None, :], packets[:, :, VELOCITY])[:, 0].T
        sums[PLACE] += way
    return sums, has_neighbours
