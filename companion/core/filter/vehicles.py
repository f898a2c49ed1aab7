"""Half-spaces of the own acceleration that keep a distance from every other vehicle: safety barrier certificates.

After Wang, Ames and Egerstedt, "Safety Barrier Certificates for Collisions-Free Multirobot Systems", IEEE T-RO 2017. For a pair
with distance d and radial speed d', h = d' + V(d - D) >= 0 means that both can still brake before the required distance D;
V is the approach speed of `geometry/curves.py`. h' >= -k h is linear in both accelerations. Each of two cooperating vehicles
takes half of it, and what the other's last command leaves open; for any other vehicle the own one takes all of it.

Both vehicles are taken ahead by their attitude lag (`lag.py`), where they are exact double integrators.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import hypot, sqrt

from msgspec import Struct

from companion.core.consensus.law import Gains
from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import (
    KEPT_S,
    LAG_S,
    NO_ERROR,
    Ahead,
    Motion,
    Other,
    Others,
    Silence,
    column_m,
    nearest_on_way,
)
from companion.core.filter.solver import MARGIN, VEHICLE, HalfSpace
from companion.geometry.curves import approach_speed
from companion.types.autopilot import PositionError, VehicleState
from companion.types.formation import FlownSlot
from companion.types.peers import ReceivedTraffic
from companion.types.status import NearestVehicle
from companion.types.values import Vector3

PLANNED_SHARE = 0.5  # of the acceleration at the tilt limit: what each vehicle plans to brake with
ALONE_SHARE = 0.6  # of that, where the own vehicle alone makes way: others may stand behind it
UNSEEN_DELAY_S = 0.1  # transport delay that no receiver can measure without a common clock
# The same and the delay of the own response, before a vehicle that flies towards this one. A pilot's vehicle reports no
# acceleration: it may have reached 1.6 m/s in the 0.4 s before others make way.
PURSUED_S = 0.4
RIPPLE_M = 0.05  # of the distance of a vehicle that slides along one that makes no way
RESPONSE_1_S = 5.0  # k: how fast h may approach 0
SLOPE_1_S = 4.0  # of the approach speed near the required distance
FASTEST_LEAVING_M_S = 1.5  # demanded inside the required distance
# Where slots move: the attitude follows late, and between others a vehicle cannot always brake as planned.
TRACKING_M = 0.1
LARGEST_ERROR = 1.0  # of separation_m: more than both positions' errors count for; slots are 3 to 6 errors apart
SLOT_SHARE = 0.5  # of the room between separation_m and the distance of two slots: the most that margins may take
PASSING_M = 0.15  # of the distance of two vehicles that pass each other on the way to their slots
PLACED_WITHIN_M = 0.5  # nearer than that to the offset of their slots, two vehicles do not pass each other
GROWTH_M_S = 0.25  # of the required distance from a silent vehicle
LARGEST_GROWTH = 0.5  # of separation_m
FASTEST = 1.25  # of the speed limit: faster no vehicle is taken to fly in silence
LEAST_DISTANCE_M = 1e-6
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
    """The half-space of one other vehicle, and the offset of this vehicle from it.

    `room_m` is how much farther away it is than required, as both will be after their lag. `bare` is what is left of `space`
    without the margins for position errors and silence: `space` gives way to obstacles and the fence then, `bare` does not.
    `below`: this vehicle is below a silent one that may land.
    """

    space: HalfSpace
    other: Other
    offset_enu_m: Vector3
    required_m: float
    room_m: float
    bare: HalfSpace | None = None
    below: bool = False


class Separation:
    """One barrier for each vehicle nearby."""

    def __init__(self, settings: SeparationSettings) -> None:
        self._separation_m = settings.separation_m
        self._braking_alone_m_s2 = ALONE_SHARE * settings.braking_m_s2
        self._braking_together_m_s2 = 2.0 * settings.braking_m_s2
        self._braking_m_s2 = settings.braking_m_s2
        self._largest_error_m = LARGEST_ERROR * settings.separation_m
        # A vehicle that is silent for longer than its attitude is kept counts as silent, also where older states are fresh.
        begins_s = min(settings.fresh_s, KEPT_S)
        self._others = Others(settings.own_id, Silence(begins_s, 0.0, KEPT_S, FASTEST * settings.max_speed_m_s))

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        ahead: Ahead,
        slot: FlownSlot,
        in_formation: bool,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
        traffic: Mapping[str, ReceivedTraffic],
    ) -> list[Barrier]:
        """`peers` are the newest packets of any age, `fresh` those in time. `in_formation`: peers expect a share."""
        position_enu_m, velocity_enu_m_s = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        others = self._others.step(now_s, position_enu_m, velocity_enu_m_s, in_formation, peers, fresh, traffic)
        error = vehicle.position_error or NO_ERROR
        barriers = [self._barrier(ahead, error, slot, other) for other in others]
        if len(fresh) < len(peers):
            below = (self._below(ahead, error, slot, other, other.silence) for other in others if other.silence)
            barriers += [barrier for barrier in below if barrier is not None]
        return barriers

    def _barrier(self, ahead: Ahead, error: PositionError, slot: FlownSlot, other: Other) -> Barrier:
        """The half-space n . u >= a that keeps h' >= -k h, in coordinates whose height is weighted."""
        (x, y, z), (wx, wy, wz) = ahead.position_enu_m, ahead.velocity_enu_m_s
        (px, py, pz), (vx, vy, vz) = other.position_enu_m, other.velocity_enu_m_s
        ax, ay, az = other.acceleration_enu_m_s2
        age_s, weight, slot_of_other = other.age_s, other.height_weight, other.slot
        ahead_s = age_s + LAG_S
        if other.silence is not None:
            (px, py, pz), (vx, vy, vz), (ax, ay, az) = self._nearest_on_way(ahead, other, other.silence)
            ahead_s = 0.0
        wx, wy, wz = wx - vx - ax * ahead_s, wy - vy - ay * ahead_s, (wz - vz - az * ahead_s) * weight
        rx, ry, rz = x - px - vx * ahead_s, y - py - vy * ahead_s, z - pz - vz * ahead_s
        sz = rz * weight
        apart_m = sqrt(rx * rx + ry * ry + sz * sz)
        if apart_m > LEAST_DISTANCE_M:
            nx, ny, nz = rx / apart_m, ry / apart_m, sz / apart_m
        else:  # both at the same position: each flies to its own side
            nx, ny, nz = other.side, 0.0, 0.0
        closing_m_s = -(nx * wx + ny * wy + nz * wz)
        across_m_s2 = (wx * wx + wy * wy + wz * wz - closing_m_s * closing_m_s) / (apart_m + NEAREST_M)
        mz = nz * weight
        offset_enu_m = (rx, ry, rz)
        required_m = self._required(error, slot, other, offset_enu_m, mz)
        late_m = UNSEEN_DELAY_S * closing_m_s if closing_m_s > 0.0 else 0.0
        if slot_of_other is None:  # its late packet hides how far a pursuer has come, also where it closes no more
            braking_m_s2 = self._braking_alone_m_s2
            margin_m = required_m - self._separation_m
            late_m = max(late_m, PURSUED_S * (nx * vx + ny * vy + nz * vz * weight)) + RIPPLE_M + TRACKING_M
        else:
            braking_m_s2 = self._braking_together_m_s2
        # p of a pair that turns about each other lags inside q; a closing vehicle is nearer than its late packet reports.
        required_m += TURNING_S2 * across_m_s2 + late_m
        room_m = apart_m - required_m
        size = sqrt(nx * nx + ny * ny + mz * mz)  # of the gradient: at most 1
        braking_m_s2 *= size
        allowed_m_s, slope_1_s = approach_speed(room_m, braking_m_s2, SLOPE_1_S)
        if allowed_m_s < -FASTEST_LEAVING_M_S:
            allowed_m_s, slope_1_s = -FASTEST_LEAVING_M_S, 0.0
        least_m_s2 = RESPONSE_1_S * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s - across_m_s2
        towards_m_s2 = nx * ax + ny * ay + mz * az
        own_m_s2 = least_m_s2 + towards_m_s2
        if slot_of_other is not None:
            if own_m_s2 < 0.5 * least_m_s2:
                own_m_s2 = 0.5 * least_m_s2
        elif margin_m > 0.0:
            bare_m_s2 = _least_m_s2(room_m + margin_m, closing_m_s, braking_m_s2) - across_m_s2 + towards_m_s2
            nx, ny, mz = nx / size, ny / size, mz / size
            bare = (nx, ny, mz, bare_m_s2 / size, VEHICLE)
            return Barrier((nx, ny, mz, own_m_s2 / size, MARGIN), other, offset_enu_m, required_m, room_m, bare)
        space = (nx / size, ny / size, mz / size, own_m_s2 / size, VEHICLE)
        return Barrier(space, other, offset_enu_m, required_m, room_m)

    def _below(
        self, ahead: Ahead, error: PositionError, slot: FlownSlot, other: Other, silence: Silence
    ) -> Barrier | None:
        """The half-space that keeps a horizontal distance below a silent vehicle, which may land."""
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
        room_m = apart_m - required_m
        least_m_s2 = _least_m_s2(room_m, closing_m_s, self._braking_alone_m_s2) + nx * ax + ny * ay
        least_m_s2 -= across_m_s * across_m_s / (apart_m + NEAREST_M)
        space = (nx, ny, 0.0, least_m_s2, MARGIN)
        return Barrier(space, other, (rx, ry, rz), required_m, room_m, below=True)

    def _nearest_on_way(self, ahead: Ahead, other: Other, silence: Silence) -> Motion:
        last = other.position_enu_m, other.velocity_enu_m_s, other.acceleration_enu_m_s2
        return nearest_on_way(ahead, last, other.age_s, LAG_S, silence, self._braking_m_s2, other.height_weight)

    def _required(
        self, own: PositionError, slot: FlownSlot, other: Other, offset_enu_m: Vector3, upward: float
    ) -> float:
        """separation_m, both position errors along the line between the vehicles, and growth while the other is silent.

        One packet may report any error, so no more than LARGEST_ERROR counts; only that of traffic has a bound of its own.
        Less where two slots are so near that these margins would push the formation apart. Slots nearer than separation_m
        cross each other: the less these can be flown, the more margins count. Vehicles that are not placed as their slots pass
        each other on the way there: they get room for it. `offset_enu_m`: from the other vehicle to this one.
        """
        separation_m, error = self._separation_m, other.error
        level_m = hypot(own.horizontal_m, error.horizontal_m)
        height_m = hypot(own.vertical_m, error.vertical_m) * abs(upward)
        margin_m = level_m + height_m  # one standard deviation
        if margin_m > self._largest_error_m:
            most_m = self._largest_error_m
            if isinstance(other.key, str):
                most_m += error.horizontal_m + error.vertical_m * abs(upward)
            margin_m = min(margin_m, most_m)
        if other.silence is not None:
            silent_s = max(0.0, other.age_s - other.silence.kept_s)
            margin_m += min(silent_s * GROWTH_M_S, LARGEST_GROWTH * separation_m)
        required_m = separation_m + margin_m
        if other.slot is None:
            return required_m
        (x, y, z), (ox, oy, oz), (rx, ry, rz) = slot.position_enu_m, other.slot.position_enu_m, offset_enu_m
        weight = other.height_weight
        dx, dy, dz = x - ox, y - oy, z - oz
        ex, ey, ez = rx - dx, ry - dy, (rz - dz) * weight
        dz *= weight
        if slot.moves_for_s > 0.0 or other.slot.moves_for_s > 0.0:
            required_m += TRACKING_M
        room_m = SLOT_SHARE * abs(sqrt(dx * dx + dy * dy + dz * dz) - separation_m)
        if ex * ex + ey * ey + ez * ez > PLACED_WITHIN_M * PLACED_WITHIN_M:
            passing_m = SLOT_SHARE * (sqrt(ex * ex + ey * ey + ez * ez) - PLACED_WITHIN_M)
            required_m += passing_m if passing_m < PASSING_M else PASSING_M
            room_m = max(room_m, passing_m)
        most_m = separation_m + room_m
        return required_m if required_m < most_m else most_m


