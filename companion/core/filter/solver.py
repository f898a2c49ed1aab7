"""The acceleration nearest to the wanted one that meets all constraints within the acceleration limits.

A quadratic program in three variables, solved by the dual active-set method of Goldfarb and Idnani (1983): it starts at the
wanted acceleration and adds one violated constraint at a time, so nothing is computed where none is violated. Where the
constraints contradict each other, those of the lowest rank in the contradiction are relaxed by the same least amount.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from math import hypot, inf

from msgspec import Struct

from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

MET_M_S2 = 1e-6  # a constraint that is violated by less is met
LEAST_SHARE = 1e-12  # a smaller share of one active normal in another counts as none
LEAST_NEW = 1e-9  # share of a normal outside the span of the active ones, squared, below which it lies within
TILT_ROUNDING = 1.01  # the tilt limit is a cone: its tangent planes are cut off this close to it
NEVER_ACTIVE_M_S2 = -12.0  # beyond what any vehicle flies
SURELY_POSSIBLE_M_S2 = 1.0
MOST_STEPS = 5  # most steps of the active-set method, most violated constraint first: bounds the time


class Rank(IntEnum):
    """Which constraints give way first where not all can be met: the largest rank."""

    LIMIT = 0  # what the vehicle can fly; never relaxed
    GROUND = 1
    VEHICLE = 2
    OBSTACLE = 3
    FENCE = 4
    MARGIN = 5  # more distance from a vehicle than separation_m, for what is not known of it
    SPEED = 6
    UNSHAKEN = 7  # a vehicle that no evasion shakes off: `pressure.py`


LIMIT, VEHICLE, MARGIN = Rank.LIMIT, Rank.VEHICLE, Rank.MARGIN  # enum member lookup is slow, and every tick needs them
Constraint = tuple[float, float, float, float, Rank]
"""Accelerations u with normal . u >= least, m/s^2: the normal of length 1 (east, north, up), least, and the rank.

