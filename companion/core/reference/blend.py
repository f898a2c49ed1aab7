"""Reference trajectories, and the change of the RFT in flight.

r(t) = new(t) + delta(t), where delta begins at old - new and decays to zero. delta is a quintic. It begins with the difference
of the two RFTs in position, velocity and acceleration and ends at zero in all three. It depends on the two RFTs alone. So every
possible leader computes the same, and the leader may change meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from math import ceil, hypot

from companion.core.reference.target import Box, Room
from companion.geometry.airspace import Airspace, room_for
from companion.geometry.curves import Curve, decay_to_rest, duration_s
from companion.geometry.formations import swept
from companion.geometry.vectors import minus, plus
from companion.types.formation import FormationState
from companion.types.steps import Steps, coarser
from companion.types.values import ZERO3, Vector3

SHORTEST_S = 1.0
LONGEST_S = 600.0
LONGER = 1.1  # ratio of one tried duration to the one before
SAMPLES_PER_STEP = 100
SAMPLES = 60  # a blend is checked at this many points or more, at least one per second


@dataclass(frozen=True, slots=True)
class BlendLimits:
    """Limits of a blend.

    `added_*` limit delta beyond the difference of the two RFTs at its beginning. The others limit the whole RFT.
    `slots_turn`: the slots turn about the RFT and need the fence on all sides of it.
    """

    added_speed_m_s: float
    added_acceleration_m_s2: float
    speed_m_s: float
    acceleration_m_s2: float
    fence: Box
    slots_turn: bool = False
    airspace: Airspace | None = None  # where it is more than the box of the fence

    def is_clear(self, rft_enu_m: Vector3, slots_enu_m: Sequence[Vector3]) -> bool:
        """Whether all slots about this position of the RFT are clear of the polygon's outside and of obstacles."""
        if self.airspace is None:
            return True
        around_m = max(hypot(*slot) for slot in slots_enu_m)
        if self.slots_turn:
            return self.airspace.room_m(rft_enu_m) >= around_m
        return room_for(self.airspace, rft_enu_m, slots_enu_m, around_m)

    def box(self, slots_enu_m: Iterable[Vector3]) -> Box:
        """The box that r may use, m."""
        return reference_box(self.fence, swept(slots_enu_m) if self.slots_turn else slots_enu_m)

    def room(self, slots_enu_m: Collection[Vector3]) -> Room:
        """The room for an r whose way is not known in advance."""
        box = self.box(slots_enu_m)
        if self.slots_turn:
            return Room(box, self.airspace, (ZERO3,), max(hypot(*slot) for slot in slots_enu_m))
        return Room(box, self.airspace, tuple(slots_enu_m))


def reference_box(fence: Box, slots_enu_m: Iterable[Vector3]) -> Box:
    """The box for r in which every slot about r lies inside the fence, m."""
    xs, ys, zs = zip(*slots_enu_m, strict=True)
    (x, y, z), (far_x, far_y, far_z) = fence
    return (x - min(xs), y - min(ys), z - min(zs)), (far_x - max(xs), far_y - max(ys), far_z - max(zs))


def blending(
    old: FormationState, new: ReferenceTrajectory, begins_s: float, limits: BlendLimits, slots_enu_m: Sequence[Vector3]
) -> Steps[tuple[ReferenceTrajectory, float] | None]:
    """(RFT from `begins_s` on, duration of the blend): the shortest blend within all limits, or None. In steps.

    `old` is R and r'' at `begins_s`; the time of `new` starts there.
    """
    samples = SAMPLES_PER_STEP
    if limits.airspace is not None:
        samples = min(samples, limits.airspace.positions_per_step(1 + len(slots_enu_m)))
    return (yield from coarser(_blending(old, new, begins_s, limits, slots_enu_m), samples))


def _blending(
    old: FormationState, new: ReferenceTrajectory, begins_s: float, limits: BlendLimits, slots_enu_m: Sequence[Vector3]
) -> Steps[tuple[ReferenceTrajectory, float] | None]:
    """A step for each sample."""
    first, box = new(0.0), limits.box(slots_enu_m)
    begin = (
        minus(old.position_enu_m, first.position_enu_m),
        minus(old.velocity_enu_m_s, first.velocity_enu_m_s),
        minus(old.acceleration_enu_m_s2, first.acceleration_enu_m_s2),
    )
    speed_m_s = limits.added_speed_m_s + hypot(*begin[1])
    acceleration_m_s2 = limits.added_acceleration_m_s2 + hypot(*begin[2])
    lasts_s = max(SHORTEST_S, duration_s(hypot(*begin[0]), speed_m_s, acceleration_m_s2))
    while lasts_s <= LONGEST_S:
        delta = decay_to_rest(begin, lasts_s)
        samples = max(SAMPLES, ceil(lasts_s))
        times_s = [lasts_s * index / samples for index in range(samples + 1)]
        trajectory = _sum(new, delta, begins_s)
        for time_s in times_s:
            if not within(delta, [time_s], speed_m_s, acceleration_m_s2):
                break
            yield
        else:
            for time_s in times_s:
                if not _is_flyable(trajectory(begins_s + time_s), limits, box, slots_enu_m):
                    break
                yield
            else:
                return trajectory, lasts_s
        lasts_s *= LONGER
    return None


def within(delta: Curve, times_s: Iterable[float], speed_m_s: float, acceleration_m_s2: float) -> bool:
    """Whether speed and acceleration of a curve stay within these limits at all these times."""
    motions = [delta(time_s) for time_s in times_s]
    return all(hypot(*v) <= speed_m_s * 1.001 and hypot(*a) <= acceleration_m_s2 * 1.001 for _, v, a in motions)


def _is_flyable(state: FormationState, limits: BlendLimits, box: Box, slots_enu_m: Sequence[Vector3]) -> bool:
    inside = all(low <= p <= high for p, low, high in zip(state.position_enu_m, *box, strict=True))
    slow = hypot(*state.velocity_enu_m_s) <= limits.speed_m_s
    gentle = hypot(*state.acceleration_enu_m_s2) <= limits.acceleration_m_s2
    return inside and slow and gentle and limits.is_clear(state.position_enu_m, slots_enu_m)


def _sum(new: ReferenceTrajectory, delta: Curve, begins_s: float) -> ReferenceTrajectory:
    def trajectory(reference_s: float) -> FormationState:
        own_s = max(0.0, reference_s - begins_s)
        state, (position, velocity, acceleration) = new(own_s), delta(own_s)
        return FormationState(
            plus(state.position_enu_m, position),
            plus(state.velocity_enu_m_s, velocity),
            plus(state.acceleration_enu_m_s2, acceleration),
        )

    return trajectory


ReferenceTrajectory = Callable[[float], FormationState]
"""Seconds since the start of the RFT -> R and r''. The RFT starts when the leader enters formation."""


def point(position_enu_m: Vector3) -> ReferenceTrajectory:
    """RFT at a fixed point: r' = r'' = 0."""
    at_rest = FormationState(position_enu_m, ZERO3)
    return lambda _reference_s: at_rest


def along(curve: Curve) -> ReferenceTrajectory:
    """RFT along a curve."""
    return lambda reference_s: FormationState(*curve(reference_s))
