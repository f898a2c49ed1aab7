"""RFT that follows a target whose motion is not known in advance, within limits; the samples of targets; and the room left.

The velocity follows the target's velocity plus a pull towards its position (see `approach`): critically damped, and without
lag behind a target of constant velocity. The acceleration changes at a limited rate, so that attitude setpoints do not step.

The limits hold for any motion of the target. A velocity drawn towards another inside the ball of the largest speed stays in
that ball. A step after which the walls of the room could no longer be kept by braking is replaced by such braking; the
step before left room for it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from math import ceil, hypot, isfinite, sqrt

from msgspec import Struct

from companion.core.consensus.peers import MAX_SENT_S
from companion.core.message_order import Disorder, Stream, following
from companion.geometry.airspace import Airspace, Gap
from companion.geometry.vectors import dot, extrapolated, minus, plus, scaled, shortened
from companion.types.formation import FormationState
from companion.types.notices import Code
from companion.types.peers import ReceivedTarget, TargetSample
from companion.types.rejections import count_rejection
from companion.types.values import MAX_COORDINATE_M, ZERO3, Vector3


@dataclass(frozen=True, slots=True)
class TargetLimits:
    """Largest speed and acceleration of the RFT."""

    speed_m_s: float
    acceleration_m_s2: float


class TargetPursuit:
    """RFT state R and r'', advanced towards a moving goal. The initial state must satisfy `can_keep`."""

    def __init__(self, limits: TargetLimits, begin: FormationState) -> None:
        self._limits = limits
        self.state = begin

    def advance(self, seconds: float, goal_enu_m: Vector3 | None, velocity_enu_m_s: Vector3, room: Room) -> None:
        """Advance by this time towards a goal of this velocity. Without a goal only the velocity is followed."""
        seconds = min(seconds, LONGEST_S)
        if seconds <= 0.0:
            return
        steps = ceil(seconds / STEP_S)
        if goal_enu_m is not None:
            goal_enu_m, velocity_enu_m_s = _inside(goal_enu_m, velocity_enu_m_s, room.box)
        for _ in range(steps):
            self.state = _step(self.state, self._limits, goal_enu_m, velocity_enu_m_s, room, seconds / steps)


def can_keep(state: FormationState, limits: TargetLimits, room: Room) -> bool:
    """Whether a pursuit that begins in this state can keep speed and room."""
    slow = hypot(*state.velocity_enu_m_s) <= limits.speed_m_s
    return slow and room.can_stop(state.position_enu_m, state.velocity_enu_m_s, limits.acceleration_m_s2)


def _step(
    state: FormationState,
    limits: TargetLimits,
    goal_enu_m: Vector3 | None,
    velocity_enu_m_s: Vector3,
    room: Room,
    dt_s: float,
) -> FormationState:
    before, v = state.position_enu_m, state.velocity_enu_m_s
    wanted = shortened(_wanted_velocity(before, goal_enu_m, velocity_enu_m_s, limits), limits.speed_m_s)
    wanted = room.kept_away(wanted, before, v, limits.acceleration_m_s2)
    acceleration = shortened(scaled(minus(wanted, v), 1.0 / SETTLE_S), limits.acceleration_m_s2)
    last = shortened(state.acceleration_enu_m_s2, limits.acceleration_m_s2)
    change = shortened(minus(acceleration, last), JERK_1_S * limits.acceleration_m_s2 * dt_s)
    after = shortened(plus(v, scaled(plus(last, change), dt_s)), limits.speed_m_s)
    if not room.can_stop(_moved(before, v, after, dt_s), after, limits.acceleration_m_s2):
        after = shortened(v, max(0.0, hypot(*v) - limits.acceleration_m_s2 * dt_s))
    return FormationState(_moved(before, v, after, dt_s), after, scaled(minus(after, v), 1.0 / dt_s))


def _wanted_velocity(position: Vector3, goal: Vector3 | None, velocity: Vector3, limits: TargetLimits) -> Vector3:
    if goal is None or (distance_m := hypot(*(offset := minus(goal, position)))) == 0.0:
        return velocity
    speed_m_s = approach_speed(distance_m, APPROACH * limits.acceleration_m_s2)
    return plus(velocity, scaled(offset, speed_m_s / distance_m))


def _inside(goal: Vector3, velocity: Vector3, box: Box) -> tuple[Vector3, Vector3]:
    """The nearest position in the box, and the velocity without the part that leaves the box."""
    positions, rates = [], []
    for p, v, low, high in zip(goal, velocity, *box, strict=True):
        outside = (p >= high and v > 0.0) or (p <= low and v < 0.0)
        positions.append(min(max(p, low), high))
        rates.append(0.0 if outside else v)
    (x, y, z), (vx, vy, vz) = positions, rates
    return (x, y, z), (vx, vy, vz)


def _moved(position: Vector3, v: Vector3, after: Vector3, dt_s: float) -> Vector3:
    return plus(position, scaled(plus(v, after), dt_s / 2.0))


CODES = {
    Disorder.TWO_SENDERS: Code.TARGET_NAME_TWICE,
    Disorder.OUT_OF_ORDER: Code.TARGET_OUT_OF_ORDER,
    Disorder.LATE: Code.TARGET_LATE,
    Disorder.TIME: Code.TARGET_TIME_IMPLAUSIBLE,
}
MAX_SPEED_M_S = 100.0
TOO_LATE_S = 1.0  # longest accepted transport delay


class Target(Struct, frozen=True, gc=False):
    """Newest sample of one target, with its times on this vehicle's clock as in `PeerState`."""

    sample: TargetSample
    received_s: float
    least_apart_s: float
    measured_s: float

    def position_at(self, now_s: float) -> Vector3 | None:
        """Position extrapolated over its age; None for a target that reports only a velocity."""
        if self.sample.position_enu_m is None:
            return None
        return extrapolated(self.sample.position_enu_m, self.sample.velocity_enu_m_s, now_s - self.measured_s)


