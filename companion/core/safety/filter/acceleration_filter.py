"""The acceleration nearest to the wanted one that meets all half-spaces within the acceleration limits.

A quadratic program in three variables, solved by the dual active-set method of Goldfarb and Idnani (1983): it starts at the
wanted acceleration and adds one violated half-space at a time, so nothing is computed where none is violated. Where the
half-spaces contradict each other, those of the lowest rank in the contradiction are relaxed by the same least amount.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from math import hypot, inf

from msgspec import Struct

from companion.types.vectors import GRAVITY_M_S2, ZERO3, Vector3

MET_M_S2 = 1e-6  # a half-space that is violated by less is met
LEAST_SHARE = 1e-12  # of an active normal in another one, below which it counts as none
LEAST_NEW = 1e-9  # share of a normal outside the span of the active ones, squared, below which it lies within
TILT_ROUNDING = 1.01  # the tilt limit is a cone: its tangent planes are cut off this close to it
NEVER_ACTIVE_M_S2 = -12.0  # beyond what any vehicle flies
SURELY_POSSIBLE_M_S2 = 1.0
MOST_STEPS = 5  # of the active set: bounds the time; the half-spaces violated most come first


Row = tuple[float, float, float, float]
"""A half-space as the solver uses it: the normal, and the least acceleration along it."""


class Rank(IntEnum):
    """Which half-spaces give way first where not all can be met: the largest rank."""

    LIMIT = 0  # what the vehicle can fly; never relaxed
    VEHICLE = 1
    OBSTACLE = 2
    FENCE = 3
    SPEED = 4


class HalfSpace(Struct, frozen=True, gc=False):
    """Accelerations u with normal . u >= least, m/s^2; the normal has length 1."""

    normal_enu: Vector3
    least_m_s2: float
    rank: Rank = Rank.VEHICLE


class AccelerationLimits(Struct, frozen=True, gc=False):
    """What tilt and thrust allow: a cut cone about the acceleration by the wind.

    `lowest_m_s2` and `highest_m_s2` bound the vertical acceleration. `disturbance_enu_m_s2` is the estimated acceleration by
    wind, z is 0.
    """

    tan_max_tilt: float
    lowest_m_s2: float
    highest_m_s2: float
    disturbance_enu_m_s2: Vector3

    @classmethod
    def of_envelope(cls, tan_max_tilt: float, min_thrust_ratio: float, max_thrust_ratio: float) -> AccelerationLimits:
        """In still air. Thrust ratios are vertical thrust over weight."""
        lowest_m_s2, highest_m_s2 = (min_thrust_ratio - 1.0) * GRAVITY_M_S2, (max_thrust_ratio - 1.0) * GRAVITY_M_S2
        return cls(tan_max_tilt, lowest_m_s2, highest_m_s2, ZERO3)

    def in_wind(self, disturbance_enu_m_s2: Vector3) -> AccelerationLimits:
        return AccelerationLimits(self.tan_max_tilt, self.lowest_m_s2, self.highest_m_s2, disturbance_enu_m_s2)

    def level_radius_m_s2(self, up_m_s2: float) -> float:
        """Largest horizontal acceleration in still air beside this vertical one."""
        return (min(max(up_m_s2, self.lowest_m_s2), self.highest_m_s2) + GRAVITY_M_S2) * self.tan_max_tilt

    def nearest(self, acceleration_enu_m_s2: Vector3) -> Vector3:
        """The possible acceleration with the vertical part first, then the horizontal direction."""
        (x, y, z), (dx, dy, _) = acceleration_enu_m_s2, self.disturbance_enu_m_s2
        z = min(max(z, self.lowest_m_s2), self.highest_m_s2)
        radius, level = self.level_radius_m_s2(z), hypot(x - dx, y - dy)
        if level <= radius:
            return (x, y, z)
        scale = radius / level
        return (dx + (x - dx) * scale, dy + (y - dy) * scale, z)

    def most_along(self, normal_enu: Vector3, up_m_s2: float) -> float:
        """Largest acceleration along a direction while the vertical one is about `up_m_s2`, m/s^2."""
        (x, y, z), (dx, dy, _) = normal_enu, self.disturbance_enu_m_s2
        level = self.level_radius_m_s2(up_m_s2) * hypot(x, y) + x * dx + y * dy
        return level + z * (self.highest_m_s2 if z > 0.0 else self.lowest_m_s2)


def filtered(
    wanted_enu_m_s2: Vector3, half_spaces: Sequence[HalfSpace], limits: AccelerationLimits, most_steps: int = MOST_STEPS
) -> Vector3:
    """The wanted acceleration itself, the same object, where it meets all half-spaces; else the nearest one that does."""
    x, y, z = wanted_enu_m_s2
    for space in half_spaces:
        nx, ny, nz = space.normal_enu
        if nx * x + ny * y + nz * z < space.least_m_s2 - MET_M_S2:
            break
    else:
        return wanted_enu_m_s2
    return _solved(limits.nearest(wanted_enu_m_s2), half_spaces, limits, most_steps)


def _solved(
    start_enu_m_s2: Vector3, half_spaces: Sequence[HalfSpace], limits: AccelerationLimits, steps: int
) -> Vector3:
    rows, ranks = _asked(half_spaces, limits, start_enu_m_s2[2])
    while True:
        found, steps, contradiction = _active_set(start_enu_m_s2, rows, steps)
        if steps <= 0:
            return limits.nearest(found)
        if contradiction:
            _relax(contradiction, ranks, rows)
            continue
        cut = _cut(found, limits)
        if cut is None:
            return limits.nearest(found)
        rows.append(cut)
        ranks.append(Rank.LIMIT)


def _asked(
    half_spaces: Sequence[HalfSpace], limits: AccelerationLimits, up_m_s2: float
) -> tuple[list[Row], list[Rank]]:
    """Half-spaces that may matter. More than the vehicle can do is asked of it as all that it can do."""
    rows: list[Row] = []
    ranks: list[Rank] = []
    for space in half_spaces:
        least_m_s2 = space.least_m_s2
        if least_m_s2 < NEVER_ACTIVE_M_S2:
            continue
        normal_enu = space.normal_enu
        if least_m_s2 > SURELY_POSSIBLE_M_S2:
            least_m_s2 = min(least_m_s2, limits.most_along(normal_enu, up_m_s2))
        rows.append((*normal_enu, least_m_s2))
        ranks.append(space.rank)
    return rows, ranks


def _cut(found_enu_m_s2: Vector3, limits: AccelerationLimits) -> Row | None:
    """The limit that this acceleration violates, as a tangent plane; None within the limits."""
    (x, y, z), (dx, dy, _) = found_enu_m_s2, limits.disturbance_enu_m_s2
    if z > limits.highest_m_s2 + MET_M_S2:
        return (0.0, 0.0, -1.0, -limits.highest_m_s2)
    if z < limits.lowest_m_s2 - MET_M_S2:
        return (0.0, 0.0, 1.0, limits.lowest_m_s2)
    radius, level = limits.level_radius_m_s2(z), hypot(x - dx, y - dy)
    if level <= radius * TILT_ROUNDING:
        return None
    nx, ny = (dx - x) / level, (dy - y) / level
    return (nx, ny, 0.0, nx * dx + ny * dy - radius)


def _relax(shares: list[tuple[int, float]], ranks: list[Rank], rows: list[Row]) -> None:
    """Lower the least accelerations of the lowest rank in a contradiction, by the same and smallest amount."""
    rank = max(ranks[k] for k, _ in shares)
    excess = sum(share * rows[k][3] for k, share in shares)
    relaxed = sum(share for k, share in shares if ranks[k] is rank)
    lower = max(excess, 0.0) / relaxed + MET_M_S2
    for k, (nx, ny, nz, least) in enumerate(rows):
        if ranks[k] is rank:
            rows[k] = (nx, ny, nz, least - lower)


def _active_set(start: Vector3, rows: list[Row], steps: int) -> tuple[Vector3, int, list[tuple[int, float]]]:
    """(the point nearest to `start` that meets all rows, the steps left, no contradiction). It stops without steps left.

    Where rows contradict each other: the point that meets those violated most, and the contradiction as the rows and their
    shares: the sum of share * normal is 0, all shares are positive.
    """
    x, y, z = start
    active: list[int] = []
    normals: list[Vector3] = []  # of the active rows
    weights: list[float] = []  # their multipliers
    while steps > 0:
        worst, most = -1, MET_M_S2
        for k, (nx, ny, nz, least) in enumerate(rows):
            short = least - nx * x - ny * y - nz * z
            if short > most:
                worst, most = k, short
        if worst < 0:
            break
        nx, ny, nz, least = rows[worst]
        weight = 0.0
        while steps > 0:
            steps -= 1
            shares, (ox, oy, oz) = _split(nx, ny, nz, normals)
            new = ox * ox + oy * oy + oz * oz
            leaves, step = -1, (least - nx * x - ny * y - nz * z) / new if new > LEAST_NEW else inf
            for place, share in enumerate(shares):
                if share > LEAST_SHARE and weights[place] / share < step:
                    leaves, step = place, weights[place] / share
            if step == inf:
                others = [(k, -share) for k, share in zip(active, shares, strict=True) if share < -LEAST_SHARE]
                return (x, y, z), steps, [(worst, 1.0), *others]
            x, y, z = x + step * ox, y + step * oy, z + step * oz
            weight += step
            for place, share in enumerate(shares):
                weights[place] -= step * share
            if leaves < 0:
                active.append(worst)
                normals.append((nx, ny, nz))
                weights.append(weight)
                break
            del active[leaves], normals[leaves], weights[leaves]
    return (x, y, z), steps, []


def _split(x: float, y: float, z: float, active: list[Vector3]) -> tuple[list[float], Vector3]:
    """Shares of the active normals in a normal (x, y, z), and what is left outside their span. At most three are active."""
    if not active:
        return [], (x, y, z)
    ax, ay, az = active[0]
    along_a = ax * x + ay * y + az * z
    if len(active) == 1:
        return [along_a], (x - along_a * ax, y - along_a * ay, z - along_a * az)
    bx, by, bz = active[1]
    ab = ax * bx + ay * by + az * bz
    if len(active) == 2:
        along_b, rest = bx * x + by * y + bz * z, 1.0 - ab * ab
        a, b = (along_a - ab * along_b) / rest, (along_b - ab * along_a) / rest
        return [a, b], (x - a * ax - b * bx, y - a * ay - b * by, z - a * az - b * bz)
    cx, cy, cz = active[2]
    bcx, bcy, bcz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    volume = ax * bcx + ay * bcy + az * bcz
    a = (x * bcx + y * bcy + z * bcz) / volume
    b = (ax * (y * cz - z * cy) + ay * (z * cx - x * cz) + az * (x * cy - y * cx)) / volume
    c = (ax * (by * z - bz * y) + ay * (bz * x - bx * z) + az * (bx * y - by * x)) / volume
    return [a, b, c], (0.0, 0.0, 0.0)
