"""What remains of an excess of speed: the filter exceeds the limits of speed to keep off another vehicle, for a second at most.

A vehicle that lies about where it is could chase this one for longer.
"""

from __future__ import annotations

from math import hypot, inf

from companion.core.safety.limits import OutputLimits
from companion.types.values import Vector3

FASTER_MOST_S = 1.0  # above a limit of speed
FASTER_M_S = 0.2  # above it by less is noise of the estimators
SLOWS_1_S = 4.0  # an excess is braked away by this rate, as far as the envelope allows
RESPONDS_S = 0.3  # attitude lag, and a tick


class Overspeed:
    """Brakes a horizontal or vertical speed that was above its limit for as long as leaves time to brake."""

    def __init__(self, limits: OutputLimits, level_m_s2: float, up_m_s2: float, down_m_s2: float) -> None:
        """The last three are the largest accelerations for it."""
        self._limits = limits
        self._level_m_s2, self._up_m_s2, self._down_m_s2 = level_m_s2, up_m_s2, down_m_s2
        self._level_since_s, self._upright_since_s = inf, inf  # when it became faster than its limits
        self.lasts = False

    def slowed(self, now_s: float, velocity_enu_m_s: Vector3, wanted_enu_m_s2: Vector3) -> Vector3:
        """The acceleration, the same object, or one that brakes. Called while `lasts`, and where a limit may be exceeded."""
        (vx, vy, vz), limits = velocity_enu_m_s, self._limits
        level_m_s = hypot(vx, vy)
        is_fast = level_m_s > limits.max_speed_m_s + FASTER_M_S
        climbs, sinks = vz > limits.max_climb_m_s + FASTER_M_S, vz < -limits.max_descent_m_s - FASTER_M_S
        self._level_since_s = min(self._level_since_s, now_s) if is_fast else inf
        self._upright_since_s = min(self._upright_since_s, now_s) if climbs or sinks else inf
        self.lasts = is_fast or climbs or sinks
        x, y, z = wanted_enu_m_s2
        if is_fast:
            excess_m_s = level_m_s - limits.max_speed_m_s
            braking_m_s2 = _braking(now_s - self._level_since_s, excess_m_s, self._level_m_s2)
            nx, ny = vx / level_m_s, vy / level_m_s
            more_m_s2 = max(0.0, x * nx + y * ny + braking_m_s2)
            x, y = x - more_m_s2 * nx, y - more_m_s2 * ny
        if climbs:
            z = min(z, -_braking(now_s - self._upright_since_s, vz - limits.max_climb_m_s, self._down_m_s2))
        elif sinks:
            z = max(z, _braking(now_s - self._upright_since_s, -vz - limits.max_descent_m_s, self._up_m_s2))
        return wanted_enu_m_s2 if (x, y, z) == wanted_enu_m_s2 else (x, y, z)


def _braking(faster_s: float, excess_m_s: float, most_m_s2: float) -> float:
    """The deceleration of a speed that is above its limit by this, and has been for so long; -inf while there is time."""
    if faster_s + RESPONDS_S + excess_m_s / most_m_s2 < FASTER_MOST_S:
        return -inf
    return min(most_m_s2, SLOWS_1_S * excess_m_s)
