"""The stage between law and output: the speed limit, then the smallest change that keeps off vehicles, obstacles and fence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import dist, hypot, inf, sqrt

from msgspec import Struct

from companion.core.consensus.law import Gains
from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import Ahead, Lag, Traffic
from companion.core.filter.solver import AccelerationLimits, HalfSpace, Rank, filtered
from companion.core.filter.vehicles import Barrier, Separation, distance_m, nearest_vehicle, turn_right
from companion.geometry.airspace import Airspace, Gap
from companion.geometry.curves import approach_speed
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot
from companion.types.notices import Code, Notice
from companion.types.peers import ReceivedTraffic
from companion.types.status import SeparationReport
from companion.types.values import Vector3

TURN_STEPS = 3  # of the active set, for the turn to the right


class Filtered(Struct, frozen=True, gc=False):
    """The acceleration to fly, the same object as the wanted one where nothing changes it.

    `taken_m_s2`: the most that another vehicle took away from the wanted one, along the line to it.
    """

    acceleration_enu_m_s2: Vector3
    separation: SeparationReport
    taken_m_s2: float = 0.0


class SafetyFilter:
    """Limits the speed, then filters the acceleration by the half-spaces of vehicles, obstacles and fence."""

    def __init__(
        self,
        separation: Separation,
        separation_m: float,
        boundaries: Boundaries,
        speed_limit: SpeedLimit,
        limits: AccelerationLimits,
        gains: Gains,
    ) -> None:
        self._separation = separation
        self._separation_m = separation_m
        self._traffic = Traffic()
        self._boundaries = boundaries
        self._speed_limit = speed_limit
        self._lag = Lag()
        self._limits = limits
        self._gains = gains

    def receive(self, now_s: float, vehicle: VehicleState, traffic: Iterable[ReceivedTraffic]) -> None:
        """Take the traffic of this tick, in every phase."""
        self._traffic.step(now_s, vehicle.position_enu_m, traffic)

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        in_formation: bool,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
        slot: FlownSlot,
        wanted_enu_m_s2: Vector3,
        flown_enu_m_s2: Vector3,
        disturbance_enu_m_s2: Vector3,
    ) -> Filtered:
        """`flown_enu_m_s2`: the command of the last tick. `peers`: the newest packets of any age, `fresh`: those in time."""
        ahead = self._lag.step(now_s, vehicle, flown_enu_m_s2)
        barriers = self._separation.step(now_s, vehicle, ahead, slot, in_formation, peers, fresh, self._traffic.newest)
        speed_spaces = self._speed_limit.half_spaces(ahead)
        slowed = limited(wanted_enu_m_s2, speed_spaces)
        # The speed limit is among the half-spaces, too: what the filter adds must not exceed it.
        spaces = [barrier.space for barrier in barriers]
        spaces += [barrier.bare for barrier in barriers if barrier.bare]
        spaces += self._boundaries.half_spaces(ahead)
        spaces += speed_spaces
        limits = self._limits.in_wind(disturbance_enu_m_s2)
        allowed = filtered(slowed, spaces, limits)
        nearest = nearest_vehicle(now_s, vehicle, barriers) if barriers else None
        # Where positions are uncertain, the vehicle with the least room may be farther away than another one.
        violated = any(distance_m(now_s, vehicle, barrier.other) < self._separation_m for barrier in barriers)
        if allowed is wanted_enu_m_s2:
            return Filtered(allowed, SeparationReport(nearest, 0.0, violated))
        taken_m_s2 = 0.0
        if barriers:
            taken_m_s2 = _taken_m_s2(slowed, barriers)
            turn_x, turn_y = turn_right(slowed, vehicle.velocity_enu_m_s, self._gains, barriers)
            if turn_x or turn_y:
                x, y, z = allowed
                allowed = filtered((x + turn_x, y + turn_y, z), spaces, limits, TURN_STEPS)
        return Filtered(allowed, SeparationReport(nearest, dist(allowed, wanted_enu_m_s2), violated), taken_m_s2)


def _taken_m_s2(wanted_enu_m_s2: Vector3, barriers: Iterable[Barrier]) -> float:
    """The most that the half-space of a vehicle takes from the wanted acceleration."""
    x, y, z = wanted_enu_m_s2
    most = 0.0
    for barrier in barriers:
        nx, ny, nz, least, _ = barrier.space
        short = least - nx * x - ny * y - nz * z
        if short > most:
            most = short
    return most


OBSTACLE, FENCE = Rank.OBSTACLE, Rank.FENCE
BOUNDARY_RESPONSE_1_S = 4.0  # k: how fast b may approach 0
SLOPE_1_S = 2.0  # of the approach speed near the boundary
FASTEST_RETURN_M_S = 1.0  # demanded beyond the boundary
NEVER_WANTED_M_S2 = 20.0  # no acceleration is larger, so a half-space that allows all up to this cannot matter


class Boundaries:
    """`level_m_s2` and `vertical_m_s2` are the decelerations that the vehicle plans to brake with."""

    def __init__(self, airspace: Airspace, level_m_s2: float, vertical_m_s2: float) -> None:
        self._airspace = airspace
        self._level_m_s2 = level_m_s2
        self._vertical_m_s2 = vertical_m_s2
        self._least_m_s2 = min(level_m_s2, vertical_m_s2)
        self._reach_at_rest_m = airspace.clearance_m + self._least_m_s2 / SLOPE_1_S**2

    def half_spaces(self, ahead: Ahead) -> list[HalfSpace]:
        """Half-spaces of all obstacles and walls of the fence that may matter in this state."""
        position_enu_m, reach_m = ahead.position_enu_m, self._reach_m(ahead)
        spaces = []
        for obstacle in self._airspace.obstacles:
            gap = obstacle.gap(position_enu_m)
            if gap[0] < reach_m:
                spaces.append(self._half_space(gap, ahead, OBSTACLE))
        walls = self._airspace.fence.gaps(position_enu_m, reach_m)
        return spaces + [self._half_space(gap, ahead, FENCE) for gap in walls] if walls else spaces

    def _reach_m(self, ahead: Ahead) -> float:
        """Farther than this nothing limits an acceleration: V(h) is above the speed by NEVER_WANTED_M_S2 / k."""
        vx, vy, vz = ahead.velocity_enu_m_s
        speed_m_s = sqrt(vx * vx + vy * vy + vz * vz) + NEVER_WANTED_M_S2 / BOUNDARY_RESPONSE_1_S
        return self._reach_at_rest_m + speed_m_s * speed_m_s / (2.0 * self._least_m_s2)

    def _half_space(self, gap: Gap, ahead: Ahead, rank: Rank) -> HalfSpace:
        distance_m, (nx, ny, nz) = gap
        vx, vy, vz = ahead.velocity_enu_m_s
        rate_m_s = nx * vx + ny * vy + nz * vz
        speed_m_s, slope_1_s = approach_speed(
            distance_m - self._airspace.clearance_m, self._braking_m_s2(nz), SLOPE_1_S
        )
        if speed_m_s < -FASTEST_RETURN_M_S:
            speed_m_s, slope_1_s = -FASTEST_RETURN_M_S, 0.0
        least = -BOUNDARY_RESPONSE_1_S * (rate_m_s + speed_m_s) - slope_1_s * rate_m_s
        return (nx, ny, nz, least, rank)

    def _braking_m_s2(self, upward: float) -> float:
        if upward == 0.0:
            return self._level_m_s2
        return self._vertical_m_s2 if abs(upward) == 1.0 else self._least_m_s2


SPEED = Rank.SPEED
SPEED_RESPONSE_1_S = 2.0  # k
STILL_M_S = 0.1  # below this speed its direction means nothing


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """Largest speeds: horizontal, upwards and downwards."""

    level_m_s: float
    climb_m_s: float
    descent_m_s: float

    def half_spaces(self, ahead: Ahead) -> list[HalfSpace]:
        """Half-spaces of the vertical and of the horizontal speed. Their normals are perpendicular to each other."""
        vx, vy, vz = ahead.velocity_enu_m_s
        if vz > 0.0:
            spaces: list[HalfSpace] = [(0.0, 0.0, -1.0, -SPEED_RESPONSE_1_S * (self.climb_m_s - vz), SPEED)]
        else:
            spaces = [(0.0, 0.0, 1.0, -SPEED_RESPONSE_1_S * (self.descent_m_s + vz), SPEED)]
        level_m_s = hypot(vx, vy)
        if level_m_s > STILL_M_S:
            least_m_s2 = -SPEED_RESPONSE_1_S * (self.level_m_s - level_m_s)
            spaces.append((-vx / level_m_s, -vy / level_m_s, 0.0, least_m_s2, SPEED))
        return spaces


def limited(acceleration_enu_m_s2: Vector3, spaces: Iterable[HalfSpace]) -> Vector3:
    """The acceleration without what would exceed a speed limit; the same object where there is nothing of it."""
    allowed = acceleration_enu_m_s2
    for space in spaces:
        (nx, ny, nz, least, _), (ux, uy, uz) = space, allowed
        short = least - (nx * ux + ny * uy + nz * uz)
        if short > 0.0:
            allowed = (ux + short * nx, uy + short * ny, uz + short * nz)
    return allowed


REPORTED_M_S2 = 0.3  # smaller changes come and go with noise
ENDS_AFTER_S = 2.0  # without a change: then the next one is another intervention
PERIOD_S = 5.0  # at least, between two events


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
