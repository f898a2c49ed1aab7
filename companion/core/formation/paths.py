"""Paths into a slot: delta(t), relative to the slot in the frame of the formation, decays to zero.

A vehicle on a path flies slot + delta. The law then finds it in its slot all along, and pulls neither it nor its neighbours.
Peers know such a path as well: the quintic that begins with the published motion of the slot and ends after `moves_for_s`.
"""

from __future__ import annotations

from math import acos, acosh, exp, hypot, sqrt

from msgspec import Struct

from companion.core.consensus.law import FormationState, Gains
from companion.core.reference.blend import LONGEST_S, SAMPLES, SHORTEST_S, within
from companion.geometry.curves import Curve, decay_to_rest, duration_s
from companion.geometry.turning import SLOT_ACCELERATION_M_S2, in_formation_frame
from companion.types.formation import Heading
from companion.types.notices import Code, Refused
from companion.types.values import ZERO3, Vector3

LONGER = 1.1  # factor of the duration from one attempt to the next

Path = tuple[Curve, float]
"""delta, and its duration in seconds."""


class Offset(Struct, frozen=True, gc=False):
    """A vehicle's motion relative to its slot, in the frame of the formation."""

    position_m: Vector3
    velocity_m_s: Vector3 = ZERO3

    @property
    def distance_m(self) -> float:
        return hypot(*self.position_m)

    @property
    def speed_m_s(self) -> float:
        return hypot(*self.velocity_m_s)


def offset_from(
    position_enu_m: Vector3, velocity_enu_m_s: Vector3, fleet: FormationState, slot_m: Vector3, heading: Heading
) -> Offset:
    """Offset from `slot_m`, which is in the formation's frame. `fleet` is the state of the RFT as the fleet flies it."""
    (x, y, z), (vx, vy, vz) = fleet.position_enu_m, fleet.velocity_enu_m_s
    relative = (position_enu_m[0] - x, position_enu_m[1] - y, position_enu_m[2] - z)
    here = in_formation_frame(relative, heading)
    rate = heading.rate_rad_s  # relative to a turning formation, a vehicle at rest circles the other way
    drift_enu = (
        velocity_enu_m_s[0] - vx + rate * relative[1],
        velocity_enu_m_s[1] - vy - rate * relative[0],
        velocity_enu_m_s[2] - vz,
    )
    error = (here[0] - slot_m[0], here[1] - slot_m[1], here[2] - slot_m[2])
    return Offset(error, in_formation_frame(drift_enu, heading))


def path_from(offset: Offset, lasts_s: float) -> Path:
    """The path that begins with this offset and ends after this time."""
    return decay_to_rest((offset.position_m, offset.velocity_m_s, ZERO3), lasts_s), lasts_s


def gentle_path(offset: Offset, speed_m_s: float, at_least_s: float = 0.0) -> Path:
    """The shortest path that adds no more than `speed_m_s` to the present speed, and SLOT_ACCELERATION_M_S2.

    Raises Refused where it would last longer than LONGEST_S.
    """
    most_m_s = speed_m_s + offset.speed_m_s
    lasts_s = max(SHORTEST_S, at_least_s, duration_s(offset.distance_m, most_m_s, SLOT_ACCELERATION_M_S2))
    while lasts_s <= LONGEST_S:
        delta, _ = path = path_from(offset, lasts_s)
        times_s = [lasts_s * k / SAMPLES for k in range(SAMPLES + 1)]
        if within(delta, times_s, most_m_s, SLOT_ACCELERATION_M_S2):
            return path
        lasts_s *= LONGER
    text = f"it is {offset.distance_m:.0f} m from its slot, too far to fly there within {LONGEST_S:g} s"
    raise Refused(Code.SLOT_TOO_FAR, text)


def law_within_m(gains: Gains, speed_m_s: float) -> float:
    """Distance from which the law alone brings a vehicle from rest into its slot below `speed_m_s`, m.

    The largest speed of x'' = -k1 x - k2 x' from rest at distance e is e w exp(-zeta/b acos zeta), with w^2 = k1,
    2 zeta w = k2 and b^2 = 1 - zeta^2; with acosh and b^2 = zeta^2 - 1 where it is overdamped.
    """
    frequency_1_s = sqrt(gains.position_1_s2)
    damping = gains.velocity_1_s / (2.0 * frequency_1_s)
    b = sqrt(abs(1.0 - damping * damping))
    angle = acos(damping) if damping < 1.0 else acosh(damping)
    share = damping * angle / b if b > 1e-6 else 1.0  # the limit of both
    return speed_m_s / (frequency_1_s * exp(-share))
