"""Named formations: slots about the RFT, in the formation's own frame (x ahead, y left, z up), metres.

The smallest distance between any two slots is the spacing in every shape, as `separation_m` counts
distances, so that a formation can change from one shape to another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import ceil, cos, dist, pi, sin, sqrt

from companion.geometry.separation import HEIGHT_WEIGHT, counted
from companion.types.values import Vector3

LAYERS = 2
LAYER_HEIGHT = 1.0 / (HEIGHT_WEIGHT * sqrt(2.0))  # half a step aside in x and y, slots of two layers are one step apart


def line(n: int) -> list[Vector3]:
    """Abreast, along y."""
    return [(0.0, (n - 1) / 2.0 - i, 0.0) for i in range(n)]


def column(n: int) -> list[Vector3]:
    """One behind another; the first is at the RFT."""
    return [(-float(i), 0.0, 0.0) for i in range(n)]


def v(n: int) -> list[Vector3]:
    """A point ahead and two wings swept back by 45 degrees, left and right in turn."""
    return [(-_rank(i) / sqrt(2.0), _rank(i) / sqrt(2.0) * (1.0 if i % 2 else -1.0), 0.0) for i in range(n)]


def diamond(n: int) -> list[Vector3]:
    """A square with a corner ahead: four vehicles on the corners, further ones on the sides."""
    corners = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
    shares = [0, 0, 0, 0]
    for extra in range(n - 4):
        shares[(0, 2, 3, 1)[extra % 4]] += 1  # opposite sides first
    return _outline(corners, shares)[:n]


def rectangle(n: int) -> list[Vector3]:
    """The outline of a rectangle on a grid; the sides along x are the longer ones."""
    shares = [0, 0, 0, 0]  # front, left, back, right
    for extra in range(n - 4):
        shares[(1, 3, 0, 2)[extra % 4]] += 1
    length, width = max(shares[1], shares[3]) + 1.0, max(shares[0], shares[2]) + 1.0
    x, y = length / 2.0, width / 2.0
    return _outline([(x, -y), (x, y), (-x, y), (-x, -y)], shares)[:n]


def circle(n: int) -> list[Vector3]:
    """Evenly spaced about the RFT, the first slot ahead."""
    if n == 1:
        return [(0.0, 0.0, 0.0)]
    return [(cos(2.0 * pi * i / n), sin(2.0 * pi * i / n), 0.0) for i in range(n)]


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


Shape = Callable[[int], list[Vector3]]
SHAPES: Mapping[str, Shape] = {
    "line": line,
    "column": column,
    "v": v,
    "diamond": diamond,
    "rectangle": rectangle,
    "circle": circle,
    "grid": grid,
    "layers": layers,
}


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
    counts = [counted(slot, has_height=True) for slot in slots]
    return min(dist(a, b) for i, a in enumerate(counts) for b in counts[:i])


def _rank(i: int) -> int:
    """0 for the point, then 1, 1, 2, 2, ..."""
    return (i + 1) // 2


def _outline(corners: list[tuple[float, float]], shares: list[int]) -> list[Vector3]:
    """The corners first, then the slots of each side, evenly spaced between its ends."""
    slots: list[Vector3] = [(x, y, 0.0) for x, y in corners]
    for side, share in enumerate(shares):
        (x0, y0), (x1, y1) = corners[side], corners[(side + 1) % len(corners)]
        for i in range(1, share + 1):
            u = i / (share + 1)
            slots.append((x0 + u * (x1 - x0), y0 + u * (y1 - y0), 0.0))
    return slots
