"""Formation heading: fixed, or along the course of the RFT. Leaders publish the course in the leader beacon.

Every vehicle turns its own slot. It follows the received heading, or the course while it is leader, by one smooth law. The
limits of rate and acceleration keep the outermost slot within its own limits. So nothing steps when the leader changes or
packets are late.
"""

from __future__ import annotations

from math import copysign, inf, pi, remainder, tau

from companion.core.consensus.stage import Consensus
from companion.core.reference.target import APPROACH, JERK_1_S, LONGEST_S, SETTLE_S, approach_speed
from companion.geometry.formations import TurnLimits, course, heading_after, turn_limits
from companion.geometry.vectors import clamped
from companion.types.flight import HealthFlag
from companion.types.formation import EAST, FormationState, Heading

SLOWEST_M_S = 0.1  # below this speed r' has no usable direction, and the last heading is kept
ROUND_RAD = pi - 0.3  # a goal further behind than this is approached in the present direction of turn


class CourseHeading:
    """The x axis of the formation turns to the course of the RFT.

    `flown` turns the vehicle's own slot; `published` goes into its leader beacon.
    """

    def __init__(self, slot_speed_m_s: float) -> None:
        self._slot_speed_m_s = slot_speed_m_s
        self.flown = self.published = EAST
        self._begins = True
        self._last_s = inf

    def restart(self) -> None:
        """Take the received heading at the next update without a turn, or east where there is none. After a landing."""
        self._begins = True

    def update(self, now_s: float, around: Consensus, reference: FormationState | None, reach_m: float) -> None:
        """Advance by one tick. `reference` is R while this vehicle is leader in formation, else None.

        `reach_m` is the distance of the outermost slot from the RFT.
        """
        seconds = min(max(now_s - self._last_s, 0.0), LONGEST_S)
        self._last_s = now_s
        received = around.lead.heading
        if self._begins:
            self.flown, self._begins = received or EAST, False
        elif around.lead.leaderless is HealthFlag.LEADER_AWAITED:
            self.flown = heading_after(Heading(self.flown.angle_rad, self.flown.rate_rad_s), seconds)
        else:
            goal = received or self._goal(reference)
            self.flown = turned_towards(self.flown, goal, turn_limits(reach_m, self._slot_speed_m_s), seconds)
        self.published = received or self.flown

    def _goal(self, reference: FormationState | None) -> Heading:
        """The course of the RFT; without one, the present heading at rest."""
        found = course(reference.velocity_enu_m_s, reference.acceleration_enu_m_s2, SLOWEST_M_S) if reference else None
        return found or Heading(self.flown.angle_rad)


def turned_towards(now: Heading, goal: Heading, limits: TurnLimits, seconds: float) -> Heading:
    """`now` after this time, turned towards `goal` within the limits. The goal is given for the end of the time.

    The law turns the shorter way. A goal that turns away at nearly the largest rate is therefore reached late: after at most
    pi / (largest rate - goal rate) and the time of the accelerations.
    """
    if seconds <= 0.0:
        return now
    ahead_rad = remainder(goal.angle_rad - heading_after(now, seconds).angle_rad, tau)
    if abs(ahead_rad) > ROUND_RAD and ahead_rad * now.rate_rad_s < 0.0:
        ahead_rad += copysign(tau, now.rate_rad_s)
    most_rad_s2 = limits.acceleration_rad_s2
    approach_rad_s = copysign(approach_speed(abs(ahead_rad), APPROACH * most_rad_s2), ahead_rad)
    wanted_rad_s = clamped(goal.rate_rad_s + approach_rad_s, limits.rate_rad_s)
    wanted_rad_s2 = clamped((wanted_rad_s - now.rate_rad_s) / SETTLE_S + goal.acceleration_rad_s2, most_rad_s2)
    change_rad_s2 = clamped(wanted_rad_s2 - now.acceleration_rad_s2, JERK_1_S * most_rad_s2 * seconds)
    begun = Heading(now.angle_rad, now.rate_rad_s, now.acceleration_rad_s2 + change_rad_s2)
    return heading_after(begun, seconds)
