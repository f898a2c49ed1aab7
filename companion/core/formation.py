"""The formation law: eq. 14 with the weights of Algorithm 2, and the two average laws it is compared with.

All three are one formula; a law is data: the exponent of its weights, and whether a leader heeds its neighbours.
d_ij = d_i0 - d_j0 turns every relative error of the paper into a difference of places:
x_i - x_j - d_ij = (x_i - d_i0) - (x_j - d_j0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from companion.core.weights import neighbour_weights
from companion.types import Vector3


@dataclass(frozen=True, slots=True)
class Gains:
    """K = [k1, k2]: k1 on position [1/s^2], k2 on velocity [1/s]."""

    position_1_s2: float
    velocity_1_s: float


@dataclass(frozen=True, slots=True)
class FormationLaw:
    """`exponent` is alpha of the weights 1/p^alpha. Where `leader_heeds_neighbours` is False a leader tracks the RFT alone."""

    gains: Gains
    exponent: float
    leader_heeds_neighbours: bool


def weighted(gains: Gains, exponent: float) -> FormationLaw:
    """Eq. 14 with Algorithms 1 and 2: the paper's law at exponent 1."""
    return FormationLaw(gains, exponent, leader_heeds_neighbours=True)


def average_22(gains: Gains) -> FormationLaw:
    """Equal weights for all neighbours and the leader coupled, the interaction matrix of eq. 22."""
    return FormationLaw(gains, 0.0, leader_heeds_neighbours=True)


def average_26(gains: Gains) -> FormationLaw:
    """Eq. 26: followers average their neighbours, leaders track the reference alone."""
    return FormationLaw(gains, 0.0, leader_heeds_neighbours=False)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a vehicle is, seen from its slot: x - d_i0 and its velocity. In perfect formation all places equal the RFT."""

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3


def place(position_enu_m: Vector3, velocity_enu_m_s: Vector3, slot_enu_m: Vector3) -> Place:
    x, y, z = position_enu_m
    dx, dy, dz = slot_enu_m
    return Place((x - dx, y - dy, z - dz), velocity_enu_m_s)


def formation_error(
    law: FormationLaw, own: Place, neighbours: Sequence[tuple[int, Place]], reference: Place | None
) -> tuple[Vector3, Vector3]:
    """z_i of eq. 11 less the offsets, as (position error m, velocity error m/s).

    `neighbours` are (PrC, place); `reference` is R = [r, r'] for a leader, None for a follower.
    """
    heeded = neighbours if reference is None or law.leader_heeds_neighbours else ()
    weights = neighbour_weights([prc for prc, _ in heeded], law.exponent)
    terms = [(weight, target) for weight, (_, target) in zip(weights, heeded, strict=True)]
    if reference is not None:
        terms.append((1.0, reference))
    (x, y, z), (vx, vy, vz) = own.position_enu_m, own.velocity_enu_m_s
    ex = ey = ez = evx = evy = evz = 0.0
    for weight, target in terms:
        (tx, ty, tz), (tvx, tvy, tvz) = target.position_enu_m, target.velocity_enu_m_s
        ex, ey, ez = ex + weight * (x - tx), ey + weight * (y - ty), ez + weight * (z - tz)
        evx, evy, evz = evx + weight * (vx - tvx), evy + weight * (vy - tvy), evz + weight * (vz - tvz)
    return (ex, ey, ez), (evx, evy, evz)


def formation_acceleration(
    law: FormationLaw, own: Place, neighbours: Sequence[tuple[int, Place]], reference: Place | None
) -> Vector3:
    """u_i of eq. 14, m/s^2 in ENU on all three axes. Zero for a follower without neighbours."""
    position_error, velocity_error = formation_error(law, own, neighbours, reference)
    return feedback(law.gains, position_error, velocity_error)


def feedback(gains: Gains, position_error_m: Vector3, velocity_error_m_s: Vector3) -> Vector3:
    """-K [position error, velocity error]."""
    k1, k2 = gains.position_1_s2, gains.velocity_1_s
    px, py, pz = position_error_m
    vx, vy, vz = velocity_error_m_s
    return (-k1 * px - k2 * vx, -k1 * py - k2 * vy, -k1 * pz - k2 * vz)
