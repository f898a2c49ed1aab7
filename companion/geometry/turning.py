"""A formation that turns about the RFT: its slots with what that adds to their motion, and the room and the pace it takes."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, cos, hypot, remainder, sin, sqrt, tau

from msgspec import Struct

from companion.types import EAST, FlownSlot, Heading, Vector3

SLOT_ACCELERATION_M_S2 = 1.0  # that turning alone asks of the outermost slot
FASTEST_RAD_S = 1.0  # also where all slots are near the RFT
QUICKEST_RAD_S2 = 1.0


class TurnLimits(Struct, frozen=True, gc=False):
    rate_rad_s: float
    acceleration_rad_s2: float


def turn_limits(reach_m: float, slot_speed_m_s: float) -> TurnLimits:
    """How a formation may turn whose outermost slot is so far from the RFT, `reach_m`.

    Its acceleration w' x d along its circle and -w^2 d towards the middle have the same share of what it may be.
    """
    if reach_m <= 0.0:
        return TurnLimits(FASTEST_RAD_S, QUICKEST_RAD_S2)
    share_m_s2 = SLOT_ACCELERATION_M_S2 / sqrt(2.0)
    rate_rad_s = min(slot_speed_m_s / reach_m, sqrt(share_m_s2 / reach_m), FASTEST_RAD_S)
    return TurnLimits(rate_rad_s, min(share_m_s2 / reach_m, QUICKEST_RAD_S2))


def reach_m(slots_enu_m: Iterable[Vector3]) -> float:
    """Of the slot that is farthest from the RFT in the plane."""
    return max((hypot(x, y) for x, y, _ in slots_enu_m), default=0.0)


def swept(slots_enu_m: Iterable[Vector3]) -> list[Vector3]:
    """Corners of the squares about the circles on which slots go round the RFT."""
    circles = [(hypot(x, y), z) for x, y, z in slots_enu_m]
    return [corner for r, z in circles for corner in ((-r, -r, z), (r, r, z))]


def turned_slot(slot: FlownSlot, heading: Heading) -> FlownSlot:
    """A slot of the formation's own frame, whose x axis has this heading, in ENU about the RFT.

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
        slot.moves,
    )


def unturned(vector_enu: Vector3, heading: Heading) -> Vector3:
    """A vector in the formation's own frame."""
    (x, y, z), c, s = vector_enu, cos(heading.angle_rad), sin(heading.angle_rad)
    return (c * x + s * y, c * y - s * x, z)


def heading_after(heading: Heading, seconds: float) -> Heading:
    """It goes on with its acceleration."""
    rate_rad_s = heading.rate_rad_s + heading.acceleration_rad_s2 * seconds
    angle_rad = heading.angle_rad + (heading.rate_rad_s + rate_rad_s) / 2.0 * seconds
    return Heading(remainder(angle_rad, tau), rate_rad_s, heading.acceleration_rad_s2)


def course(velocity_enu_m_s: Vector3, acceleration_enu_m_s2: Vector3, slowest_m_s: float) -> Heading | None:
    """The direction of a motion in the plane and how it turns; None where it is too slow to have one."""
    (vx, vy, _), (ax, ay, _) = velocity_enu_m_s, acceleration_enu_m_s2
    speed_m_s = hypot(vx, vy)
    if speed_m_s <= slowest_m_s:
        return None
    return Heading(atan2(vy, vx), (vx * ay - vy * ax) / speed_m_s**2)
