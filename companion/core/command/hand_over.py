"""The hand-over from formation to a mode of the autopilot: the vehicle brakes, then levels, then the autopilot is asked.

An autopilot brakes for its hold harder than the vehicles behind can, and does not avoid them. So the agent brakes first, with
the separation filter, and hands over once the vehicle is slow and the filter changes nothing. Autopilots begin their own modes
level, from any attitude: so level attitude is streamed before the request and until the mode has changed. If an autopilot does
not begin a landing, the setpoints lower the vehicle.
"""

from __future__ import annotations

from math import hypot, inf

from msgspec import Struct
from msgspec.structs import replace

from companion.types.autopilot import AutopilotMode, VehicleState

LEVEL_BEFORE_HAND_OVER_S = 0.25
BRAKED_M_S = 0.5  # at this speed it hands over, unless the separation filter changes the acceleration
BRAKES_WITHIN_S = 4.0  # then it hands over in any case
EVADES_M_S2 = 0.3  # a change by the filter of at least this much is an evasion
TAKES_OVER_WITHIN_S = 0.25  # both autopilots take over within 50 ms of the request
LANDS_WITHIN_S = 1.5  # after three requests to land the agent lowers the vehicle itself


class HandOver(Struct, frozen=True, gc=False):
    """Where a hand-over is. While it is under way setpoints go on, as long as the autopilot follows them."""

    under_way: bool = False
    brakes_until_s: float | None = None  # None: it has braked
    level_until_s: float = -inf
    descends_from_s: float = inf  # from then on, unless the autopilot has begun to land

    @property
    def has_to_brake(self) -> bool:
        """It has not levelled yet."""
        return self.brakes_until_s is not None

    def levels(self, now_s: float) -> bool:
        """After it has braked, until the autopilot should have taken over."""
        return self.under_way and self.brakes_until_s is None and now_s < self.level_until_s

    def descends(self, now_s: float) -> bool:
        """The autopilot does not take over to land: the stream goes on, and lowers the vehicle."""
        return self.under_way and self.brakes_until_s is None and now_s > self.descends_from_s

    def brakes(self, now_s: float, vehicle: VehicleState, filtered_m_s2: float) -> bool:
        """Whether the vehicle goes on braking, or evading another one."""
        until_s = self.brakes_until_s
        if until_s is None or not self.under_way or vehicle.mode is not AutopilotMode.OFFBOARD:
            return False
        return now_s < until_s and _is_moving(vehicle, filtered_m_s2)

    def begun(self, now_s: float, lands: bool) -> HandOver:
        """The stream goes on for another mode. A landing asked for again does not put the descent off."""
        descends_from_s = min(self.descends_from_s, now_s + LANDS_WITHIN_S) if lands else inf
        return HandOver(under_way=True, level_until_s=self.level_until_s, descends_from_s=descends_from_s)

    def braking(self, now_s: float, vehicle: VehicleState, filtered_m_s2: float, within_s: float) -> HandOver:
        """It brakes first, for at most `within_s`, where it moves."""
        if within_s <= 0.0 or not _is_moving(vehicle, filtered_m_s2):
            return self
        return replace(self, brakes_until_s=now_s + within_s)

    def without_braking(self, now_s: float) -> HandOver:
        """It has braked for long enough."""
        return self if self.brakes_until_s is None else replace(self, brakes_until_s=now_s)

    def level_from(self, now_s: float, delay_s: float) -> HandOver:
        """It levels now; the autopilot is asked after `delay_s`."""
        descends_from_s = inf if self.descends_from_s == inf else now_s + LANDS_WITHIN_S
        level_until_s = now_s + delay_s + TAKES_OVER_WITHIN_S
        return HandOver(self.under_way, None, level_until_s, descends_from_s)

    def ended(self) -> HandOver:
        """No more setpoints."""
        return HandOver(level_until_s=self.level_until_s)


NO_HAND_OVER = HandOver()


def _is_moving(vehicle: VehicleState, filtered_m_s2: float) -> bool:
    return hypot(*vehicle.velocity_enu_m_s) > BRAKED_M_S or filtered_m_s2 >= EVADES_M_S2
