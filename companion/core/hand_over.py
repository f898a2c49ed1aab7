"""From one RFT to another in flight: r(t) = new(t) + delta(t), where delta takes over all of the old one and dies out.

delta is the quintic that begins with what the old RFT has of position, velocity and acceleration more than the new one, and
ends with nothing. It comes out of both RFTs alone: every vehicle that may lead has the same, and the lead can change meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, hypot

from companion.core.formation import Place
from companion.core.pursuit import Box
from companion.core.reference import ReferenceTrajectory
from companion.geometry.curves import Curve, duration_s, dying_out
from companion.geometry.turning import swept
from companion.types import Vector3

SHORTEST_S = 1.0
LONGEST_S = 600.0
LONGER = 1.1  # from one duration that is tried to the next
SAMPLES = 60  # at least, and one a second


@dataclass(frozen=True, slots=True)
class HandOverLimits:
    """What delta may have of speed and acceleration, beyond what the old RFT has; and what the whole may have.

    `slots_turn`: about the RFT, so that they need room all round it.
    """

    added_speed_m_s: float
    added_acceleration_m_s2: float
    speed_m_s: float
    acceleration_m_s2: float
    fence: Box
    slots_turn: bool = False

    def room(self, slots_enu_m: Iterable[Vector3]) -> Box:
        """Where r may be."""
        return box_of(self.fence, swept(slots_enu_m) if self.slots_turn else slots_enu_m)


def box_of(fence: Box, slots_enu_m: Iterable[Vector3]) -> Box:
    """Where r may be, so that every slot about it lies inside the fence."""
    xs, ys, zs = zip(*slots_enu_m, strict=True)
    (x, y, z), (far_x, far_y, far_z) = fence
    return (x - min(xs), y - min(ys), z - min(zs)), (far_x - max(xs), far_y - max(ys), far_z - max(zs))


def handed_over(
    old: Place, new: ReferenceTrajectory, begins_s: float, limits: HandOverLimits, box: Box
) -> tuple[ReferenceTrajectory, float] | None:
    """(the RFT from `begins_s` on, how long the hand-over lasts): the shortest within all limits, None where there is none.

    `old` is R and r'' at `begins_s`; the own time of `new` begins then.
    """
    first = new(0.0)
    begin = (
        _minus(old.position_enu_m, first.position_enu_m),
        _minus(old.velocity_enu_m_s, first.velocity_enu_m_s),
        _minus(old.acceleration_enu_m_s2, first.acceleration_enu_m_s2),
    )
    speed_m_s = limits.added_speed_m_s + hypot(*begin[1])
    acceleration_m_s2 = limits.added_acceleration_m_s2 + hypot(*begin[2])
    lasts_s = max(SHORTEST_S, duration_s(hypot(*begin[0]), speed_m_s, acceleration_m_s2))
    while lasts_s <= LONGEST_S:
        delta = dying_out(begin, lasts_s)
        samples = max(SAMPLES, ceil(lasts_s))
        times_s = [lasts_s * index / samples for index in range(samples + 1)]
        if within(delta, times_s, speed_m_s, acceleration_m_s2):
            whole = _sum(new, delta, begins_s)
            if all(_is_flyable(whole(begins_s + time_s), limits, box) for time_s in times_s):
                return whole, lasts_s
        lasts_s *= LONGER
    return None


def within(delta: Curve, times_s: Iterable[float], speed_m_s: float, acceleration_m_s2: float) -> bool:
    """Is it so slow and so gentle at all these times?"""
    motions = [delta(time_s) for time_s in times_s]
    return all(hypot(*v) <= speed_m_s * 1.001 and hypot(*a) <= acceleration_m_s2 * 1.001 for _, v, a in motions)


def _is_flyable(place: Place, limits: HandOverLimits, box: Box) -> bool:
    inside = all(low <= p <= high for p, low, high in zip(place.position_enu_m, *box, strict=True))
    slow = hypot(*place.velocity_enu_m_s) <= limits.speed_m_s
    return inside and slow and hypot(*place.acceleration_enu_m_s2) <= limits.acceleration_m_s2


def _sum(new: ReferenceTrajectory, delta: Curve, begins_s: float) -> ReferenceTrajectory:
    def trajectory(reference_s: float) -> Place:
        own_s = max(0.0, reference_s - begins_s)
        place, (position, velocity, acceleration) = new(own_s), delta(own_s)
        return Place(
            _plus(place.position_enu_m, position),
            _plus(place.velocity_enu_m_s, velocity),
            _plus(place.acceleration_enu_m_s2, acceleration),
        )

    return trajectory


def _plus(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])
