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

from companion.types.vectors import GRAVITY_M_S2, Vector3

MET_M_S2 = 1e-6  # a half-space that is violated by less is met
LEAST_NEW = 1e-9  # share of a normal outside the span of the active ones, squared, below which it lies within
TILT_ROUNDING = 1.01  # the tilt limit is a cone: its tangent planes are cut off this close to it
NEVER_ACTIVE_M_S2 = -12.0  # beyond what any vehicle flies
SURELY_POSSIBLE_M_S2 = 1.0
MOST_STEPS = 5  # of the active set: bounds the time; the half-spaces violated most come first


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

    Thrust ratios are vertical thrust over weight. `disturbance_enu_m_s2` is the estimated acceleration by wind, z is 0.
    """

    tan_max_tilt: float
    min_thrust_ratio: float
    max_thrust_ratio: float
    disturbance_enu_m_s2: Vector3

    @property
    def lowest_m_s2(self) -> float:
        return (self.min_thrust_ratio - 1.0) * GRAVITY_M_S2

    @property
    def highest_m_s2(self) -> float:
        return (self.max_thrust_ratio - 1.0) * GRAVITY_M_S2

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


class _ContradictionError(Exception):
    """These half-spaces cannot be met together: sum of share * normal = 0, with shares >= 0."""

    def __init__(self, shares: list[tuple[int, float]], found_enu_m_s2: Vector3) -> None:
        super().__init__()
        self.shares = shares
        self.found_enu_m_s2 = found_enu_m_s2  # meets those that were violated most


def _solved(
    start_enu_m_s2: Vector3, half_spaces: Sequence[HalfSpace], limits: AccelerationLimits, most_steps: int
) -> Vector3:
    up_m_s2 = start_enu_m_s2[2]
    normals: list[Vector3] = []
    ranks: list[Rank] = []
    least: list[float] = []
    for space in half_spaces:
        least_m_s2 = space.least_m_s2
        if least_m_s2 < NEVER_ACTIVE_M_S2:
            continue
        if least_m_s2 > SURELY_POSSIBLE_M_S2:  # more than the vehicle can do is asked of it as all that it can do
            least_m_s2 = min(least_m_s2, limits.most_along(space.normal_enu, up_m_s2))
        normals.append(space.normal_enu)
        ranks.append(space.rank)
        least.append(least_m_s2)
    steps = [most_steps]
    while True:
        try:
            found = _active_set(start_enu_m_s2, normals, least, steps)
        except _ContradictionError as contradiction:
            if steps[0] <= 0:
                return limits.nearest(contradiction.found_enu_m_s2)
            _relax(contradiction.shares, ranks, least)
            continue
        cut = None if steps[0] <= 0 else _cut(found, limits)
        if cut is None:
            return limits.nearest(found)
        normals.append(cut.normal_enu)
        least.append(cut.least_m_s2)
        ranks.append(cut.rank)


def _cut(found_enu_m_s2: Vector3, limits: AccelerationLimits) -> HalfSpace | None:
    """The limit that this acceleration violates, as a tangent plane; None within the limits."""
    (x, y, z), (dx, dy, _) = found_enu_m_s2, limits.disturbance_enu_m_s2
    if z > limits.highest_m_s2 + MET_M_S2:
        return HalfSpace((0.0, 0.0, -1.0), -limits.highest_m_s2, Rank.LIMIT)
    if z < limits.lowest_m_s2 - MET_M_S2:
        return HalfSpace((0.0, 0.0, 1.0), limits.lowest_m_s2, Rank.LIMIT)
    radius, level = limits.level_radius_m_s2(z), hypot(x - dx, y - dy)
    if level <= radius * TILT_ROUNDING:
        return None
    nx, ny = (dx - x) / level, (dy - y) / level
    return HalfSpace((nx, ny, 0.0), nx * dx + ny * dy - radius, Rank.LIMIT)


def _relax(shares: list[tuple[int, float]], ranks: list[Rank], least: list[float]) -> None:
    """Lower the least accelerations of the lowest rank in a contradiction, by the same and smallest amount."""
    rank = max(ranks[k] for k, _ in shares)
    excess = sum(share * least[k] for k, share in shares)
    relaxed = sum(share for k, share in shares if ranks[k] is rank)
    lower = max(excess, 0.0) / relaxed + MET_M_S2
    for k, of in enumerate(ranks):
        if of is rank:
            least[k] -= lower


def _active_set(start: Vector3, normals: list[Vector3], least: list[float], steps: list[int]) -> Vector3:
    """The point nearest to `start` that meets all. Raises _ContradictionError. `steps` are those left; it stops at 0."""
    x, y, z = start
    active: list[int] = []
    weights: list[float] = []
    while steps[0] > 0:
        worst, most = -1, MET_M_S2
        for k, (nx, ny, nz) in enumerate(normals):
            short = least[k] - nx * x - ny * y - nz * z
            if short > most:
                worst, most = k, short
        if worst < 0:
            return (x, y, z)
        nx, ny, nz = normals[worst]
        weight = 0.0
        while steps[0] > 0:
            steps[0] -= 1
            shares, (ox, oy, oz) = _split((nx, ny, nz), [normals[k] for k in active])
            new = ox * ox + oy * oy + oz * oz
            full = (least[worst] - nx * x - ny * y - nz * z) / new if new > LEAST_NEW else inf
            leaves, step = -1, full
            for place, share in enumerate(shares):
                if share > 1e-12 and weights[place] / share < step:
                    leaves, step = place, weights[place] / share
            if step == inf:
                found = [(k, -share) for k, share in zip(active, shares, strict=True) if share < -1e-12]
                raise _ContradictionError([(worst, 1.0), *found], (x, y, z))
            x, y, z = x + step * ox, y + step * oy, z + step * oz
            weight += step
            for place, share in enumerate(shares):
                weights[place] -= step * share
            if leaves < 0:
                active.append(worst)
                weights.append(weight)
                break
            del active[leaves], weights[leaves]
    return (x, y, z)


def _split(normal: Vector3, active: list[Vector3]) -> tuple[list[float], Vector3]:
    """Shares of the active normals in a normal, and what is left outside their span. At most three are active."""
    x, y, z = normal
    if not active:
        return [], normal
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
