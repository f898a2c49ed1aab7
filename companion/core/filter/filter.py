"""The stage between law and output: the speed limit, then the smallest change that keeps off vehicles, obstacles and fence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import dist, hypot, inf, sqrt

from msgspec import Struct
from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import (
    KEPT_S,
    NO_ERROR,
    SPEED_MARGIN_RATIO,
    Ahead,
    Motions,
    Silence,
    Traffic,
    traffic_nearby,
)
from companion.core.filter.pressure import Pressure
from companion.core.filter.solver import (
    MOST_STEPS,
    AccelerationLimits,
    Constraint,
    Rank,
    filter_acceleration,
    shortfalls,
)
from companion.core.filter.split import Split
from companion.core.filter.vehicles import (
    ALONE_SHARE,
    Barrier,
    Separation,
    SeparationSettings,
    eased,
    largest_removed_m_s2,
    nearest_and_violated,
    turn_right,
)
from companion.geometry.airspace import Airspace, Gap
from companion.geometry.curves import approach_speed
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot, Gains
from companion.types.notices import Code, Notice
from companion.types.peers import ReceivedTraffic
from companion.types.status import SeparationReport
from companion.types.values import Vector3

# Active-set steps where another vehicle presses for long, several are about this one, or the column below a silent one is
# near: they contradict fence, limits and each other. Fewer steps leave one of them out, each time another one.
CONTRADICTED_STEPS = 15
SURROUNDED, SURROUNDED_M = 3, 0.3  # so many vehicles, with no more room than that
NOTHING_SEEN = SeparationReport()
WORSE_M_S2 = 1.0  # a turn may miss the constraints of a rank by so much more
TURN_STEPS = 3  # active-set steps for the second solution, with the turn to the right


class Filtered(Struct, frozen=True, gc=False):
    """The acceleration to fly, the same object as the wanted one where nothing changes it.

    `removed_accel_m_s2`: the most that another vehicle removed from the wanted one, along the line to it.
    """

    acceleration_enu_m_s2: Vector3
    separation: SeparationReport
    removed_accel_m_s2: float = 0.0


class SafetyFilter:
    """Limits the speed, then filters the acceleration by the constraints of vehicles, obstacles and fence."""

    def __init__(self, settings: SeparationSettings, bounds: Bounds, limits: AccelerationLimits, gains: Gains) -> None:
        most_m_s = SPEED_MARGIN_RATIO * settings.max_speed_m_s
        self._motions = Motions(
            settings.own_id, Silence(settings.fresh_s, 0.0, KEPT_S, settings.braking_m_s2, most_m_s)
        )
        self._split = Split(settings.fresh_s, settings.separation_m, settings.braking_m_s2, gains)
        self._behind_split: frozenset[int] = frozenset()  # vehicles by id
        self._separation = Separation(settings)
        self._pressure = Pressure(settings.separation_m)
        self.braking_alone_m_s2 = ALONE_SHARE * settings.braking_m_s2  # as a vehicle behind this one plans to brake
        self._bounds = bounds
        self._limits = limits
        self._gains = gains
        self._traffic = Traffic()
        self.traffic = self._traffic.newest  # live view of the newest traffic by name

    def receive(self, now_s: float, vehicle: VehicleState, traffic: Iterable[ReceivedTraffic]) -> None:
        """Take the traffic of this tick, in every phase."""
        self._traffic.step(now_s, vehicle.position_enu_m, traffic)

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        slot: FlownSlot | None,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
        wanted_enu_m_s2: Vector3,
        flown_enu_m_s2: Vector3,
        disturbance_enu_m_s2: Vector3,
    ) -> Filtered:
        """`slot` is the own one, None outside formation, where peers expect no share.

        `flown_enu_m_s2`: the command of the last tick. `peers`: the newest packets of any age, `fresh`: those in time.
        """
        motions, separation = self._motions, self._separation
        ahead = motions.own(now_s, vehicle, flown_enu_m_s2)
        if len(fresh) < len(peers) or self._behind_split:
            self._behind_split = self._split.step(now_s, vehicle, ahead, slot, peers, fresh)
            if self._behind_split and slot is not None:
                wanted_enu_m_s2 = self._split.acceleration(now_s, ahead)
        others = motions.peers(now_s, vehicle, slot is not None, peers, fresh, self._behind_split)
        if self.traffic:
            others += traffic_nearby(now_s, vehicle, self.traffic)
        error = vehicle.position_error or NO_ERROR
        barriers = []
        for other in others:
            barriers.append(separation.barrier(ahead, error, slot, other))
        if len(fresh) < len(peers):
            barriers += separation.barriers_below(ahead, error, slot, others)
        slowed, speed = self._bounds.limit_speed(ahead, wanted_enu_m_s2)
        # The speed limit is among the constraints, too: what the filter adds must not exceed it.
        bounds = self._bounds.constraints(ahead, vehicle.ground_position_enu_m) + speed
        seen = NOTHING_SEEN
        if barriers:
            nearest, violated = nearest_and_violated(now_s, vehicle, barriers, separation.separation_m)
            seen = SeparationReport(nearest, 0.0, violated)
        return self.allowed(now_s, vehicle, barriers, bounds, wanted_enu_m_s2, slowed, disturbance_enu_m_s2, seen)

    def ahead(self, now_s: float, vehicle: VehicleState, commanded_enu_m_s2: Vector3) -> Ahead:
        """This vehicle ahead by its attitude lag, after this command."""
        return self._motions.own(now_s, vehicle, commanded_enu_m_s2)

    @property
    def is_pressed(self) -> bool:
        """Whether another vehicle has pressed this one for a while: then a tick counts in which nothing is changed, too."""
        return bool(self._pressure.pressing)

    def allowed(
        self,
        now_s: float,
        vehicle: VehicleState,
        barriers: list[Barrier],
        bounds: list[Constraint],
        wanted_enu_m_s2: Vector3,
        slowed_enu_m_s2: Vector3,
        disturbance_enu_m_s2: Vector3,
        seen: SeparationReport,
    ) -> Filtered:
        """What these barriers and bounds leave of the acceleration.

        `slowed_enu_m_s2` is the wanted one within the speed limits. Barriers below come last. `seen`: what else is reported.
        """
        pressure, acting = self._pressure, barriers
        steps, turn_steps = MOST_STEPS, TURN_STEPS
        tight = 0
        for barrier in barriers:
            if barrier.margin_m < SURROUNDED_M:
                tight += 1
        if tight >= SURROUNDED or (barriers and barriers[-1].below):
            steps = turn_steps = CONTRADICTED_STEPS
        if pressure.pressing and pressure.lasts:
            acting, steps = pressure.bounded(barriers), CONTRADICTED_STEPS
        constraints, without_margins = [], []
        for barrier in acting:
            constraints.append(barrier.constraint)
            if barrier.constraint_without_margins is not None:
                without_margins.append(barrier.constraint_without_margins)
        constraints += without_margins
        constraints += bounds
        limits = replace(self._limits, disturbance_enu_m_s2=disturbance_enu_m_s2)
        eased_enu_m_s2 = eased(slowed_enu_m_s2, acting) if barriers else slowed_enu_m_s2
        allowed = filter_acceleration(eased_enu_m_s2, constraints, limits, steps)
        if allowed is wanted_enu_m_s2 and not pressure.pressing:
            return Filtered(allowed, seen)
        removed_m_s2 = 0.0
        if barriers:
            removed_m_s2 = largest_removed_m_s2(slowed_enu_m_s2, acting)
            turned_from = [barrier for barrier in acting if barrier.constraint[4] is not UNSHAKEN]
            turn_x, turn_y = turn_right(slowed_enu_m_s2, vehicle.velocity_enu_m_s, self._gains, turned_from)
            if turn_x or turn_y:
                x, y, z = allowed
                turned = filter_acceleration((x + turn_x, y + turn_y, z), constraints, limits, turn_steps)
                allowed = better_kept(turned, allowed, constraints)
        pressure.step(now_s, vehicle, barriers, constraints, allowed)
        report = SeparationReport(seen.nearest, dist(allowed, wanted_enu_m_s2), seen.violated, pressure.unshaken)
        return Filtered(allowed, report, removed_m_s2)


def better_kept(turned: Vector3, allowed: Vector3, constraints: Sequence[Constraint]) -> Vector3:
    """The turned acceleration, unless it misses the constraints of a rank by far more: few steps solved it."""
    for after, before in zip(shortfalls(turned, constraints), shortfalls(allowed, constraints), strict=True):
        if after > before + WORSE_M_S2:
            return allowed
        if after < before - WORSE_M_S2:
            break
    return turned


GROUND, OBSTACLE, FENCE, SPEED, UNSHAKEN = Rank.GROUND, Rank.OBSTACLE, Rank.FENCE, Rank.SPEED, Rank.UNSHAKEN
UP = (0.0, 0.0, 1.0)
FLOOR_M = 0.5  # above the ground where the vehicle took off
BOUNDARY_RESPONSE_1_S = 4.0  # k: how fast b may approach 0; 1/k is longer than the attitude lag
SLOPE_1_S = 2.0  # approach speed per metre near the boundary
FASTEST_RETURN_M_S = 1.0  # largest speed back that is demanded beyond the boundary
# Twice gravity: no acceleration is larger, so a constraint that allows all up to this cannot matter.
NEVER_WANTED_M_S2 = 20.0
SPEED_RESPONSE_1_S = 2.0  # k of the speed limit; about PX4's MPC_XY_VEL_P_ACC, 1.8
STILL_M_S = 0.1  # below this speed its direction means nothing


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """Largest speeds: horizontal, upwards and downwards."""

    level_m_s: float
    climb_m_s: float
    descent_m_s: float


class Bounds:
    """Constraints by the fence, static obstacles and the speed limits.

    A control barrier function of a double integrator (Ames et al., "Control Barrier Functions: Theory and Applications", ECC
    2019) for each wall and obstacle: with the distance h that is left and its rate h', b = h' + V(h) >= 0 means that the
    vehicle can still stop, where V is `approach_speed`. b' >= -k b is linear in the acceleration. Distances to convex bodies
    are convex in time, so moving past one only adds distance.

    As in PX4's `PositionControl`, velocity is limited before acceleration, and acceleration before tilt and thrust. Here the
    law gives an acceleration, so the limit is u . v/|v| <= k (most - |v|): the speed approaches the limit and does not exceed
    it. All are evaluated for the state that the attitude lag leads to (`motion.py`).
    """

    def __init__(
        self, airspace: Airspace, speed: SpeedLimit, level_m_s2: float, vertical_m_s2: float, takeoff_height_m: float
    ) -> None:
        """`level_m_s2` and `vertical_m_s2` are the decelerations that the vehicle plans to brake with.

        The floor is FLOOR_M above the ground, or half of `takeoff_height_m` where that is less.
        """
        self._floor_m = min(FLOOR_M, 0.5 * takeoff_height_m) - airspace.clearance_m  # `_constraint` keeps the clearance
        self._airspace = airspace
        self._speed = speed
        self._level_m_s2 = level_m_s2
        self._vertical_m_s2 = vertical_m_s2
        self._least_m_s2 = min(level_m_s2, vertical_m_s2)
        self._reach_at_rest_m = airspace.clearance_m + self._least_m_s2 / SLOPE_1_S**2

    def limit_speed(self, ahead: Ahead, wanted_enu_m_s2: Vector3) -> tuple[Vector3, list[Constraint]]:
        """The acceleration without what would exceed a speed limit, the same object where there is nothing of it; and the
        constraints of the vertical and of the horizontal speed. Their normals are perpendicular to each other.
        """
        (vx, vy, vz), speed = ahead.velocity_enu_m_s, self._speed
        if vz > 0.0:
            constraints: list[Constraint] = [(0.0, 0.0, -1.0, -SPEED_RESPONSE_1_S * (speed.climb_m_s - vz), SPEED)]
        else:
            constraints = [(0.0, 0.0, 1.0, -SPEED_RESPONSE_1_S * (speed.descent_m_s + vz), SPEED)]
        level_m_s = hypot(vx, vy)
        if level_m_s > STILL_M_S:
            least_m_s2 = -SPEED_RESPONSE_1_S * (speed.level_m_s - level_m_s)
            constraints.append((-vx / level_m_s, -vy / level_m_s, 0.0, least_m_s2, SPEED))
        allowed = wanted_enu_m_s2
        for constraint in constraints:
            (nx, ny, nz, least, _), (ux, uy, uz) = constraint, allowed
            short = least - (nx * ux + ny * uy + nz * uz)
            if short > 0.0:
                allowed = (ux + short * nx, uy + short * ny, uz + short * nz)
        return allowed, constraints

    def constraints(self, ahead: Ahead, ground_enu_m: Vector3 | None) -> list[Constraint]:
        """Constraints of the ground, all obstacles and walls of the fence that may matter in this state.

        `ground_enu_m`: where the vehicle took off; None where this agent has not seen it.

        Farther than `reach_m` nothing limits an acceleration: V(h) is above the speed by NEVER_WANTED_M_S2 / k.
        """
        position_enu_m, (vx, vy, vz) = ahead.position_enu_m, ahead.velocity_enu_m_s
        speed_m_s = sqrt(vx * vx + vy * vy + vz * vz) + NEVER_WANTED_M_S2 / BOUNDARY_RESPONSE_1_S
        reach_m = self._reach_at_rest_m + speed_m_s * speed_m_s / (2.0 * self._least_m_s2)
        near = []
        for obstacle in self._airspace.obstacles:
            if (gap := obstacle.gap(position_enu_m))[0] < reach_m:
                near.append(self._constraint(gap, ahead, OBSTACLE))
        if ground_enu_m is not None:
            above_m = position_enu_m[2] - ground_enu_m[2] - self._floor_m
            if above_m < reach_m:
                near.append(self._constraint((above_m, UP), ahead, GROUND))
        for gap in self._airspace.fence.gaps(position_enu_m, reach_m):
            near.append(self._constraint(gap, ahead, FENCE))
        return near

    def _constraint(self, gap: Gap, ahead: Ahead, rank: Rank) -> Constraint:
        distance_m, (nx, ny, nz) = gap
        vx, vy, vz = ahead.velocity_enu_m_s
        rate_m_s = nx * vx + ny * vy + nz * vz
        braking_m_s2 = self._least_m_s2
        if nz == 0.0:
            braking_m_s2 = self._level_m_s2
        elif abs(nz) == 1.0:
            braking_m_s2 = self._vertical_m_s2
        left_m = distance_m - self._airspace.clearance_m
        speed_m_s, slope_1_s = approach_speed(left_m, braking_m_s2, SLOPE_1_S, FASTEST_RETURN_M_S)
        least = -BOUNDARY_RESPONSE_1_S * (rate_m_s + speed_m_s) - slope_1_s * rate_m_s
        return (nx, ny, nz, least, rank)


REPORTED_M_S2 = 0.3  # smaller changes come and go with noise
ENDS_AFTER_S = 2.0  # an intervention ends after this time without a change
PERIOD_S = 5.0  # shortest time between two events


class Interventions:
    """Finds the beginning of each intervention."""

    def __init__(self) -> None:
        self._changed_s = -inf  # when the command was last changed by REPORTED_M_S2
        self._event_s = -inf

    def step(self, now_s: float, separation: SeparationReport) -> tuple[Notice, ...]:
        """An event in the tick in which an intervention begins."""
        if separation.changed_m_s2 < REPORTED_M_S2:
            return ()
        begins = now_s - self._changed_s > ENDS_AFTER_S and now_s - self._event_s > PERIOD_S
        self._changed_s = now_s
        if not begins:
            return ()
        self._event_s = now_s
        text = f"the filter of vehicles, obstacles and fence changes the acceleration by {separation.changed_m_s2:.1f} m/s^2"
        if nearest := separation.nearest:
            text += (
                f"; nearest vehicle: {nearest.name} at {nearest.distance_m:.2f} m, required {nearest.required_m:.2f} m"
            )
        return (Notice(Code.SEPARATION_INTERVENES, text),)