class Targets:
    """Newest sample of each target. Samples are checked for order, plausible numbers and delay.

    `rejected` counts refused samples by code.
    """

    def __init__(self) -> None:
        self._newest: dict[str, Target] = {}
        self._streams: dict[str, Stream] = {}
        self.rejected: Counter[str] = Counter()

    def fold(self, received: Iterable[ReceivedTarget], names: Collection[str]) -> None:
        """Check and take these samples. Samples of targets not in `names` are ignored."""
        for sample in received:
            if sample.name not in names:
                continue
            if code := _refusal(sample.sample) or self._refusal_of_order(sample):
                self.rejected = count_rejection(self.rejected, code)
            else:
                stream = self._streams[sample.name]
                measured_s = sample.received_s - stream.late_s
                self._newest[sample.name] = Target(
                    sample.sample, sample.received_s, stream.clock.least_apart_s, measured_s
                )

    def _refusal_of_order(self, received: ReceivedTarget) -> Code | None:
        sample = received.sample
        stream, disorder = following(
            self._streams.get(received.name),
            sample.session,
            sample.sequence,
            sample.sent_s,
            received.received_s,
            TOO_LATE_S,
        )
        self._streams[received.name] = stream
        return CODES[disorder] if disorder else None

    def newest(self, name: str) -> Target | None:
        """Newest sample of a target, of any age."""
        return self._newest.get(name)


def _refusal(sample: TargetSample) -> Code | None:
    numbers = (*(sample.position_enu_m or ZERO3), *sample.velocity_enu_m_s, sample.sent_s)
    if not all(isfinite(number) for number in numbers):
        return Code.TARGET_NOT_FINITE
    if sample.position_enu_m is not None and max(abs(c) for c in sample.position_enu_m) > MAX_COORDINATE_M:
        return Code.TARGET_POSITION_IMPLAUSIBLE
    if hypot(*sample.velocity_enu_m_s) > MAX_SPEED_M_S:
        return Code.TARGET_SPEED_IMPLAUSIBLE
    return None if 0.0 <= sample.sent_s <= MAX_SENT_S else Code.TARGET_TIME_IMPLAUSIBLE


