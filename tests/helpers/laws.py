"""Laws with gains given as one value, as the theory has them."""

from __future__ import annotations

from companion.laws import FormationState, Law, Neighbour, Own
from companion.laws.average_22 import Average22
from companion.laws.average_26 import Average26
from companion.laws.cooperative import Cooperative
from companion.laws.weighted import Weighted
from companion.types.formation import PAPER_GAINS, Gains
from companion.types.values import Vector3


def weighted(gains: Gains = PAPER_GAINS, exponent: float = 1.0) -> Weighted:
    return Weighted(gains.position_1_s2, gains.velocity_1_s, exponent)


def average_22(gains: Gains = PAPER_GAINS) -> Average22:
    return Average22(gains.position_1_s2, gains.velocity_1_s)


def average_26(gains: Gains = PAPER_GAINS) -> Average26:
    return Average26(gains.position_1_s2, gains.velocity_1_s)


def cooperative() -> Cooperative:
    return Cooperative()


def law_of(gains: Gains, exponent: float, leader_uses_neighbours: bool, feedforward: float = 0.0) -> Weighted:
    return Weighted(
        gains.position_1_s2,
        gains.velocity_1_s,
        exponent,
        feedforward=feedforward,
        leader_uses_neighbours=leader_uses_neighbours,
    )


def acceleration(
    law: Law,
    own: FormationState,
    neighbours: list[tuple[int, FormationState]],
    reference: FormationState | None,
    drag_1_s: float = 0.0,
) -> Vector3:
    """What a law gives for these formation states and PrCs."""
    states = [Neighbour(s.position_enu_m, s.velocity_enu_m_s, s.acceleration_enu_m_s2, prc) for prc, s in neighbours]
    return law.acceleration(Own(own.position_enu_m, own.velocity_enu_m_s, drag_1_s=drag_1_s), states, reference)
