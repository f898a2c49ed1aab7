"""Where the formation points. Fixed, or the RFT's course: only leaders know it, so the others hear of it in the leader's word.

Every vehicle turns its own slot. It follows what it hears, or the course where it leads, by one smooth law, within limits of
rate and acceleration that keep the outermost slot within its own; so nothing steps when the lead changes or packets are late.
"""

from __future__ import annotations

from math import copysign, inf, pi, remainder, sqrt, tau
from typing import Protocol

from companion.core.cooperation import Neighbourhood
from companion.core.formation import Place
from companion.geometry.turning import TurnLimits, course, heading_after, turn_limits
from companion.types import EAST, Heading, HealthFlag

SETTLE_S = 0.4
PULL_1_S = 1.0 / (4.0 * SETTLE_S)  # critically damped
JERK_1_S = 4.0  # of the largest acceleration, a second
APPROACH = 0.5  # of the largest acceleration: what it means to brake with near its goal
SLOWEST_M_S = 0.1  # slower, r' has no direction worth turning for, and the last one is kept
ROUND = pi - 0.3  # a goal so far behind is turned to the way it turns already
LONGEST_S = 0.5  # of a pause; after a longer one it goes on from where it was


class FormationHeading(Protocol):
    """One vehicle's. `flown` is what its slot is turned by, `told` what it passes on in the leader's word."""

    flown: Heading
    told: Heading

    def begin_anew(self) -> None:
        """At once where others have it, or to the east, as after a landing."""

    def update(self, now_s: float, around: Neighbourhood, led_by: Place | None, reach_m: float) -> None:
        """Once a tick. `led_by` is R where this vehicle leads in formation; `reach_m` is the outermost slot's."""


class FixedHeading:
    """The formation keeps its slots as they are given, in ENU."""

    flown = told = EAST

    def begin_anew(self) -> None:
        pass

    def update(self, now_s: float, around: Neighbourhood, led_by: Place | None, reach_m: float) -> None:
        pass


class CourseHeading:
    """Its x axis turns to where the RFT goes."""

    def __init__(self, slot_speed_m_s: float) -> None:
        self._slot_speed_m_s = slot_speed_m_s
        self.flown = self.told = EAST
        self._begins = True
        self._last_s = inf

    def begin_anew(self) -> None:
        self._begins = True

    def update(self, now_s: float, around: Neighbourhood, led_by: Place | None, reach_m: float) -> None:
        seconds = min(max(now_s - self._last_s, 0.0), LONGEST_S)
        self._last_s = now_s
        heard = around.heading
        if self._begins:
            self.flown, self._begins = heard or EAST, False
        elif around.leaderless is HealthFlag.LEADER_AWAITED:
            self.flown = heading_after(Heading(self.flown.angle_rad, self.flown.rate_rad_s), seconds)
        else:
            goal = heard or self._goal(led_by)
            self.flown = turned_towards(self.flown, goal, turn_limits(reach_m, self._slot_speed_m_s), seconds)
        self.told = heard or self.flown

    def _goal(self, led_by: Place | None) -> Heading:
        """The course; where there is none, to come to rest."""
        found = course(led_by.velocity_enu_m_s, led_by.acceleration_enu_m_s2, SLOWEST_M_S) if led_by else None
        return found or Heading(self.flown.angle_rad)


def turned_towards(now: Heading, goal: Heading, limits: TurnLimits, seconds: float) -> Heading:
    """`now` after this time, on its way to a goal that turns itself and is as given then."""
    if seconds <= 0.0:
        return now
    ahead_rad = remainder(goal.angle_rad - heading_after(now, seconds).angle_rad, tau)
    if abs(ahead_rad) > ROUND and ahead_rad * now.rate_rad_s < 0.0:
        ahead_rad += copysign(tau, now.rate_rad_s)
    wanted_rad_s = _within(
        goal.rate_rad_s + _approach_rad_s(ahead_rad, APPROACH * limits.acceleration_rad_s2), limits.rate_rad_s
    )
    most_rad_s2 = limits.acceleration_rad_s2
    wanted_rad_s2 = _within((wanted_rad_s - now.rate_rad_s) / SETTLE_S + goal.acceleration_rad_s2, most_rad_s2)
    change_rad_s2 = _within(wanted_rad_s2 - now.acceleration_rad_s2, JERK_1_S * most_rad_s2 * seconds)
    begun = Heading(now.angle_rad, now.rate_rad_s, now.acceleration_rad_s2 + change_rad_s2)
    return heading_after(begun, seconds)


def _approach_rad_s(ahead_rad: float, braking_rad_s2: float) -> float:
    """How fast it may come nearer, so far from where it is to stop."""
    straight_rad = braking_rad_s2 / PULL_1_S**2  # nearer, the pull alone asks for less than that braking
    if abs(ahead_rad) < straight_rad:
        return PULL_1_S * ahead_rad
    return copysign(sqrt(braking_rad_s2 * (2.0 * abs(ahead_rad) - straight_rad)), ahead_rad)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
