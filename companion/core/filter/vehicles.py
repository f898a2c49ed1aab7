"""Constraints of the own acceleration that keep a distance from every other vehicle: safety barrier certificates.

Theory of operation, after Wang, Ames and Egerstedt, "Safety Barrier Certificates for Collisions-Free Multirobot Systems", IEEE
T-RO 33(3), 2017. For a pair with distance d and radial speed d' let

    h = d' + V(d - D),    V: the approach speed of `geometry/curves.py`,    D: the required distance.

h >= 0 means that both can still brake before D. A vehicle that keeps h' >= -k h from a start with h >= 0 keeps h >= 0 for ever,
and h' is linear in the accelerations of both: n . (u - u_other) >= least. That is one half-space of u for each other vehicle.
The filter takes the acceleration nearest to the wanted one in all of them (`solver.py`), so nothing is changed far from others.

  - Who makes way. Each of two vehicles in formation takes half of `least`, and what the last command of the other, which its
    packet brings, leaves open. Any other vehicle (traffic, a vehicle in hold or under a pilot) makes no way: the own one takes
    all of it, and plans to brake with less, as others may stand behind it.
  - Time. Vehicles follow their commands with the lag of their attitude, and packets are late. Both vehicles are taken ahead by
    lag and age to coordinates in which they are exact double integrators (`motion.py`), where the argument above holds.
  - D is `separation_m` and margins: position errors that both estimators report, growth while the other is silent, what a
    pilot may do unheard, transport delay that no receiver can see, and room to pass each other. Margins give way to obstacles
    and the fence, `separation_m` does not: a barrier with margins has a second constraint without them, of a higher rank.
  - Margins never push a formation apart: of two vehicles in slots D is at most halfway from `separation_m` to the distance of
    their slots.
  - Heights count half (`geometry/formations.py`), unknown ones of traffic nothing: n is the gradient of the weighted distance,
    and `size` its length.
  - Deadlock. Two vehicles that meet head-on brake for ever. Both add an acceleration to their right (`turn_right`).

What it does not promise: with tilt limits and a speed limit not all constraints may be met at once. Then those of the lowest
rank give way by the least amount, and `separation_m` may be violated; that is reported (SEPARATION_VIOLATED) and counted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot, inf, sqrt

from msgspec import Struct

from companion.core.autopilot import LAG_S
from companion.core.filter.motion import Ahead, Motion, Other, Silence, column_m, nearest_on_way
from companion.core.filter.solver import MARGIN, Constraint
from companion.geometry.curves import approach_speed
from companion.types.autopilot import PositionError, VehicleState
from companion.types.formation import FlownSlot, Gains
from companion.types.status import NearestVehicle
from companion.types.values import Vector3

# Where no norm or paper stands beside a value, the flights of tests/unit/core/filter try it.
# Share of the acceleration at the tilt limit used for braking; the rest is for wind (docs/safety.md).
PLANNED_SHARE = 0.5
ALONE_SHARE = 0.6  # further share where only this vehicle gives way: others may be behind it
# Transport delay that no receiver can measure without a common clock; docs/faults.md flies with as much.
UNSEEN_DELAY_S = 0.1
# The same and the delay of the own response, before a vehicle that flies towards this one.
PURSUED_S = 0.4
# For so long a vehicle is believed to turn away as its last packet says; then it may have changed its mind unheard.
BELIEVED_S = 0.1
KEPT_M = 0.003  # farther apart than separation_m: a distance that is kept by feedback varies by a millimetre
RIPPLE_M = 0.05  # the distance varies by this while a vehicle slides along one that does not give way
RESPONSE_1_S = 5.0  # k: how fast h may approach 0; 1/k is the attitude lag, faster no vehicle responds
SLOPE_1_S = 4.0  # approach speed per metre near the required distance; below k, so that h can follow
FASTEST_LEAVING_M_S = 1.5  # largest speed apart that is demanded inside the required distance
# Where slots move: the attitude follows late, and between others a vehicle cannot always brake as planned.
TRACKING_M = 0.1
LARGEST_ERROR_RATIO = 1.0  # position errors add at most this times separation_m; slots are 3 to 6 errors apart
SLOT_SHARE = 0.5  # margins may take this share of what two slots are farther apart than separation_m
PASSING_M = 0.2  # extra distance between two vehicles that pass each other on the way to their slots
PLACED_WITHIN_M = 0.5  # nearer than that to the offset of their slots, two vehicles do not pass each other
GROWTH_M_S = 0.25  # the required distance from a silent vehicle grows at this rate
LARGEST_GROWTH_RATIO = 0.5  # and by at most this times separation_m
LEAST_DISTANCE_M = 1e-6
SIDEWAYS_RATIO = 0.25  # nearer than this times separation_m the way out is sideways, and kept
SIDE_M = 0.05  # a nearer vehicle shows no side to leave it by: noise would choose
NEAREST_M = 0.1  # keeps the turn of the line between two vehicles finite
TURNING_S2 = 0.5 * LAG_S * LAG_S


@dataclass(frozen=True, slots=True)
class SeparationSettings:
    """Settings of the fleet file, and the acceleration with which each vehicle plans to brake."""

    own_id: int
    separation_m: float
    braking_m_s2: float
    fresh_s: float  # peers.max_age_s
    max_speed_m_s: float


class Barrier(Struct, frozen=True, gc=False):
    """The constraint of one other vehicle, and the offset of this vehicle from it.

    `margin_m` is how much farther away it is than required, as both will be after their lag. `constraint_without_margins` is
    what is left of `constraint` without the margins for position errors and silence: `constraint` gives way to obstacles and
    the fence then, `constraint_without_margins` does not. `below`: this vehicle is below a silent one that may land.
    """

    constraint: Constraint
    other: Other
    offset_enu_m: Vector3
    required_m: float
    margin_m: float
    constraint_without_margins: Constraint | None = None
    below: bool = False


class Separation:
    """One barrier for each vehicle nearby."""

    def __init__(self, settings: SeparationSettings) -> None:
        self.separation_m = settings.separation_m
        self._kept_m = settings.separation_m + KEPT_M
        self._braking_alone_m_s2 = ALONE_SHARE * settings.braking_m_s2
        self._braking_together_m_s2 = 2.0 * settings.braking_m_s2
        self._largest_error_m = LARGEST_ERROR_RATIO * self._kept_m
        self._close_m = SIDEWAYS_RATIO * self._kept_m
        self._sideways: dict[int | str, tuple[float, float]] = {}  # the direction to leave each close vehicle by

    def barriers_below(
        self, ahead: Ahead, error: PositionError, slot: FlownSlot | None, others: Iterable[Other]
    ) -> list[Barrier]:
        """A further barrier for each silent vehicle that may land and is above this one."""
        below = [self._below(ahead, error, slot, other, other.silence) for other in others if other.silence]
        return [barrier for barrier in below if barrier is not None]

    def barrier(self, ahead: Ahead, error: PositionError, slot: FlownSlot | None, other: Other) -> Barrier:
        """The constraint n . u >= a that keeps h' >= -k h, in coordinates whose height is weighted.

        `error` and `slot` are of this vehicle; no slot outside formation.
        """
        (x, y, z), (wx, wy, wz) = ahead.position_enu_m, ahead.velocity_enu_m_s
        weight, slot_of_other = other.height_weight, other.slot
        if other.silence is None:
            ahead_s, ((px, py, pz), (vx, vy, vz), (ax, ay, az)) = other.age_s + LAG_S, other.last
            command_enu_m_s2 = other.commanded_enu_m_s2
        else:
            ahead_s, ((px, py, pz), (vx, vy, vz), (ax, ay, az)) = 0.0, self._nearest_on_way(ahead, other, other.silence)
            command_enu_m_s2 = (ax, ay, az)
        wx, wy, wz = wx - vx - ax * ahead_s, wy - vy - ay * ahead_s, (wz - vz - az * ahead_s) * weight
        rx, ry, rz = x - px - vx * ahead_s, y - py - vy * ahead_s, z - pz - vz * ahead_s
        sz = rz * weight
        apart_m = sqrt(rx * rx + ry * ry + sz * sz)
        if apart_m > self._close_m:
            nx, ny, nz = rx / apart_m, ry / apart_m, sz / apart_m
            if self._sideways:
                self._sideways.pop(other.key, None)
        else:
            nx, ny, nz = (*self._sideways_of(other, rx, ry), 0.0)
        closing_m_s = -(nx * wx + ny * wy + nz * wz)
        across_m_s2 = (wx * wx + wy * wy + wz * wz - closing_m_s * closing_m_s) / (apart_m + NEAREST_M)
        if apart_m <= self._close_m or (other.silence is not None and other.silence.begins_s > 0.0):
            across_m_s2 = 0.0  # the direction does not turn; who passes one end of a way may come to its middle
        mz, offset_enu_m = nz * weight, (rx, ry, rz)
        required_m = self._required(error, slot, other, offset_enu_m, mz)
        late_m, braking_m_s2 = UNSEEN_DELAY_S * closing_m_s if closing_m_s > 0.0 else 0.0, self._braking_together_m_s2
        margins_m = required_m - self._kept_m
        if slot_of_other is None:
            braking_m_s2 = self._braking_alone_m_s2
            if not other.makes_way:  # a pursuer is nearer than its last packet shows, even if it no longer approaches
                late_m = max(late_m, PURSUED_S * (nx * vx + ny * vy + nz * vz * weight))
            late_m += RIPPLE_M + TRACKING_M
        elif other.age_s > BELIEVED_S:
            late_m += GROWTH_M_S * (other.age_s - BELIEVED_S)
        # p of a pair that turns about each other lags inside q; a closing vehicle is nearer than its late packet reports.
        required_m += TURNING_S2 * across_m_s2 + late_m
        margin_m = apart_m - required_m
        size = sqrt(nx * nx + ny * ny + mz * mz)  # norm of the gradient, at most 1
        braking_m_s2 *= size
        allowed_m_s, slope_1_s = approach_speed(margin_m, braking_m_s2, SLOPE_1_S, FASTEST_LEAVING_M_S)
        least_m_s2 = RESPONSE_1_S * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s - across_m_s2
        ux, uy, uz = command_enu_m_s2
        towards_m_s2 = nx * ux + ny * uy + mz * uz
        if other.age_s > BELIEVED_S and towards_m_s2 < 0.0:
            towards_m_s2 = 0.0
        own_m_s2, rank, without_margins = least_m_s2 + towards_m_s2, other.rank, None
        nx, ny, mz = nx / size, ny / size, mz / size
        if slot_of_other is not None:
            if own_m_s2 < 0.5 * least_m_s2:
                own_m_s2 = 0.5 * least_m_s2
        elif margins_m > 0.0:
            allowed_m_s, slope_1_s = approach_speed(margin_m + margins_m, braking_m_s2, SLOPE_1_S, FASTEST_LEAVING_M_S)
            least_m_s2 = RESPONSE_1_S * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s - across_m_s2
            rank, without_margins = MARGIN, (nx, ny, mz, (least_m_s2 + towards_m_s2) / size, other.rank)
        constraint = (nx, ny, mz, own_m_s2 / size, rank)
        return Barrier(constraint, other, offset_enu_m, required_m, margin_m, without_margins)

    def _below(
        self, ahead: Ahead, error: PositionError, slot: FlownSlot | None, other: Other, silence: Silence
    ) -> Barrier | None:
        """The constraint that keeps a horizontal distance below a silent vehicle, which may land."""
        silent_s = other.age_s - silence.kept_s
        if silent_s <= 0.0 or not silence.lands:
            return None
        (x, y, z), (wx, wy, _) = ahead.position_enu_m, ahead.velocity_enu_m_s
        (px, py, pz), (vx, vy, _), (ax, ay, _) = self._nearest_on_way(ahead, other, silence)
        rx, ry, rz, wx, wy = x - px, y - py, z - pz, wx - vx, wy - vy
        required_m = self._required(error, slot, other, (rx, ry, 0.0), 0.0)
        required_m, grows_m_s = column_m(required_m + RIPPLE_M + TRACKING_M, -rz, silent_s, other.height_weight)
        if rz >= 0.0 or required_m <= 0.0:
            return None
        apart_m = hypot(rx, ry)
        nx, ny = (rx / apart_m, ry / apart_m) if apart_m > LEAST_DISTANCE_M else (other.side, 0.0)
        closing_m_s = grows_m_s - nx * wx - ny * wy
        across_m_s = nx * wy - ny * wx
        margin_m = apart_m - required_m
        allowed_m_s, slope_1_s = approach_speed(margin_m, self._braking_alone_m_s2, SLOPE_1_S, FASTEST_LEAVING_M_S)
        least_m_s2 = RESPONSE_1_S * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s + nx * ax + ny * ay
        least_m_s2 -= across_m_s * across_m_s / (apart_m + NEAREST_M)
        constraint = (nx, ny, 0.0, least_m_s2, MARGIN)
        return Barrier(constraint, other, (rx, ry, rz), required_m, margin_m, below=True)

    def _sideways_of(self, other: Other, east_m: float, north_m: float) -> tuple[float, float]:
        """The horizontal direction away from a close vehicle at this offset, the same one while it is close.

        Of two at the same position each flies to its own side.
        """
        kept = self._sideways.get(other.key)
        if kept is None:
            level_m = hypot(east_m, north_m)
            kept = (east_m / level_m, north_m / level_m) if level_m > SIDE_M else (other.side, 0.0)
            self._sideways[other.key] = kept
        return kept

    def _nearest_on_way(self, ahead: Ahead, other: Other, silence: Silence) -> Motion:
        return nearest_on_way(ahead, other.last, other.age_s, LAG_S, silence, other.height_weight)

    def _required(
        self, own: PositionError, slot: FlownSlot | None, other: Other, offset_enu_m: Vector3, upward: float
    ) -> float:
        """separation_m, both position errors along the line between the vehicles, growth in silence, and leaps of a pilot.

        One packet may report any error, so no more than LARGEST_ERROR_RATIO counts; only that of traffic has a bound of its
        own. Less where two slots are so near that these margins would push the formation apart. Slots nearer than separation_m
        cross each other: the less these can be flown, the more margins count. Vehicles that are not placed as their slots pass
        each other on the way there: they get room for it. `offset_enu_m`: from the other vehicle to this one.
        """
        kept_m, error = self._kept_m, other.error
        level_m = hypot(own.horizontal_m, error.horizontal_m)
        height_m = hypot(own.vertical_m, error.vertical_m) * abs(upward)
        margin_m = level_m + height_m  # one standard deviation
        if margin_m > self._largest_error_m:
            most_m = self._largest_error_m
            if isinstance(other.key, str):
                most_m += error.horizontal_m + error.vertical_m * abs(upward)
            margin_m = min(margin_m, most_m)
        if other.silence is not None and other.silence.coasts:
            silent_s = max(0.0, other.age_s - other.silence.kept_s)
            margin_m += min(silent_s * GROWTH_M_S, LARGEST_GROWTH_RATIO * kept_m) + other.silence.leaps_m
        required_m = kept_m + margin_m
        if slot is None or other.slot is None:
            return required_m
        (x, y, z), (ox, oy, oz), (rx, ry, rz) = slot.position_enu_m, other.slot.position_enu_m, offset_enu_m
        weight = other.height_weight
        dx, dy, dz = x - ox, y - oy, z - oz
        ex, ey, ez = rx - dx, ry - dy, (rz - dz) * weight
        dz *= weight
        allowance_m = SLOT_SHARE * abs(sqrt(dx * dx + dy * dy + dz * dz) - kept_m)
        if slot.moves_for_s > 0.0 or other.slot.moves_for_s > 0.0:
            required_m += TRACKING_M
            allowance_m = max(allowance_m, TRACKING_M)
        if ex * ex + ey * ey + ez * ez > PLACED_WITHIN_M * PLACED_WITHIN_M:
            passing_m = SLOT_SHARE * (sqrt(ex * ex + ey * ey + ez * ez) - PLACED_WITHIN_M)
            required_m += passing_m if passing_m < PASSING_M else PASSING_M
            allowance_m = max(allowance_m, passing_m)
        most_m = kept_m + allowance_m
        return required_m if required_m < most_m else most_m


def nearest_and_violated(
    now_s: float, vehicle: VehicleState, barriers: list[Barrier], separation_m: float
) -> tuple[NearestVehicle | None, bool]:
    """The vehicle with the least margin, with its present distance by its last packet; and whether any is too near.

    Distances are in the metric of `separation_m`. Where positions are uncertain, the vehicle with the least margin may be
    farther away than another one.
    """
    old_s = now_s - vehicle.position_time_s
    (x, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
    x, y, z = x + vx * old_s, y + vy * old_s, z + vz * old_s
    least: Barrier | None = None
    least_m, violated = inf, False
    for barrier in barriers:
        other = barrier.other
        ((px, py, pz), (wx, wy, wz), _), age_s = other.last, other.age_s
        if other.silence is not None:
            age_s = min(age_s, other.silence.kept_s)
        dx, dy = x - px - wx * age_s, y - py - wy * age_s
        dz = (z - pz - wz * age_s) * other.height_weight
        distance_m = sqrt(dx * dx + dy * dy + dz * dz)
        if distance_m < separation_m:
            violated = True
        if least is None or (barrier.margin_m < least.margin_m and not barrier.below):
            least, least_m = barrier, distance_m
    nearest = None if least is None else NearestVehicle(str(least.other.key), least_m, least.required_m)
    return nearest, violated


def largest_removed_m_s2(wanted_enu_m_s2: Vector3, barriers: Iterable[Barrier]) -> float:
    """The most that the constraint of a vehicle removes from the wanted acceleration."""
    x, y, z = wanted_enu_m_s2
    most = 0.0
    for barrier in barriers:
        nx, ny, nz, least, _ = barrier.constraint
        short = least - nx * x - ny * y - nz * z
        if short > most:
            most = short
    return most


# Towards a vehicle at the required distance, and for each metre farther away. The attitude needs half a second from a large
# acceleration to the opposite one: vehicles that pull harder between others swing, each time farther.
LARGEST_PULL_M_S2, PULL_SLOPE_1_S2 = 2.0, 4.0
LEAST_PULL_M_S2 = 1.0  # so much is let pass whatever a packet says
PULLED_WITHIN_M = 4.5  # from there on twice gravity is let pass


def eased(wanted_enu_m_s2: Vector3, barriers: Iterable[Barrier]) -> Vector3:
    """The wanted acceleration with a bounded pull towards vehicles that are near, relative to what these command.

    The same object where no bound is exceeded. The largest excess is taken off first: peers have no order.
    """
    (ux, uy, uz), excesses = wanted_enu_m_s2, []
    for barrier in barriers:
        (nx, ny, nz, _, _), margin_m = barrier.constraint, barrier.margin_m
        along = nx * ux + ny * uy + nz * uz
        if along < -LEAST_PULL_M_S2 and margin_m < PULLED_WITHIN_M and not barrier.below:
            ox, oy, oz = barrier.other.commanded_enu_m_s2
            least = nx * ox + ny * oy + nz * oz - LARGEST_PULL_M_S2
            if least > -LEAST_PULL_M_S2:
                least = -LEAST_PULL_M_S2
            if margin_m > 0.0:
                least -= PULL_SLOPE_1_S2 * margin_m
            excess = least - along
            if excess > 0.0:
                excesses.append((excess, nx, ny, nz, least))
    if not excesses:
        return wanted_enu_m_s2
    for _, nx, ny, nz, least in sorted(excesses, reverse=True):
        excess = least - (nx * ux + ny * uy + nz * uz)
        if excess > 0.0:
            ux, uy, uz = ux + excess * nx, uy + excess * ny, uz + excess * nz
    return (ux, uy, uz)


TURN = 0.8  # sideways acceleration for each m/s^2 that a constraint removes from the wanted one
LARGEST_TURN_M_S2 = 2.0  # towards the right of all blocking vehicles together
PASSING_M_S = 1.0  # a vehicle this fast does not stay on the goal
DRIFTING_M_S = 0.2  # sideways, from which on a vehicle that does not make way is passed on its other side
OCCUPIED = 1.0  # a goal nearer to the blocking vehicle than this share of the required distance cannot be reached


def turn_right(
    wanted_enu_m_s2: Vector3, velocity_enu_m_s: Vector3, gains: Gains, barriers: Iterable[Barrier]
) -> tuple[float, float]:
    """Horizontal acceleration to add (east, north), m/s^2: to the right of the vehicles that block the way.

    Two vehicles that meet head-on turn about each other, more than two about their centre. A vehicle that does not make way,
    such as one in hold on the goal, is not circled: the wanted acceleration u is that of a goal (u + k2 v)/k1 away.
    """
    (x, y, z), (vx, vy, _) = wanted_enu_m_s2, velocity_enu_m_s
    right_x = right_y = 0.0
    for barrier in barriers:
        nx, ny, nz, least, _ = barrier.constraint
        along = nx * x + ny * y + nz * z
        removed = (least if least < 0.0 else 0.0) - along  # wanted acceleration that the constraint takes away
        if removed <= 0.0:
            continue
        if barrier.other.slot is None:
            k1, k2 = gains.position_1_s2, gains.velocity_1_s
            rx, ry, _ = barrier.offset_enu_m
            other_x, other_y, _ = barrier.other.last[1]
            goal_m = hypot((x + k2 * vx) / k1 + rx, (y + k2 * vy) / k1 + ry)
            leaves = hypot(other_x, other_y) / PASSING_M_S
            removed *= min(max(2.0 * (goal_m / barrier.required_m - OCCUPIED), leaves, 0.0), 1.0)
            if (vy - other_y) * nx - (vx - other_x) * ny < -DRIFTING_M_S:  # already passing on the other side
                removed = -removed
        right_x, right_y = right_x - TURN * removed * ny, right_y + TURN * removed * nx
    size = hypot(right_x, right_y)
    scale = LARGEST_TURN_M_S2 / size if size > LARGEST_TURN_M_S2 else 1.0
    return (right_x * scale, right_y * scale)
