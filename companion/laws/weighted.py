"""Eq. 14 with the weights of Algorithm 2: the law of Hou and Zhang (Robotica 2021)."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from companion.laws._neighbour_feedback import NeighbourFeedback

Exponent = Annotated[float, Meta(ge=0, le=16)]
WeightRatio = Annotated[float, Meta(ge=0.001, le=1)]
Share = Annotated[float, Meta(ge=0, le=0.99)]


class Weighted(NeighbourFeedback, frozen=True):
    """Eq. 14, the paper's law: the mean of the neighbours, each weighted by 1/PrC: who is nearer to a leader counts more.

    position_gain_1_s2: k1 of K = [k1, k2], on the position error; the paper's of section 5.1.1
    velocity_gain_1_s: k2 of K = [k1, k2], on the velocity error; the paper's of section 5.1.1
    exponent: alpha of the weights rho^p / p^alpha; 1 in the paper's Algorithm 2
    weight_ratio: rho of the weights rho^p / p^alpha; 1 in the paper
    feedforward: share of the neighbours' acceleration that is fed forward
    leader_uses_neighbours: `false`: a leader tracks its reference without its neighbours
    """

    exponent: Exponent = 1.0
    weight_ratio: WeightRatio = 1.0
    feedforward: Share = 0.0
    leader_uses_neighbours: bool = True
