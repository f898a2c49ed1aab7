"""An extension of the paper's law that settles long chains fast, with attitude lag, noise, delay and packet loss."""

from __future__ import annotations

from companion.laws import Gain
from companion.laws.weighted import Exponent, Share, Weighted, WeightRatio


class Cooperative(Weighted, frozen=True):
    """The law to fly: follows the neighbours nearest to a leader, with their accelerations, so that deep chains settle fast.

    Weights fall to a thirtieth with every hop: no vehicle follows its own followers, however deep it is. Gains with 0.85
    of critical damping at lambda = 1, where the paper's have 0.51. And nearly all of the neighbours' acceleration fed forward;
    a larger k2 for the same k1 costs twice: a velocity error e shifts a vehicle by k2/k1 e, and with slow attitude loops and
    late packets the leader and its followers begin to oscillate.
    """

    position_gain_1_s2: Gain = 2.0
    velocity_gain_1_s: Gain = 2.4
    exponent: Exponent = 0.0
    weight_ratio: WeightRatio = 0.03
    feedforward: Share = 0.98
