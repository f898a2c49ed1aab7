"""Formations as sets of slots: the metric of `separation_m`, named shapes, transitions between two of them, and turning.

Every check against `separation_m` uses this metric: fleet files, formation changes, paths and the separation filter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from math import atan2, ceil, cos, dist, hypot, inf, pi, remainder, sin, sqrt, tau

from msgspec import Struct

from companion.geometry.curves import PEAK_SPEED
from companion.types.formation import EAST, FlownSlot, Heading
from companion.types.values import Vector3

HEIGHT_WEIGHT = 0.5
"""What a metre of height counts for, compared with a horizontal metre: two vehicles above each other need twice the distance.

The downwash of a quadrotor reaches far below it and hardly to the side. Preiss, Hoenig, Ayanian and Sukhatme ("Downwash-aware
trajectory planning for large quadrotor teams", IROS 2017) measured ellipsoids that are 2.5 times as tall as wide.
"""


def separation_distance_m(a_enu_m: Vector3, b_enu_m: Vector3) -> float:
    """Distance of two positions in the metric of `separation_m`, m."""
    return hypot(a_enu_m[0] - b_enu_m[0], a_enu_m[1] - b_enu_m[1], HEIGHT_WEIGHT * (a_enu_m[2] - b_enu_m[2]))


def to_separation_metric(position_enu_m: Vector3, has_height: bool) -> Vector3:
    """The position in coordinates whose Euclidean distance is `separation_distance_m`.

    Without `has_height` each vehicle keeps its own altitude, and only the horizontal distance counts.
    """
    x, y, z = position_enu_m
    return (x, y, HEIGHT_WEIGHT * z if has_height else 0.0)


LAYERS = 2
LAYER_HEIGHT = 1.0 / (HEIGHT_WEIGHT * sqrt(2.0))  # half a step aside in x and y, slots of two layers are one step apart

Shape = Callable[[int], list[Vector3]]
SHAPES: dict[str, Shape] = {}  # by name: what files, commands and the page may name


def shape(slots: Shape) -> Shape:
    """Names a shape by its function: the slots of n vehicles, whose spacing is made that of the file."""
    SHAPES[slots.__name__] = slots
    return slots


@shape
def line(n: int) -> list[Vector3]:
    """Abreast, along y."""
    return [(0.0, (n - 1) / 2.0 - i, 0.0) for i in range(n)]


@shape
def column(n: int) -> list[Vector3]:
    """One behind another; the first is at the RFT."""
    return [(-float(i), 0.0, 0.0) for i in range(n)]


@shape
def v(n: int) -> list[Vector3]:
    """A point ahead and two wings swept back by 45 degrees, left and right in turn."""
    return [(-_rank(i) / sqrt(2.0), _rank(i) / sqrt(2.0) * (1.0 if i % 2 else -1.0), 0.0) for i in range(n)]


@shape
def diamond(n: int) -> list[Vector3]:
    """A square with a corner ahead: four vehicles on the corners, further ones on the sides."""
    corners = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
    return _outline(corners, _shares(n, (0, 2, 3, 1)))[:n]  # opposite sides first


@shape
def rectangle(n: int) -> list[Vector3]:
    """The outline of a rectangle on a grid; the sides along x are the longer ones."""
    shares = _shares(n, (1, 3, 0, 2))  # front, left, back, right
    length, width = max(shares[1], shares[3]) + 1.0, max(shares[0], shares[2]) + 1.0
    x, y = length / 2.0, width / 2.0
    return _outline([(x, -y), (x, y), (-x, y), (-x, -y)], shares)[:n]


@shape
def circle(n: int) -> list[Vector3]:
    """Evenly spaced about the RFT, the first slot ahead."""
    if n == 1:
        return [(0.0, 0.0, 0.0)]
    return [(cos(2.0 * pi * i / n), sin(2.0 * pi * i / n), 0.0) for i in range(n)]


@shape
def grid(n: int) -> list[Vector3]:
    """A square grid; the last row is centred."""
    columns = ceil(sqrt(n))
    rows = ceil(n / columns)
    slots = []
    for i in range(n):
        row, in_this_row = divmod(i, columns)
        in_row = columns if row < rows - 1 else n - columns * (rows - 1)
        slots.append(((rows - 1) / 2.0 - row, (in_row - 1) / 2.0 - in_this_row, 0.0))
    return slots


@shape
def layers(n: int) -> list[Vector3]:
    """Grids one above another, each offset by half a step.

    No slot is in the downwash of the slot above it.
    """
    slots: list[Vector3] = []
    for layer in range(LAYERS):
        count = n // LAYERS + (1 if layer < n % LAYERS else 0)
        aside = 0.5 * (layer % 2)
        slots += [(x + aside, y + aside, LAYER_HEIGHT * layer) for x, y, _ in grid(count)] if count else []
    return slots


def slots_of(shape: Shape, n: int, spacing_m: float, heading_rad: float) -> list[Vector3]:
    """n >= 1 slots d_i0 in ENU about the RFT, at least `spacing_m` apart.

    `heading_rad` is the direction of x: 0 is east, pi/2 north.
    """
    unit = shape(n)
    scale = spacing_m / smallest_distance(unit) if n > 1 else 1.0
    return [rotated(slot, heading_rad, scale) for slot in unit]


def rotated(slot: Vector3, heading_rad: float, scale: float) -> Vector3:
    """The slot rotated counterclockwise about the RFT and scaled."""
    (x, y, z), c, s = slot, cos(heading_rad) * scale, sin(heading_rad) * scale
    return (c * x - s * y, s * x + c * y, scale * z)


def smallest_distance(slots: list[Vector3]) -> float:
    """Smallest distance between any two of at least two slots, as `separation_m` counts it, m."""
    counts = [to_separation_metric(slot, has_height=True) for slot in slots]
    return min(dist(a, b) for i, a in enumerate(counts) for b in counts[:i])


def _rank(i: int) -> int:
    """0 for the point, then 1, 1, 2, 2, ..."""
    return (i + 1) // 2


def _shares(n: int, order: Sequence[int]) -> list[int]:
    """How many of n vehicles are on each side between its corners, where the sides get one in this order."""
    return [len(range(order.index(side), n - 4, 4)) for side in range(4)]


def _outline(corners: list[tuple[float, float]], shares: list[int]) -> list[Vector3]:
    """The corners first, then the slots of each side, evenly spaced between its ends."""
    slots: list[Vector3] = [(x, y, 0.0) for x, y in corners]
    for side, share in enumerate(shares):
        (x0, y0), (x1, y1) = corners[side], corners[(side + 1) % len(corners)]
        for i in range(1, share + 1):
            u = i / (share + 1)
            slots.append((x0 + u * (x1 - x0), y0 + u * (y1 - y0), 0.0))
    return slots


# Tolerance of a distance between slots. The ground computes with the slots that vehicles report, to 0.1 mm on each axis.
ROUNDING_M = 5e-4


def closest_approach(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3]) -> tuple[float, int, int]:
    """(smallest distance of two slots during the transition [m], their vehicles).

    (inf, 0, 0) for a single vehicle. Both formations have the same vehicles.

    Slots assigned by the smallest sum of squared distances do not cross on such paths. They keep at least 1/sqrt(2) of the
    smaller of the two formations' separations (Turpin, Michael and Kumar, 2014). The actual minimum distance of a pair is the
    minimum of a quadratic function.
    """
    pairs = (
        (_closest_pair(before_enu_m[i], after_enu_m[i], before_enu_m[j], after_enu_m[j]), i, j)
        for i, j in combinations(sorted(before_enu_m), 2)
    )
    return min(pairs, default=(inf, 0, 0))


def longest_path_m(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3]) -> float:
    """Length of the longest path of any vehicle, m."""
    return max(dist(before_enu_m[i], after_enu_m[i]) for i in before_enu_m)


def peak_speed_m_s(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3], lasts_s: float) -> float:
    """Peak speed of the slot with the longest path, m/s."""
    return PEAK_SPEED * longest_path_m(before_enu_m, after_enu_m) / lasts_s


def _closest_pair(a0: Vector3, a1: Vector3, b0: Vector3, b1: Vector3) -> float:
    """Smallest distance of two slots; their difference moves along a straight line."""
    x, y, z = a0[0] - b0[0], a0[1] - b0[1], a0[2] - b0[2]
    dx, dy, dz = a1[0] - b1[0] - x, a1[1] - b1[1] - y, a1[2] - b1[2] - z
    way2 = dx * dx + dy * dy + dz * dz
    share = min(max(-(x * dx + y * dy + z * dz) / way2, 0.0), 1.0) if way2 > 0.0 else 0.0
    return hypot(x + share * dx, y + share * dy, z + share * dz)


# Largest acceleration of a slot by each of: rotation, a formation change, joining, gap filling.
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
