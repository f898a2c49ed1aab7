"""Resilient consensus: L. Yuan and H. Ishii, "Dynamic Leader-Follower Consensus with Adversaries: A Multi-Hop Relay Approach",
arXiv 2511.19327 (2025), which supersedes their arXiv 2411.09954. The filter is W-MSR, with leaders first in J. Usevitch and
D. Panagou, arXiv 1906.09096.

A neighbour that lies draws no vehicle off: of its neighbours, a follower drops the f that disagree most with the others, and
follows the mean of the rest.

As published: f, the number of neighbours of a vehicle that may lie; that a neighbour is dropped as a whole; the plain mean of
the rest; the graphs, in which each follower needs 2f + 1 neighbours. Not as published:
- What counts is a norm, of position, velocity and acceleration together. W-MSR looks at each axis alone, which depends on the
  frame.
- Neighbours are compared with each other. W-MSR compares them with the own value, and drops f above and f below it. A norm
  has no above and below. Dropping the f farthest from the own state keeps a liar that stays a little ahead of its victim, and
  drops an honest neighbour in its place: it draws the victim on without end.
- Velocities and accelerations of neighbours count. Published is damping of the own velocity, and a term that demands
  100 m/s^2 so as to follow a leader that moves.
- Of more than 2f + 1 neighbours, those nearest to a leader by PrC count, as the edges of a fleet have two directions.
- A leader is not known to be honest. Published are direct followers that follow it alone.
So the published bounds are not those of this law.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import hypot
from typing import Annotated

from msgspec import Meta
from msgspec.structs import replace

from companion.laws import FormationState, Gain, Law, Neighbour, Own
from companion.laws._followed import followed
from companion.laws.weighted import Share
from companion.types.values import ZERO3, Vector3

MostLiars = Annotated[int, Meta(ge=0, le=5)]


class Trimmed(Law, frozen=True):
    """The mean of the neighbours without those that differ most from the others: some may lie (after Yuan and Ishii).

    u_i = -k1 (y_i - y_K) - k2 (v_i - v_K) + g u_K with the means over the neighbours that are kept. A follower
    of 2f neighbours or fewer cannot tell who lies: it drops the minority that it can, none of one or two.

    most_liars: f, how many neighbours of a vehicle may lie
    position_gain_1_s2: k1 of K = [k1, k2], on the position error
    velocity_gain_1_s: k2 of K = [k1, k2], on the velocity error
    feedforward: share of the kept neighbours' acceleration that is fed forward
    """

    most_liars: MostLiars = 1
    position_gain_1_s2: Gain = 2.0
    velocity_gain_1_s: Gain = 2.4
    feedforward: Share = 0.98

    def near_formation(self) -> Law:
        """The mean of the nearest neighbours: where all agree, dropping the one that is moved would leave no coupling."""
        return replace(self, most_liars=0)

    def weights(self, leads: bool, prcs: Sequence[int]) -> tuple[float, ...]:
        """Equal ones for the 2f + 1 neighbours nearest to a leader, and for all as near as the last of them."""
        if leads or not prcs:
            return ()
        farthest = sorted(prcs)[: 2 * self.most_liars + 1][-1]
        near = [float(prc <= farthest) for prc in prcs]
        return tuple([each / sum(near) for each in near])

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """Zero for a follower without neighbours."""
        kept = self._kept(neighbours) if reference is None else ()
        target = followed(own, kept, [1.0 / len(kept) for _ in kept], reference)
        if target is None:
            return ZERO3
        k1, k2, g = self.position_gain_1_s2, self.velocity_gain_1_s, self.feedforward
        (x, y, z), (tx, ty, tz) = own.position_enu_m, target.position_enu_m
        (vx, vy, vz), (tvx, tvy, tvz) = own.velocity_enu_m_s, target.velocity_enu_m_s
        ax, ay, az = target.acceleration_enu_m_s2
        return (
            -k1 * (x - tx) - k2 * (vx - tvx) + g * ax,
            -k1 * (y - ty) - k2 * (vy - tvy) + g * ay,
            -k1 * (z - tz) - k2 * (vz - tvz) + g * az,
        )

    def _kept(self, neighbours: Sequence[Neighbour]) -> Sequence[Neighbour]:
        """The neighbours that count, without the f that differ most from the others, or without the minority."""
        weights = self.weights(False, [neighbour.prc for neighbour in neighbours])
        kept = [neighbour for weight, neighbour in zip(weights, neighbours, strict=True) if weight]
        for _ in range(min(self.most_liars, (len(kept) - 1) // 2)):
            differences = [0.0 for _ in kept]
            for (i, one), (j, other) in combinations(enumerate(kept), 2):
                difference = self._difference(one, other)
                differences[i] += difference
                differences[j] += difference
            del kept[differences.index(max(differences))]
        return kept

    def _difference(self, one: Neighbour, other: Neighbour) -> float:
        """Norm of what separates two states, m/s^2: of the accelerations that the law commands for each part of it."""
        (x, y, z), (ox, oy, oz) = one.position_enu_m, other.position_enu_m
        (vx, vy, vz), (ovx, ovy, ovz) = one.velocity_enu_m_s, other.velocity_enu_m_s
        (ax, ay, az), (oax, oay, oaz) = one.acceleration_enu_m_s2, other.acceleration_enu_m_s2
        k1, k2, g = self.position_gain_1_s2, self.velocity_gain_1_s, self.feedforward
        p, v, a = (
            hypot(x - ox, y - oy, z - oz),
            hypot(vx - ovx, vy - ovy, vz - ovz),
            hypot(ax - oax, ay - oay, az - oaz),
        )
        return hypot(k1 * p, k2 * v, g * a)