Box = tuple[Vector3, Vector3]
"""Lowest and highest coordinates, m."""

AXES: tuple[Vector3, Vector3, Vector3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STEP_S = 0.05  # longest step of a pursuit
SHARE = 0.8  # braking may use this share of the distance to a wall
PASSES = 3  # a velocity kept from one wall may lead to another one


@dataclass(frozen=True, slots=True)
class Room:
    """Room for r. `box` is that of r itself, `airspace` that of each slot about r, None where the box is all there is.

    Braking goes straight along the velocity. Each wall is a plane, a side of the fence's polygon or a convex obstacle, so it
    lies behind the plane across its nearest point, and braking that ends before that plane stays clear of it.
    """

    box: Box
    airspace: Airspace | None = None
    slots_enu_m: tuple[Vector3, ...] = ()
    around_m: float = 0.0  # further room about each slot

    def gaps(self, position_enu_m: Vector3, within_m: float) -> list[Gap]:
        """Room of r and of the slots about it to all walls that are nearer than this."""
        found: list[Gap] = []
        for axis, (p, low, high) in enumerate(zip(position_enu_m, *self.box, strict=True)):
            if p - low < within_m:
                found.append((p - low, AXES[axis]))
            if high - p < within_m:
                found.append((high - p, scaled(AXES[axis], -1.0)))
        if self.airspace is None:
            return found
        kept_m = self.airspace.clearance_m + self.around_m
        for slot in self.slots_enu_m:
            walls = self.airspace.walls(plus(position_enu_m, slot), within_m + kept_m)
            found += [(distance_m - kept_m, normal) for distance_m, normal in walls]
        return found

    def can_stop(self, position_enu_m: Vector3, velocity_enu_m_s: Vector3, braking_m_s2: float) -> bool:
        """Whether braking stops before all walls. Half a step is added: the step that stops does not only brake."""
        speed_m_s = hypot(*velocity_enu_m_s)
        lasts_s = speed_m_s / (2.0 * braking_m_s2) + STEP_S / 2.0
        for distance_m, normal in self.gaps(position_enu_m, speed_m_s * lasts_s):
            approach_m_s = -dot(normal, velocity_enu_m_s)
            if approach_m_s > 0.0 and distance_m < approach_m_s * lasts_s:
                return False
        return True

    def kept_away(self, wanted: Vector3, position: Vector3, velocity: Vector3, braking_m_s2: float) -> Vector3:
        """The wanted velocity, without what would approach a wall too fast to brake gently from `velocity`."""
        fastest_m_s, speed_m_s = hypot(*wanted), hypot(*velocity)
        per_room_1_s = min(PULL_1_S, SHARE * braking_m_s2 / max(speed_m_s, STEP_S * braking_m_s2))
        gaps = self.gaps(position, fastest_m_s / per_room_1_s + fastest_m_s**2 / braking_m_s2)
        for _ in range(PASSES):
            for distance_m, normal in gaps:
                gently_m_s = approach_speed(distance_m, APPROACH * braking_m_s2)
                allowed_m_s = min(gently_m_s, max(0.0, per_room_1_s * distance_m))
                if (excess_m_s := -dot(normal, wanted) - allowed_m_s) > 0.0:
                    wanted = plus(wanted, scaled(normal, excess_m_s))
        return wanted


SETTLE_S = 0.4  # time constant of the velocity
PULL_1_S = 1.0 / (4.0 * SETTLE_S)  # approach speed per distance: critically damped
JERK_1_S = 4.0  # change of acceleration per second, relative to the largest acceleration
APPROACH = 0.5  # share of the largest acceleration that is used for braking at the goal
LONGEST_S = 0.5  # after a longer pause the motion continues from where it was


def approach_speed(distance: float, braking: float) -> float:
    """Speed at which a goal at this distance (m or rad) is approached, to stop there with this deceleration.

    Near the goal the pull limits the speed; there it needs less than `braking`. 0 at or beyond the goal.
    """
    straight = braking / PULL_1_S**2
    if distance < straight:
        return PULL_1_S * max(distance, 0.0)
    return sqrt(braking * (2.0 * distance - straight))
