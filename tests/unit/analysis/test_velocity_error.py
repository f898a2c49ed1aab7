"""The shift by a velocity error, and law and velocity correction together."""

from math import cos, inf, sin

import numpy as np
import pytest

from companion.analysis.interaction import share_left, shift_m
from companion.core.estimation.corrections import VelocityCorrection
from tests.helpers.laws import cooperative

GAINS = cooperative().gains
W = 2.0


def test_law_and_correction_have_their_own_poles_and_no_others() -> None:
    """State [p, v, e, b] of a leader that rests: u = -k1 p - k2 (v + b); e' = -b - 2 w e, b' = w^2 e with a true velocity."""
    k1, k2 = GAINS.position_1_s2, GAINS.velocity_1_s
    together = np.array([[0, 1, 0, 0], [-k1, -k2, 0, -k2], [0, 0, -2 * W, -1], [0, 0, W**2, 0]])
    poles = np.sort_complex(np.linalg.eigvals(together))
    expected = np.sort_complex(np.concatenate([np.roots([1, k2, k1]), [-W, -W]]))
    assert poles == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("bandwidth_1_s", [W, 8.0])
@pytest.mark.parametrize("rate_rad_s", [0.1, 0.5, 2.0])
def test_the_filter_leaves_the_share_that_is_predicted(rate_rad_s: float, bandwidth_1_s: float) -> None:
    """A vehicle at rest whose reported velocity turns."""
    correction = VelocityCorrection(bandwidth_1_s)
    largest = -inf
    for tick in range(round(200.0 / 0.02)):
        time_s = 0.02 * tick
        error = (0.1 * cos(rate_rad_s * time_s), 0.1 * sin(rate_rad_s * time_s), 0.0)
        used = correction.follow(time_s, (0.0, 0.0, 0.0), error)
        if time_s > 150.0:
            largest = max(largest, float(np.hypot(*used[:2])))
    assert largest == pytest.approx(0.1 * share_left(rate_rad_s, bandwidth_1_s), rel=0.05)


def test_shift_without_and_with_correction() -> None:
    assert shift_m(GAINS, 0.1) == pytest.approx(0.12)
    assert share_left(0.2, 0.0) == 1.0
    assert share_left(0.0, W) == 0.0
