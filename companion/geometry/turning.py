"""Rotation of a formation about the RFT: motion of its slots, limits of the rotation, swept area."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, cos, hypot, remainder, sin, sqrt, tau

from msgspec import Struct

from companion.types.formation import EAST, FlownSlot, Heading
from companion.types.values import Vector3

# Of a slot by each of: rotation, a formation change, joining, gap filling.
SLOT_ACCELERATION_M_S2 = 1.0
MAX_RATE_RAD_S = 1.0  # also if all slots are near the RFT
MAX_ACCELERATION_RAD_S2 = 1.0


class TurnLimits(Struct, frozen=True, gc=False):
    rate_rad_s: float
    acceleration_rad_s2: float


def turn_limits(reach_m: float, slot_speed_m_s: float) -> TurnLimits:
    """Limits of the rotation of a formation whose outermost slot is `reach_m` from the RFT.

    The tangential acceleration w' x d and the centripetal one -w^2 d of this slot get equal shares
    of `SLOT_ACCELERATION_M_S2`.
    """
    if reach_m <= 0.0:
        return TurnLimits(MAX_RATE_RAD_S, MAX_ACCELERATION_RAD_S2)
    share_m_s2 = SLOT_ACCELERATION_M_S2 / sqrt(2.0)
    rate_rad_s = min(slot_speed_m_s / reach_m, sqrt(share_m_s2 / reach_m), MAX_RATE_RAD_S)
    return TurnLimits(rate_rad_s, min(share_m_s2 / reach_m, MAX_ACCELERATION_RAD_S2))


def reach_m(slots_enu_m: Iterable[Vector3]) -> float:
    """Horizontal distance of the outermost slot from the RFT, m."""
    return max((hypot(x, y) for x, y, _ in slots_enu_m), default=0.0)


def swept(slots_enu_m: Iterable[Vector3]) -> list[Vector3]:
    """Corners of the bounding squares of the circles that the slots describe about the RFT."""
    circles = [(hypot(x, y), z) for x, y, z in slots_enu_m]
    return [corner for r, z in circles for corner in ((-r, -r, z), (r, r, z))]


def turned_slot(slot: FlownSlot, heading: Heading) -> FlownSlot:
    """A slot of the formation frame in ENU about the RFT; the frame's x axis has this heading.

    d = R s, d' = R s' + w x d, d'' = R s'' + 2 w x R s' + w' x d - w^2 d, with w about z.
    """
    if heading == EAST:
        return slot
    c, s, w, dw = cos(heading.angle_rad), sin(heading.angle_rad), heading.rate_rad_s, heading.acceleration_rad_s2
    (x, y, z), (vx, vy, vz), (ax, ay, az) = slot.position_enu_m, slot.velocity_enu_m_s, slot.acceleration_enu_m_s2
    x, y = c * x - s * y, s * x + c * y
    vx, vy = c * vx - s * vy, s * vx + c * vy
    ax, ay = c * ax - s * ay, s * ax + c * ay
    return FlownSlot(
        (x, y, z),
        (vx - w * y, vy + w * x, vz),
        (ax - 2.0 * w * vy - dw * y - w * w * x, ay + 2.0 * w * vx + dw * x - w * w * y, az),
        slot.formation,
        slot.waiting,
        slot.moves_for_s,
    )


def in_formation_frame(vector_enu: Vector3, heading: Heading) -> Vector3:
    """An ENU vector in the formation frame."""
    (x, y, z), c, s = vector_enu, cos(heading.angle_rad), sin(heading.angle_rad)
    return (c * x + s * y, c * y - s * x, z)


def heading_after(heading: Heading, seconds: float) -> Heading:
    """Heading after this time at constant angular acceleration."""
    rate_rad_s = heading.rate_rad_s + heading.acceleration_rad_s2 * seconds
    angle_rad = heading.angle_rad + (heading.rate_rad_s + rate_rad_s) / 2.0 * seconds
    return Heading(remainder(angle_rad, tau), rate_rad_s, heading.acceleration_rad_s2)


def course(velocity_enu_m_s: Vector3, acceleration_enu_m_s2: Vector3, slowest_m_s: float) -> Heading | None:
    """Heading of a horizontal motion and its rate; None up to `slowest_m_s`."""
    (vx, vy, _), (ax, ay, _) = velocity_enu_m_s, acceleration_enu_m_s2
    speed_m_s = hypot(vx, vy)
    if speed_m_s <= slowest_m_s:
        return None
    return Heading(atan2(vy, vx), (vx * ay - vy * ax) / speed_m_s**2)
