"""Named formations: slots about the RFT, in the formation's own frame (x ahead, y left, z up), metres.

The smallest distance between any two slots is the spacing, whatever the shape, so that one shape can follow another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import ceil, cos, dist, pi, sin, sqrt

from companion.types import Vector3

LAYERS = 2


def line(n: int) -> list[Vector3]:
    """Side by side, across the way ahead."""
    return [(0.0, (n - 1) / 2.0 - i, 0.0) for i in range(n)]


def column(n: int) -> list[Vector3]:
    """One behind another; the first is at the RFT."""
    return [(-float(i), 0.0, 0.0) for i in range(n)]


def v(n: int) -> list[Vector3]:
    """A point ahead and two wings swept back by 45 degrees, left and right in turn."""
    return [(-_rank(i) / sqrt(2.0), _rank(i) / sqrt(2.0) * (1.0 if i % 2 else -1.0), 0.0) for i in range(n)]


def diamond(n: int) -> list[Vector3]:
    """A square that stands on a corner; four have the corners, more share the sides."""
    corners = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
    shares = [0, 0, 0, 0]
    for extra in range(n - 4):
        shares[(0, 2, 3, 1)[extra % 4]] += 1  # opposite sides first
    return _outline(corners, shares)[:n]


def rectangle(n: int) -> list[Vector3]:
    """The outline of a rectangle on a grid; the sides along the way ahead are the longer ones."""
    shares = [0, 0, 0, 0]  # front, left, back, right
    for extra in range(n - 4):
        shares[(1, 3, 0, 2)[extra % 4]] += 1
    length, width = max(shares[1], shares[3]) + 1.0, max(shares[0], shares[2]) + 1.0
    x, y = length / 2.0, width / 2.0
    return _outline([(x, -y), (x, y), (-x, y), (-x, -y)], shares)[:n]


def circle(n: int) -> list[Vector3]:
    """Evenly round the RFT, the first ahead."""
    if n == 1:
        return [(0.0, 0.0, 0.0)]
    return [(cos(2.0 * pi * i / n), sin(2.0 * pi * i / n), 0.0) for i in range(n)]


def grid(n: int) -> list[Vector3]:
    """Rows as long as there are rows, the last one centred."""
    columns = ceil(sqrt(n))
    rows = ceil(n / columns)
    slots = []
    for i in range(n):
        row, place = divmod(i, columns)
        in_row = columns if row < rows - 1 else n - columns * (rows - 1)
        slots.append(((rows - 1) / 2.0 - row, (in_row - 1) / 2.0 - place, 0.0))
    return slots


def layers(n: int) -> list[Vector3]:
    """Grids one above another, each half a step aside of the next: nobody flies in the downwash of the one above."""
    slots: list[Vector3] = []
    for layer in range(LAYERS):
        count = n // LAYERS + (1 if layer < n % LAYERS else 0)
        aside = 0.5 * (layer % 2)
        slots += [(x + aside, y + aside, float(layer)) for x, y, _ in grid(count)] if count else []
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
    """n >= 1 slots d_i0 in ENU about the RFT, at least `spacing_m` apart; `heading_rad` turns them, 0 is east, pi/2 north."""
    unit = shape(n)
    scale = spacing_m / smallest_distance(unit) if n > 1 else 1.0
    return [turned(slot, heading_rad, scale) for slot in unit]


def turned(slot: Vector3, heading_rad: float, scale: float) -> Vector3:
    """Counterclockwise about the RFT, and so many times as far out."""
    (x, y, z), c, s = slot, cos(heading_rad) * scale, sin(heading_rad) * scale
    return (c * x - s * y, s * x + c * y, scale * z)


def smallest_distance(slots: list[Vector3]) -> float:
    """Between any two of at least two."""
    return min(dist(a, b) for i, a in enumerate(slots) for b in slots[:i])


def _rank(i: int) -> int:
    """0 for the point, then 1, 1, 2, 2, ..."""
    return (i + 1) // 2


def _outline(corners: list[tuple[float, float]], shares: list[int]) -> list[Vector3]:
    """The corners first, then what stands on each side, evenly between its ends."""
    slots: list[Vector3] = [(x, y, 0.0) for x, y in corners]
    for side, share in enumerate(shares):
        (x0, y0), (x1, y1) = corners[side], corners[(side + 1) % len(corners)]
        for i in range(1, share + 1):
            u = i / (share + 1)
            slots.append((x0 + u * (x1 - x0), y0 + u * (y1 - y0), 0.0))
    return slots
