"""The descent by thrust of a vehicle whose autopilot neither holds nor lands: level, at the speed of a landing."""

from __future__ import annotations

from companion.types.autopilot import VehicleState
from companion.types.values import Vector3

SINKS_M_S = 0.7  # LAND_SPEED and MPC_LAND_SPEED by default: 0.5 and 0.7
ON_SPEED_1_S = 2.0
STANDS_M_S = 0.2  # a vehicle that sinks no faster than this, for STANDS_S, stands on the ground
STANDS_S = 1.0
LOW_THRUST_M_S2 = -6.0  # 0.4 of the weight: PX4 takes less than about 0.5 for landed, ArduCopter its lowest throttle


class Descent:
    """One descent at a time; after `restart` another one may begin."""

    def __init__(self) -> None:
        self._sank_s: float | None = None  # when it last sank, or the descent began

    def restart(self) -> None:
        """No descent is under way."""
        self._sank_s = None

    def acceleration_enu_m_s2(self, now_s: float, vehicle: VehicleState) -> Vector3:
        """Level, towards SINKS_M_S downwards; on the ground with a thrust so low that the autopilot takes it for landed.

        The horizontal velocity is not used: it is that of the position which the autopilot has lost.
        """
        climb_m_s = vehicle.velocity_enu_m_s[2]
        if self._sank_s is None or climb_m_s < -STANDS_M_S:
            self._sank_s = now_s
        if now_s - self._sank_s > STANDS_S:
            return (0.0, 0.0, LOW_THRUST_M_S2)
        return (0.0, 0.0, ON_SPEED_1_S * (-SINKS_M_S - climb_m_s))
