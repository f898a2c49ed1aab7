"""Where this vehicle and those near it are, ahead by their attitude lag, for checks that must act in time.

A vehicle follows its commanded acceleration u with a lag T: a' = (u - a)/T. With q = p + T v and w = v + T a it is an exact
double integrator, q' = w and w' = u, and p and v follow q and w by a low pass of T. What holds for q and w at all times thus
holds for p and v.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist, exp, hypot, inf, sqrt

from msgspec import Struct
from msgspec.structs import replace

from companion.core.autopilot import LAG_S
from companion.core.consensus.peers import PeerState
from companion.core.filter.solver import MARGIN, VEHICLE, Rank
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.geometry.vectors import shortened
from companion.types.autopilot import PositionError, VehicleState
from companion.types.flight import STREAMING, FlightPhase
from companion.types.formation import FlownSlot
from companion.types.peers import FORGOTTEN_S, PeerPacket, ReceivedTraffic, TrafficSample
from companion.types.values import ZERO3, Vector3


class Ahead(Struct, frozen=True, gc=False):
    """q and w of the fleet frame."""

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3


KEPT_S = 1.0  # an autopilot without setpoints keeps its attitude for so long
# Decay of the speed of a level multirotor: drag of a small open quadrotor, less than most (analysis/pace.py).
COAST_1_S = 0.25
LEAST_M2_S3 = 1e-9  # a vehicle that slows down by less, times its speed, stands: the square of its speed may be 0
GROWS_S = 0.4  # in this time the region of a silent vehicle grows from the expected position to all its way
DESCENT_M_S = 1.5  # speed of an autopilot landing: PX4 MPC_Z_V_AUTO_DN, more than its MPC_LAND_SPEED of 0.7
KNOWS_S = 0.2  # from the split on; packets are late, and the attitude lags
LANDS_S = 0.6  # PX4's smallest COM_OF_LOSS_T that the audit accepts (SHORTEST_TIMEOUT_S)
AUTOPILOT_BRAKES_M_S2 = 5.0  # a hold or a stick that is let go: PX4 MPC_ACC_HOR_MAX
PILOT_LEAPS_M = 0.2  # 0.3 s of 4 m/s^2: until others have heard of it and tilt themselves
SPEED_MARGIN_RATIO = 1.25  # a silent vehicle is assumed to fly at most this times the speed limit
COLUMN_M_S = 1.0  # growth of the distance that a vehicle below keeps

Motion = tuple[Vector3, Vector3, Vector3]
"""Position, velocity and acceleration."""


class Silence(Struct, frozen=True, gc=False):
    """From which age of its last state on a vehicle counts as silent, and how it may fly then.

    It brakes after `brakes_s` at the earliest, by at most `braking_m_s2`, and keeps its attitude until `kept_s`. It flies
    `most_m_s` at most: one packet may report any velocity. `lands`: it may do so. It may come nearer by `leaps_m` before the
    others answer.

    An agent that fails levels and requests a hold before it falls silent. An autopilot without setpoints keeps the last
    attitude for about 1 s (PX4 COM_OF_LOSS_T, ArduCopter GUID_TIMEOUT). PX4 then brakes to a hold or lands (COM_OBL_RC_ACT);
    ArduCopter levels, and only drag slows it down. No other vehicle knows which of these a silent one does, so all of the way
    counts.
    """

    begins_s: float
    brakes_s: float
    kept_s: float
    braking_m_s2: float
    most_m_s: float = inf
    coasts: bool = True
    lands: bool = True
    leaps_m: float = 0.0


def nearest_on_way(own: Ahead, last: Motion, age_s: float, ahead_s: float, silence: Silence, weight: float) -> Motion:
    """The point nearest to this vehicle of all where a silent one may be `ahead_s` from now, and how that point moves.

    `last` is `age_s` old. The way is a straight line from where the vehicle brakes at once to where it coasts; behind a split
    from where it brakes when it knows to where it brakes a little later. It grows from the expected position within GROWS_S, so
    nothing jumps. Between its ends the point follows this vehicle along the way. `weight` is that of heights.
    """
    at_s, most_m_s = age_s + ahead_s, silence.most_m_s
    plausible = (last[0], shortened(last[1], most_m_s), last[2])
    if silence.coasts:
        braked = braking(plausible, at_s, silence.brakes_s, silence.braking_m_s2)
        began = _levelled(plausible) if silence.begins_s > 0.0 else plausible  # what is heard shows its attitude
        coasted = _coasting(began, at_s, silence.kept_s, most_m_s)
    else:
        knows, after_s = _ahead_at(plausible, silence.brakes_s, ahead_s), age_s - silence.brakes_s
        braked = braking(knows, after_s, 0.0, silence.braking_m_s2)
        coasted = braking(knows, after_s, silence.kept_s - silence.brakes_s, silence.braking_m_s2)
    part = (age_s - silence.begins_s) / GROWS_S
    if part < 1.0:
        expected = _expected(last, silence.begins_s + ahead_s, age_s - silence.begins_s)
        braked, coasted = _grown(expected, braked, part), _grown(expected, coasted, part)
    (x, y, z), (px, py, pz), (qx, qy, qz) = own.position_enu_m, braked[0], coasted[0]
    dx, dy, dz = qx - px, qy - py, (qz - pz) * weight
    length2_m2 = dx * dx + dy * dy + dz * dz
    share = ((x - px) * dx + (y - py) * dy + (z - pz) * weight * dz) / length2_m2 if length2_m2 > 0.0 else 0.0
    if share <= 0.0:
        return braked
    if share >= 1.0:
        return coasted
    position_enu_m, (vx, vy, vz), acceleration_enu_m_s2 = _between(braked, coasted, share)
    wx, wy, wz = own.velocity_enu_m_s
    follows_1_s = ((wx - vx) * dx + (wy - vy) * dy + (wz - vz) * weight * dz) / length2_m2
    vx, vy, vz = vx + follows_1_s * (qx - px), vy + follows_1_s * (qy - py), vz + follows_1_s * (qz - pz)
    return position_enu_m, (vx, vy, vz), acceleration_enu_m_s2


def column_m(required_m: float, above_m: float, silent_s: float, weight: float) -> tuple[float, float]:
    """(horizontal distance to keep below a vehicle that may land, its growth in m/s).

    It has been silent for `silent_s` longer than an autopilot keeps its attitude, and was last `above_m` above this one. It
    may be at any height that a landing reaches by now.
    """
    growing_m = COLUMN_M_S * silent_s
    left_m = above_m - DESCENT_M_S * (silent_s + KEPT_S - LANDS_S)
    below_m, below_m_s = (required_m - left_m * weight, DESCENT_M_S * weight) if left_m > 0.0 else (required_m, 0.0)
    return (growing_m, COLUMN_M_S) if growing_m < below_m else (below_m, below_m_s)


def _expected(last: Motion, at_s: float, after_s: float) -> Motion:
    """As a fresh vehicle is extrapolated up to `at_s`, and `after_s` straight on."""
    (x, y, z), (vx, vy, vz), (ax, ay, az) = last
    wx, wy, wz = vx + ax * at_s, vy + ay * at_s, vz + az * at_s
    there_enu_m = (x + vx * at_s + wx * after_s, y + vy * at_s + wy * after_s, z + vz * at_s + wz * after_s)
    return there_enu_m, (wx, wy, wz), last[2]


def _ahead_at(last: Motion, at_s: float, ahead_s: float) -> Motion:
    """The motion after this time with the same acceleration, ahead by the lag as `Motions.own` takes it."""
    (x, y, z), (vx, vy, vz), (ax, ay, az) = last
    x, y, z = x + at_s * (vx + 0.5 * at_s * ax), y + at_s * (vy + 0.5 * at_s * ay), z + at_s * (vz + 0.5 * at_s * az)
    vx, vy, vz = vx + at_s * ax, vy + at_s * ay, vz + at_s * az
    return (
        (x + ahead_s * vx, y + ahead_s * vy, z + ahead_s * vz),
        (vx + ahead_s * ax, vy + ahead_s * ay, vz + ahead_s * az),
        last[2],
    )


def braking(last: Motion, at_s: float, brakes_s: float, braking_m_s2: float) -> Motion:
    """Straight on, then braking to a stop."""
    (x, y, z), (vx, vy, vz), _ = last
    speed_m_s = sqrt(vx * vx + vy * vy + vz * vz)
    if speed_m_s == 0.0:
        return last[0], ZERO3, ZERO3
    stop_s, braking_s = speed_m_s / braking_m_s2, at_s - brakes_s
    stopped = braking_s >= stop_s
    if stopped:
        braking_s = stop_s
    elif braking_s < 0.0:
        brakes_s, braking_s = at_s, 0.0
    # Times at the first velocity, and shares of it.
    gone_s = brakes_s + braking_s - 0.5 * braking_s * braking_s / stop_s
    left = 0.0 if stopped else 1.0 - braking_s / stop_s
    slows_1_s = 0.0 if stopped else -1.0 / stop_s
    return (
        (x + gone_s * vx, y + gone_s * vy, z + gone_s * vz),
        (left * vx, left * vy, left * vz),
        (slows_1_s * vx, slows_1_s * vy, slows_1_s * vz),
    )


def _levelled(last: Motion) -> Motion:
    """The same without what slows it down: an autopilot whose setpoints ended may have levelled since."""
    there_enu_m, (vx, vy, vz), (ax, ay, az) = last
    if (along := ax * vx + ay * vy) < -LEAST_M2_S3:
        slows_1_s = along / (vx * vx + vy * vy)
        ax, ay = ax - slows_1_s * vx, ay - slows_1_s * vy
    return there_enu_m, (vx, vy, vz), (ax, ay, az)


def _coasting(last: Motion, at_s: float, kept_s: float, most_m_s: float) -> Motion:
    """The attitude is kept, then level; heights are held then."""
    (x, y, z), (vx, vy, vz), (ax, ay, _) = last
    keeps_s = min(at_s, kept_s)
    added_s2 = 0.5 * keeps_s * keeps_s
    there_enu_m = (x + keeps_s * vx + added_s2 * ax, y + keeps_s * vy + added_s2 * ay, z + keeps_s * vz)
    vx, vy = vx + keeps_s * ax, vy + keeps_s * ay
    if at_s <= kept_s:
        return there_enu_m, (vx, vy, vz), (ax, ay, 0.0)
    speed_m_s = hypot(vx, vy)
    if speed_m_s > most_m_s:
        vx, vy = vx * most_m_s / speed_m_s, vy * most_m_s / speed_m_s
    left = exp(-COAST_1_S * (at_s - kept_s))
    reach_s = (1.0 - left) / COAST_1_S
    x, y, z = there_enu_m
    slows_1_s = -COAST_1_S * left
    return (x + reach_s * vx, y + reach_s * vy, z), (left * vx, left * vy, 0.0), (slows_1_s * vx, slows_1_s * vy, 0.0)


def _grown(expected: Motion, end: Motion, part: float) -> Motion:
    """From the expected motion to an end of the way, smoothly."""
    share, rate_1_s = part * part * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part) / GROWS_S
    position_enu_m, (vx, vy, vz), acceleration_enu_m_s2 = _between(expected, end, share)
    (px, py, pz), (qx, qy, qz) = expected[0], end[0]
    moving = (vx + rate_1_s * (qx - px), vy + rate_1_s * (qy - py), vz + rate_1_s * (qz - pz))
    return position_enu_m, moving, acceleration_enu_m_s2


def _between(one: Motion, other: Motion, share: float) -> Motion:
    ((ax, ay, az), (bx, by, bz), (cx, cy, cz)), ((dx, dy, dz), (ex, ey, ez), (fx, fy, fz)) = one, other
    return (
        (ax + share * (dx - ax), ay + share * (dy - ay), az + share * (dz - az)),
        (bx + share * (ex - bx), by + share * (ey - by), bz + share * (ez - bz)),
        (cx + share * (fx - cx), cy + share * (fy - cy), cz + share * (fz - cz)),
    )


FORMATION, OBSERVE = FlightPhase.FORMATION, FlightPhase.OBSERVE
NEAR_M, NEAR_S = 8.0, 3.0  # farther than NEAR_M + NEAR_S * relative speed nothing is computed
TRAFFIC_EXTRAPOLATED_S = 5.0  # an aircraft holds its course
TRAFFIC_SILENCE = Silence(
    TRAFFIC_EXTRAPOLATED_S, TRAFFIC_EXTRAPOLATED_S, TRAFFIC_EXTRAPOLATED_S, AUTOPILOT_BRAKES_M_S2, lands=False
)
NO_ERROR = PositionError(0.0, 0.0)
# A vehicle without GPS may have landed anywhere within its error, up to this: at 0.06 m/s^2 it is there after half a minute.
LARGEST_ON_GROUND_M = 30.0
UNSURE_M = 1.0  # with a larger error it matters less than obstacles and fence: only few of the places are true
ON_GROUND_M = 1.0  # disarmed and no higher than that above the own place of take-off, a vehicle lies on the ground


class Other(Struct, frozen=True, gc=False):
    """Position and velocity `age_s` ago with the acceleration flown by the commands so far (`last`), and what it is.

    `commanded_enu_m_s2` is the last command: what it makes of its share is there before its attitude shows it.

    Under a pilot it is the acceleration that its attitude showed.

    A peer that is not fresh keeps its acceleration: an autopilot without setpoints keeps its attitude at first.
    `silence`: how it may fly where its state is too old, else None.
    `slot` is None for a vehicle that does not cooperate with this one; one that `makes_way` may still keep off by itself.
    `side` is the sign of its number compared with the own one. `rank`: of its constraint without margins.
    """

    key: int | str
    last: Motion
    commanded_enu_m_s2: Vector3
    age_s: float
    silence: Silence | None
    error: PositionError
    height_weight: float
    slot: FlownSlot | None
    makes_way: bool
    side: float
    rank: Rank = VEHICLE


class Motions:
    """Where this vehicle and those near it are. Holds the lagged accelerations that they fly by their commands."""

    def __init__(self, own_id: int, silence: Silence) -> None:
        self._own_id = own_id
        self._silence = silence  # how a silent peer may fly
        self._silence_on_ground = replace(silence, lands=False)
        # A vehicle that is leaving formation, in hold, landing or under a pilot: no command says what it flies next.
        self._on_its_own = Silence(-inf, 0.0, KEPT_S, AUTOPILOT_BRAKES_M_S2, silence.most_m_s, lands=False)
        self._piloted = replace(self._on_its_own, leaps_m=PILOT_LEAPS_M)
        # Behind a split network, where it brakes as soon as it knows: as this one does, and not before.
        known_s = silence.begins_s
        self._waiting = replace(silence, brakes_s=known_s, kept_s=known_s + KNOWS_S, coasts=False, lands=False)
        # Of one whose positions and velocities contradict each other only the position is used.
        self._in_doubt = replace(silence, begins_s=-inf, lands=False)
        self._own_enu_m_s2 = ZERO3
        self._own_s: float | None = None
        self._lagged_enu_m_s2: dict[int, Vector3] = {}
        self._peers_s = -inf

    def own(self, now_s: float, vehicle: VehicleState, commanded_enu_m_s2: Vector3) -> Ahead:
        """This vehicle ahead by its attitude lag. `commanded_enu_m_s2` is the command of the last tick."""
        elapsed_s = now_s - self._own_s if self._own_s is not None else 0.0
        self._own_s = now_s
        share = elapsed_s / (LAG_S + elapsed_s) if elapsed_s > 0.0 else 0.0
        (ax, ay, az), (ux, uy, uz) = self._own_enu_m_s2, commanded_enu_m_s2
        ax, ay, az = ax + share * (ux - ax), ay + share * (uy - ay), az + share * (uz - az)
        self._own_enu_m_s2 = (ax, ay, az)
        (x, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        ahead_s = now_s - vehicle.position_time_s + LAG_S
        return Ahead(
            (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s),
            (vx + ax * ahead_s, vy + ay * ahead_s, vz + az * ahead_s),
        )

    def peers(
        self,
        now_s: float,
        vehicle: VehicleState,
        cooperates: bool,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
        behind_split: frozenset[int] = frozenset(),
    ) -> list[Other]:
        """The peers nearby. `cooperates`: this vehicle flies in formation, so peers expect its share."""
        elapsed_s, self._peers_s, begins_s = now_s - self._peers_s, now_s, self._silence.begins_s
        lag_share = 1.0 - LAG_S / (LAG_S + elapsed_s)
        (x, y, z), near, before = vehicle.position_enu_m, [], self._lagged_enu_m_s2
        commanded: dict[int, Vector3] = {}
        for peer_id, peer in peers.items():
            packet, age_s = peer.packet, now_s - peer.measured_s
            there_enu_m, moving_enu_m_s = packet.motion.position_enu_m, packet.motion.velocity_enu_m_s
            acceleration = packet.motion.acceleration_enu_m_s2
            is_fresh, error, rank = peer_id in fresh, packet.position_error or NO_ERROR, VEHICLE
            if age_s > FORGOTTEN_S:
                continue
            if not packet.armed:
                follows_s = age_s if age_s <= begins_s and not peer.contradicts else None
                there_enu_m, moving_enu_m_s, error, rank = _nearest_disarmed(vehicle, packet, error, follows_s)
            px, py, pz = there_enu_m
            if abs(x - px) >= NEAR_M or abs(y - py) >= NEAR_M or abs(z - pz) >= NEAR_M:
                reaches_m_s = moving_enu_m_s if is_fresh else _reached_in_silence(moving_enu_m_s, acceleration)
                if not _may_meet(vehicle, there_enu_m, reaches_m_s, age_s):
                    continue
            last, command = before.get(peer_id), acceleration
            if last is not None and is_fresh and packet.phase is not OBSERVE:  # a pilot's is flown, not commanded
                (lx, ly, lz), (ux, uy, uz) = last, acceleration
                acceleration = (lx + lag_share * (ux - lx), ly + lag_share * (uy - ly), lz + lag_share * (uz - lz))
            commanded[peer_id] = acceleration
            silence: Silence | None = None  # it flies by the last command of its packet
            if age_s > begins_s:
                silence = self._silence if packet.armed else self._silence_on_ground
                if peer_id in behind_split:
                    silence = self._waiting
            elif peer.contradicts:
                silence = self._in_doubt
            elif packet.armed and packet.phase not in STREAMING:
                silence = self._piloted if packet.phase is OBSERVE else self._on_its_own
            in_formation = is_fresh and packet.phase is FORMATION
            other = Other(
                peer_id,
                (there_enu_m, moving_enu_m_s, acceleration),
                command,
                age_s,
                silence,
                error,
                HEIGHT_WEIGHT if packet.armed else 1.0,  # no downwash reaches a vehicle on the ground
                packet.slot if cooperates and in_formation else None,
                makes_way=in_formation or peer_id in behind_split,
                side=1.0 if self._own_id < peer_id else -1.0,
                rank=rank,
            )
            near.append(other)
        self._lagged_enu_m_s2 = commanded
        return near


def _nearest_disarmed(
    vehicle: VehicleState, packet: PeerPacket, error: PositionError, follows_s: float | None
) -> tuple[Vector3, Vector3, PositionError, Rank]:
    """(position, velocity, error, rank) of a disarmed vehicle: on the ground, of the place where it may be nearest to this one.

    Its height is known, its place only within the error: this one keeps above it, and need not fly round all of the error.
    Above this circle it moves along with this vehicle: the place of `follows_s` ago, if it will be taken ahead by that time.
    """
    (x, y, _), (vx, vy, _) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
    (px, py, pz), ground_enu_m = packet.motion.position_enu_m, vehicle.ground_position_enu_m
    if ground_enu_m is None or pz >= ground_enu_m[2] + ON_GROUND_M:
        return packet.motion.position_enu_m, packet.motion.velocity_enu_m_s, error, VEHICLE
    rank = MARGIN if error.horizontal_m > UNSURE_M else VEHICLE
    dx, dy = x - px, y - py
    level_m, reach_m = hypot(dx, dy), min(error.horizontal_m, LARGEST_ON_GROUND_M)
    if level_m > reach_m:
        return (px + reach_m / level_m * dx, py + reach_m / level_m * dy, pz), ZERO3, NO_ERROR, rank
    if follows_s is None:
        return (x, y, pz), ZERO3, NO_ERROR, rank
    return (x - follows_s * vx, y - follows_s * vy, pz), (vx, vy, 0.0), NO_ERROR, rank


def traffic_nearby(now_s: float, vehicle: VehicleState, traffic: Mapping[str, ReceivedTraffic]) -> list[Other]:
    """The vehicles outside the fleet that are near this one; those of unknown height as if they were at its own.

    Their heights have no weight: they are avoided to the side, at any height.
    """
    near = []
    for name, one in traffic.items():
        sample, weight = one.sample, HEIGHT_WEIGHT
        age_s = now_s - one.received_s + sample.age_s
        last = (sample.position_enu_m, sample.velocity_enu_m_s, ZERO3)
        if sample.height == "unknown":
            (x, y, _), (vx, vy, _) = sample.position_enu_m, sample.velocity_enu_m_s
            last, weight = ((x, y, vehicle.position_enu_m[2]), (vx, vy, 0.0), ZERO3), 0.0
        if _may_meet(vehicle, *last[:2], age_s):
            error = PositionError(sample.error_m, sample.error_m)
            silence = TRAFFIC_SILENCE if age_s > TRAFFIC_EXTRAPOLATED_S else None
            near.append(Other(name, last, ZERO3, age_s, silence, error, weight, None, makes_way=False, side=1.0))
    return near


def _reached_in_silence(velocity_enu_m_s: Vector3, acceleration_enu_m_s2: Vector3) -> Vector3:
    """The largest speed on each axis of a vehicle that keeps its attitude for a while, and may land."""
    (vx, vy, vz), (ax, ay, _) = velocity_enu_m_s, acceleration_enu_m_s2
    return (abs(vx) + KEPT_S * abs(ax), abs(vy) + KEPT_S * abs(ay), abs(vz) + DESCENT_M_S)


def _may_meet(vehicle: VehicleState, other_m: Vector3, other_m_s: Vector3, age_s: float) -> bool:
    """Whether the two might meet within NEAR_S, or come within NEAR_M."""
    (x, y, z), (px, py, pz) = vehicle.position_enu_m, other_m
    (wx, wy, wz), (vx, vy, vz) = vehicle.velocity_enu_m_s, other_m_s
    dx, dy, dz = abs(x - px), abs(y - py), abs(z - pz)
    reach_m = NEAR_M + NEAR_S * (abs(wx) + abs(wy) + abs(wz)) + (NEAR_S + age_s) * (abs(vx) + abs(vy) + abs(vz))
    return dx < reach_m and dy < reach_m and dz < reach_m


KEPT = 16
EXPIRES_S = 30.0


class Traffic:
    """The newest sample by name. The wire has checked the numbers."""

    def __init__(self) -> None:
        self.newest: dict[str, ReceivedTraffic] = {}

    def step(self, now_s: float, own_enu_m: Vector3, received: Iterable[ReceivedTraffic]) -> None:
        """Take these samples and forget those older than EXPIRES_S."""
        newest = self.newest
        for one in received:
            known = newest.get(one.name)
            if known is None or _measured_s(one) > _measured_s(known):
                newest[one.name] = one
        if not newest:
            return
        for name in [name for name, one in newest.items() if now_s - _measured_s(one) > EXPIRES_S]:
            del newest[name]
        while len(newest) > KEPT:
            del newest[max(newest, key=lambda name: _distance_m(newest[name].sample, own_enu_m))]


def _measured_s(one: ReceivedTraffic) -> float:
    return one.received_s - one.sample.age_s


def _distance_m(sample: TrafficSample, own_enu_m: Vector3) -> float:
    """Horizontal where the height is unknown: it may be above this vehicle."""
    dimensions = 2 if sample.height == "unknown" else 3
    return dist(sample.position_enu_m[:dimensions], own_enu_m[:dimensions])