def _least_m_s2(room_m: float, closing_m_s: float, braking_m_s2: float) -> float:
    """Least acceleration of the pair away from each other, along the line between them."""
    allowed_m_s, slope_1_s = approach_speed(room_m, braking_m_s2, SLOPE_1_S)
    if allowed_m_s < -FASTEST_LEAVING_M_S:
        allowed_m_s, slope_1_s = -FASTEST_LEAVING_M_S, 0.0
    return RESPONSE_1_S * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s


def nearest_vehicle(now_s: float, vehicle: VehicleState, barriers: list[Barrier]) -> NearestVehicle | None:
    """The vehicle with the least room, with its present distance by its last packet."""
    if not barriers:
        return None
    least = barriers[0]
    for barrier in barriers:
        if barrier.room_m < least.room_m and not barrier.below:
            least = barrier
    return NearestVehicle(str(least.other.key), distance_m(now_s, vehicle, least.other), least.required_m)


def distance_m(now_s: float, vehicle: VehicleState, other: Other) -> float:
    """The present distance from a vehicle by its last packet, in the metric of `separation_m`."""
    old_s = now_s - vehicle.position_time_s
    (x, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
    (px, py, pz), (wx, wy, wz) = other.position_enu_m, other.velocity_enu_m_s
    age_s = other.age_s if other.silence is None else min(other.age_s, other.silence.kept_s)
    dx, dy = x + vx * old_s - px - wx * age_s, y + vy * old_s - py - wy * age_s
    dz = (z + vz * old_s - pz - wz * age_s) * other.height_weight
    return sqrt(dx * dx + dy * dy + dz * dz)


TURN = 0.8  # sideways acceleration for each m/s^2 that a half-space takes from the wanted one
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
        nx, ny, nz, least, _ = barrier.space
        along = nx * x + ny * y + nz * z
        taken = (least if least < 0.0 else 0.0) - along  # of what is wanted towards the other vehicle
        if taken <= 0.0:
            continue
        if barrier.other.slot is None:
            k1, k2 = gains.position_1_s2, gains.velocity_1_s
            rx, ry, _ = barrier.offset_enu_m
            other_x, other_y, _ = barrier.other.velocity_enu_m_s
            goal_m = hypot((x + k2 * vx) / k1 + rx, (y + k2 * vy) / k1 + ry)
            leaves = hypot(other_x, other_y) / PASSING_M_S
            taken *= min(max(2.0 * (goal_m / barrier.required_m - OCCUPIED), leaves, 0.0), 1.0)
            if (vy - other_y) * nx - (vx - other_x) * ny < -DRIFTING_M_S:  # already passing on the other side
                taken = -taken
        right_x, right_y = right_x - TURN * taken * ny, right_y + TURN * taken * nx
    size = hypot(right_x, right_y)
    scale = LARGEST_TURN_M_S2 / size if size > LARGEST_TURN_M_S2 else 1.0
    return (right_x * scale, right_y * scale)
