"""The stage between law and output: the speed limit, then the smallest change that keeps off vehicles, obstacles and fence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist

from msgspec import Struct

from companion.core.consensus.law import Gains
from companion.core.consensus.peers import PeerState
from companion.core.safety.filter.acceleration_filter import AccelerationLimits, filtered
from companion.core.safety.filter.boundaries import Boundaries
from companion.core.safety.filter.lag import Lag
from companion.core.safety.filter.right_of_way import turn_right
from companion.core.safety.filter.separation import Barrier, Separation, distance_m, nearest_vehicle
from companion.core.safety.filter.speed_limit import SpeedLimit, limited
from companion.core.safety.filter.traffic import Traffic
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot
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
