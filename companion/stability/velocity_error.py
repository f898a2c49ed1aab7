"""How far an error of the estimator's velocity moves a vehicle from its slot, with and without the velocity correction.

The law rests where k1 times the position error balances k2 times the velocity error e: k2/k1 of e away. The correction
(`core/estimation/velocity_correction.py`) leaves of e what its filter lets pass: s (s + 2 w) / (s + w)^2 e. It acts on the
difference of the autopilot's own position and velocity, and where both agree it is zero: in the linear model of law and
correction together the poles are those of the law and twice -w, so it makes no formation unstable.
"""

from __future__ import annotations

from companion.core.consensus.law import Gains


def shift_m(gains: Gains, velocity_error_m_s: float) -> float:
    """Distance from the slot with a constant velocity error, m."""
    return gains.velocity_1_s / gains.position_1_s2 * velocity_error_m_s


def share_left(rate_rad_s: float, bandwidth_1_s: float) -> float:
    """Share of a velocity error that turns at this rate which the correction leaves; 1 where it is off."""
    if bandwidth_1_s == 0.0:
        return 1.0
    s = 1j * rate_rad_s
    return abs(s * (s + 2.0 * bandwidth_1_s)) / abs(s + bandwidth_1_s) ** 2