A flat tuple, because the solver goes through all constraints many times in a tick.
"""
Contradiction = list[tuple[Constraint, float]]
"""Constraints that cannot be met together, with shares: the sum of share * normal is 0, all shares are positive."""
NO_CONTRADICTION: Contradiction = []


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

    def level_radius_m_s2(self, up_m_s2: float) -> float:
        """Largest horizontal acceleration in still air beside this vertical one."""
        return (self._vertical(up_m_s2) + GRAVITY_M_S2) * self.tan_max_tilt

    def limit(self, acceleration_enu_m_s2: Vector3) -> Vector3:
        """The possible acceleration with the vertical part first, then the horizontal direction; itself if possible."""
        (x, y, up), (dx, dy, _) = acceleration_enu_m_s2, self.disturbance_enu_m_s2
        z = up if self.lowest_m_s2 <= up <= self.highest_m_s2 else self._vertical(up)
        radius, level = (z + GRAVITY_M_S2) * self.tan_max_tilt, hypot(x - dx, y - dy)
        if level <= radius:
            return acceleration_enu_m_s2 if z == up else (x, y, z)
        scale = radius / level
        return (dx + (x - dx) * scale, dy + (y - dy) * scale, z)

    def _vertical(self, up_m_s2: float) -> float:
        if up_m_s2 < self.lowest_m_s2:
            return self.lowest_m_s2
        return self.highest_m_s2 if up_m_s2 > self.highest_m_s2 else up_m_s2


def filter_acceleration(
    wanted_enu_m_s2: Vector3,
    constraints: Sequence[Constraint],
    limits: AccelerationLimits,
    most_steps: int = MOST_STEPS,
) -> Vector3:
    """The wanted acceleration itself, the same object, where it meets all constraints; else the nearest one that does.

    Of one that the vehicle cannot fly, what the limits leave of it must meet them, too.
    """
    possible = limits.limit(wanted_enu_m_s2)
    if _meets(wanted_enu_m_s2, constraints) and (possible is wanted_enu_m_s2 or _meets(possible, constraints)):
        return wanted_enu_m_s2
    return _solve(possible, constraints, limits, most_steps)


def _meets(acceleration_enu_m_s2: Vector3, constraints: Sequence[Constraint]) -> bool:
    x, y, z = acceleration_enu_m_s2
    for nx, ny, nz, least, _ in constraints:
        if nx * x + ny * y + nz * z < least - MET_M_S2:
            break
    else:  # not all(): it is slow
        return True
    return False


def _solve(
    start_enu_m_s2: Vector3, constraints: Sequence[Constraint], limits: AccelerationLimits, steps: int
) -> Vector3:
    rows = _asked(constraints, limits, start_enu_m_s2[2])
    complete = None  # the last point of an active set that came to its end
    while True:
        found, steps, contradiction = _active_set(start_enu_m_s2, rows, steps)
        possible = limits.limit(found)
        if steps < 0:  # half a solution may leave out what a whole one of before meets
            return possible if complete is None else min(complete, possible, key=lambda u: shortfalls(u, rows))
        if contradiction:
            complete, rows = possible, _relax(rows, contradiction)
            continue
        cut = None if possible is found else _cut(found, limits)
        if cut is None:
            return possible
        complete = possible
        rows.append(cut)


def shortfalls(acceleration_enu_m_s2: Vector3, rows: Sequence[Constraint]) -> list[float]:
    """By how much it violates the row of each rank that it violates most, those first that give way last."""
    x, y, z = acceleration_enu_m_s2
    worst = [MET_M_S2] * len(Rank)
    for nx, ny, nz, least, rank in rows:
        short = least - nx * x - ny * y - nz * z
        if short > worst[rank]:
            worst[rank] = short
    return worst


def _asked(constraints: Sequence[Constraint], limits: AccelerationLimits, up_m_s2: float) -> list[Constraint]:
    """Constraints that may matter. More than the vehicle can do is asked of it as all that it can do.

    That is the largest acceleration along the normal while the vertical one is about `up_m_s2`.
    """
    asked: list[Constraint] = []
    radius, (dx, dy, _) = limits.level_radius_m_s2(up_m_s2), limits.disturbance_enu_m_s2
    lowest, highest = limits.lowest_m_s2, limits.highest_m_s2
    for constraint in constraints:
        nx, ny, nz, least, rank = constraint
        if least < NEVER_ACTIVE_M_S2:
            continue
        if least > SURELY_POSSIBLE_M_S2:
            most = radius * hypot(nx, ny) + nx * dx + ny * dy + nz * (highest if nz > 0.0 else lowest)
            if most < least:
                constraint = (nx, ny, nz, most, rank)
        asked.append(constraint)
    return asked


def _cut(found_enu_m_s2: Vector3, limits: AccelerationLimits) -> Constraint | None:
    """The limit that this acceleration violates, as a tangent plane; None within the limits."""
    (x, y, z), (dx, dy, _) = found_enu_m_s2, limits.disturbance_enu_m_s2
    if z > limits.highest_m_s2 + MET_M_S2:
        return (0.0, 0.0, -1.0, -limits.highest_m_s2, LIMIT)
    if z < limits.lowest_m_s2 - MET_M_S2:
        return (0.0, 0.0, 1.0, limits.lowest_m_s2, LIMIT)
    radius, level = limits.level_radius_m_s2(z), hypot(x - dx, y - dy)
    if level <= radius * TILT_ROUNDING:
        return None
    nx, ny = (dx - x) / level, (dy - y) / level
    if z >= 0.0:  # heights come first
        return (nx, ny, 0.0, nx * dx + ny * dy - radius, LIMIT)
    # The tangent plane of the cone: more thrust allows more tilt, so a dive is given up where braking needs it.
    tan_tilt, size = limits.tan_max_tilt, hypot(1.0, limits.tan_max_tilt)
    nx, ny, nz = nx / size, ny / size, tan_tilt / size
    return (nx, ny, nz, nx * dx + ny * dy - nz * GRAVITY_M_S2, LIMIT)


def _relax(rows: list[Constraint], contradiction: Contradiction) -> list[Constraint]:
    """The rows with less asked of those of the lowest rank in a contradiction, by the same and smallest amount."""
    lowest = LIMIT
    for (_, _, _, _, rank), _ in contradiction:
        if rank > lowest:
            lowest = rank
    excess = relaxed = 0.0
    for (_, _, _, least, rank), share in contradiction:
        excess += share * least
        if rank is lowest:
            relaxed += share
    lower = max(excess, 0.0) / relaxed + MET_M_S2
    return [
        (nx, ny, nz, least - lower, rank) if rank is lowest else (nx, ny, nz, least, rank)
        for nx, ny, nz, least, rank in rows
    ]


def _active_set(start: Vector3, rows: list[Constraint], steps: int) -> tuple[Vector3, int, Contradiction]:
    """(the point nearest to `start` that meets all rows, the steps left, no contradiction); -1 where the steps do not suffice.

    Where rows contradict each other, the point is the one found before.
    """
    x, y, z = start
    active: list[Constraint] = []
    weights: list[float] = []  # multipliers of the active rows
    while True:
        worst, most = None, MET_M_S2
        for row in rows:
            nx, ny, nz, least, _ = row
            short = least - nx * x - ny * y - nz * z
            if short > most:
                worst, most = row, short
        if worst is None:
            return (x, y, z), steps, NO_CONTRADICTION
        if steps <= 0:
            return (x, y, z), -1, NO_CONTRADICTION
        nx, ny, nz, least, _ = worst
        if not active:  # straight to it
            step = most / (nx * nx + ny * ny + nz * nz)
            x, y, z = x + step * nx, y + step * ny, z + step * nz
            active, weights, steps = [worst], [step], steps - 1
            continue
        weight = 0.0
        while steps > 0 and active:
            steps -= 1
            shares, ox, oy, oz = _split(nx, ny, nz, active)
            new = ox * ox + oy * oy + oz * oz
            leaves, step = -1, most / new if new > LEAST_NEW else inf
            for place, share in enumerate(shares):
                if share > LEAST_SHARE and (lasts := weights[place] / share) < step:
                    leaves, step = place, lasts
            if step == inf:
                others = [(row, -share) for row, share in zip(active, shares, strict=True) if share < -LEAST_SHARE]
                return (x, y, z), steps, [(worst, 1.0), *others]
            x, y, z = x + step * ox, y + step * oy, z + step * oz
            weight += step
            for place, share in enumerate(shares):
                weights[place] -= step * share
            if leaves < 0:
                active.append(worst)
                weights.append(weight)
                break
            del active[leaves], weights[leaves]
            most = least - nx * x - ny * y - nz * z


def _split(x: float, y: float, z: float, active: list[Constraint]) -> tuple[Sequence[float], float, float, float]:
    """Shares of the active normals in a normal (x, y, z), and what is left outside their span. One to three are active."""
    ax, ay, az, _, _ = active[0]
    along_a = ax * x + ay * y + az * z
    if len(active) == 1:
        return (along_a,), x - along_a * ax, y - along_a * ay, z - along_a * az
    bx, by, bz, _, _ = active[1]
    ab = ax * bx + ay * by + az * bz
    if len(active) == 2:
        along_b, rest = bx * x + by * y + bz * z, 1.0 - ab * ab
        a, b = (along_a - ab * along_b) / rest, (along_b - ab * along_a) / rest
        return (a, b), x - a * ax - b * bx, y - a * ay - b * by, z - a * az - b * bz
    cx, cy, cz, _, _ = active[2]
    bcx, bcy, bcz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    volume = ax * bcx + ay * bcy + az * bcz
    a = (x * bcx + y * bcy + z * bcz) / volume
    b = (ax * (y * cz - z * cy) + ay * (z * cx - x * cz) + az * (x * cy - y * cx)) / volume
    c = (ax * (by * z - bz * y) + ay * (bz * x - bx * z) + az * (bx * y - by * x)) / volume
    return (a, b, c), 0.0, 0.0, 0.0
