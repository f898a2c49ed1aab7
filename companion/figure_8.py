"""The figure 8 as numbers: a Lissajous curve, run through at a pace that begins at nothing. Pure geometry."""

from __future__ import annotations

from math import cos, pi, sin

from companion.types import Vector3


def figure_8(
    time_s: float, width_m: float, height_m: float, period_s: float, ramp_s: float
) -> tuple[Vector3, Vector3, Vector3]:
    """Position, velocity and acceleration about the figure's centre: x = w/2 sin p, y = h/2 sin 2p.

    The rate p' rises from 0 to 2 pi / period over `ramp_s` as 3 u^2 - 2 u^3, so that the acceleration, too, begins at zero and
    has no step. The centre is left with zero speed at time 0; a steady lap takes `period_s`.
    """
    p, rate, rate_change = _phase(time_s, 2.0 * pi / period_s, ramp_s)
    a, b = width_m / 2.0, height_m / 2.0
    x, y = a * sin(p), b * sin(2.0 * p)
    dx, dy = a * cos(p), 2.0 * b * cos(2.0 * p)  # along p
    return (
        (x, y, 0.0),
        (dx * rate, dy * rate, 0.0),
        (dx * rate_change - x * rate**2, dy * rate_change - 4.0 * y * rate**2, 0.0),
    )


def _phase(time_s: float, full_rate_rad_s: float, ramp_s: float) -> tuple[float, float, float]:
    """p, p' and p''."""
    u = time_s / ramp_s
    if u <= 0.0:
        return 0.0, 0.0, 0.0
    if u >= 1.0:
        return full_rate_rad_s * (time_s - ramp_s / 2.0), full_rate_rad_s, 0.0
    return (
        full_rate_rad_s * ramp_s * (u**3 - u**4 / 2.0),
        full_rate_rad_s * (3.0 * u**2 - 2.0 * u**3),
        full_rate_rad_s * 6.0 * (u - u**2) / ramp_s,
    )
