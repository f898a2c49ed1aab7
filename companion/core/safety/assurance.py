"""The last check of a command, independent of the filter that made it: run-time assurance in the sense of ASTM F3269.

The filter decides by barriers, margins, silence and rank, in some hundred lines for each of these. A defect in one of them is a
collision. This monitor shares types and geometry with it and no decision: it asks of each command only whether what must always
hold can still hold after it, with the full braking that the envelope allows, and can do one thing: brake instead.

- Two vehicles that cooperate, both in formation and fresh, can still stop at SHARE of `separation_m` from each other.
- The vehicle can still stop inside the fence, above its floor, and before every obstacle.
- It is back within its limits of speed after a second (`overspeed.py`).
- The attitude target is finite and within tilt, thrust and their rates; else nothing is sent.
- The position that was used is fresh; else nothing is sent.

The filter plans with half the braking, at the whole `separation_m` and with a clearance: where it is right, nothing of this is
ever near. The monitor does not save a vehicle from another one that does not brake, or from wrong positions.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, inf, isfinite, sqrt, tan

from companion.core.consensus.peers import PeerState
from companion.core.safety.limits import OutputLimits
from companion.core.safety.overspeed import Overspeed
from companion.geometry.airspace import Airspace
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.types.autopilot import AttitudeTarget, VehicleState
from companion.types.flight import FlightPhase
from companion.types.values import GRAVITY_M_S2, Vector3

FORMATION = FlightPhase.FORMATION
SHARE = 0.65  # of separation_m, at which two vehicles must be able to stop
BRAKING_SHARE = 0.8  # of the largest braking: the rest is for wind
RESPONDS_S = 0.3  # attitude lag, a tick, and the transport of a packet
STANDS_M_S = 0.1  # a slower approach is noise of the estimators
STOPS_WITHIN_S = 0.25  # the velocity is braked away in so long, as far as the envelope allows
IN_A_ROW = 3  # ticks: a velocity that changes its sign with each packet stops no vehicle
OLDEST_S = 0.1  # of the position that a command was decided by
ROUNDED_RAD = 1e-3
SLEW_S = 0.1  # after a longer time without a setpoint another stream begins


class CommandMonitor:
    """Passes a command on, or brakes."""

    def __init__(self, separation_m: float, airspace: Airspace, limits: OutputLimits) -> None:
        self._least_m = SHARE * separation_m
        self._airspace, self._is_box = airspace, airspace.is_box
        self._limits = limits
        braking_m_s2 = BRAKING_SHARE * GRAVITY_M_S2
        self._level_m_s2 = braking_m_s2 * tan(limits.max_tilt_rad)
        self._up_m_s2 = min(self._level_m_s2, braking_m_s2 * (limits.max_thrust_ratio - 1.0))
        self._down_m_s2 = min(self._level_m_s2, braking_m_s2 * (1.0 - limits.min_thrust_ratio))
        self._weakest_m_s2 = min(self._up_m_s2, self._down_m_s2)
        self._last, self._last_s = AttitudeTarget(0.0, 0.0, 0.0, 0.0), -inf
        self._found_ticks = 0
        self._overspeed = Overspeed(limits, self._level_m_s2, self._up_m_s2, self._down_m_s2)

    def acceleration(
        self, now_s: float, vehicle: VehicleState, fresh: Mapping[int, PeerState], wanted_enu_m_s2: Vector3
    ) -> Vector3:
        """The acceleration, or that of braking where this one leaves no way to stop.

        `fresh`: the peers in time, of a vehicle in formation; none otherwise.
        """
        age_s = now_s - vehicle.position_time_s
        (x, y, z), (vx, vy, vz), (ux, uy, uz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s, wanted_enu_m_s2
        place = (x + vx * age_s, y + vy * age_s, z + vz * age_s)
        velocity = (vx + ux * RESPONDS_S, vy + uy * RESPONDS_S, vz + uz * RESPONDS_S)
        found = self._meets(now_s, place, velocity, fresh) or self._leaves(place, velocity)
        self._found_ticks = self._found_ticks + 1 if found else 0
        if self._found_ticks >= IN_A_ROW:
            return (-vx / STOPS_WITHIN_S, -vy / STOPS_WITHIN_S, -vz / STOPS_WITHIN_S)
        limits, overspeed = self._limits, self._overspeed
        is_slow = vx * vx + vy * vy <= limits.max_speed_m_s**2 and -limits.max_descent_m_s <= vz <= limits.max_climb_m_s
        if is_slow and not overspeed.lasts:
            return wanted_enu_m_s2
        return overspeed.slowed(now_s, vehicle.velocity_enu_m_s, wanted_enu_m_s2)

    def _meets(self, now_s: float, place: Vector3, velocity: Vector3, fresh: Mapping[int, PeerState]) -> bool:
        """Whether a cooperating vehicle would come too near although both brake: on a straight path relative to each other."""
        (x, y, z), (vx, vy, vz), both_m_s2 = place, velocity, 2.0 * self._level_m_s2
        least_m2 = self._least_m * self._least_m
        for peer in fresh.values():
            packet = peer.packet
            if packet.phase is not FORMATION:
                continue
            motion, age_s = packet.motion, now_s - peer.measured_s
            (px, py, pz), (wx, wy, wz) = motion.position_enu_m, motion.velocity_enu_m_s
            ax, ay, az = motion.acceleration_enu_m_s2
            ahead_s = age_s + RESPONDS_S
            rx, ry, rz = vx - wx - ax * ahead_s, vy - wy - ay * ahead_s, (vz - wz - az * ahead_s) * HEIGHT_WEIGHT
            speed_m2_s2 = rx * rx + ry * ry + rz * rz
            if speed_m2_s2 <= STANDS_M_S * STANDS_M_S:  # noise
                continue
            dx, dy, dz = x - px - wx * age_s, y - py - wy * age_s, (z - pz - wz * age_s) * HEIGHT_WEIGHT
            nears = -(dx * rx + dy * ry + dz * rz)
            if nears <= 0.0:  # they part
                continue
            speed_m_s = sqrt(speed_m2_s2)
            way_m, stop_m = nears / speed_m_s, speed_m_s * RESPONDS_S + speed_m2_s2 / (2.0 * both_m_s2)
            share = (way_m if way_m < stop_m else stop_m) / speed_m_s  # to where they pass each other, or stand
            dx, dy, dz = dx + rx * share, dy + ry * share, dz + rz * share
            if dx * dx + dy * dy + dz * dz < least_m2:
                return True
        return False

    def _leaves(self, place: Vector3, velocity: Vector3) -> bool:
        """Whether the vehicle could no longer stop before a wall of the fence or an obstacle."""
        fence = self._airspace.fence
        (x, y, z), (lx, ly, lz), (hx, hy, hz) = place, fence.min_enu_m, fence.max_enu_m
        vx, vy, vz = velocity
        speed_m_s = sqrt(vx * vx + vy * vy + vz * vz)
        far_m = speed_m_s * RESPONDS_S + 0.5 * speed_m_s * speed_m_s / self._weakest_m_s2
        in_the_box = lx + far_m <= x <= hx - far_m and ly + far_m <= y <= hy - far_m and lz + far_m <= z <= hz - far_m
        if self._is_box and in_the_box:
            return False
        gaps = fence.gaps(place, far_m)
        gaps += [obstacle.gap(place) for obstacle in self._airspace.obstacles]
        for room_m, (nx, ny, nz) in gaps:
            speed_m_s = -(nx * vx + ny * vy + nz * vz)
            braking_m_s2 = self._up_m_s2 if nz > 0.0 else self._down_m_s2 if nz < 0.0 else self._level_m_s2
            stop_m = speed_m_s * RESPONDS_S + 0.5 * speed_m_s * speed_m_s / braking_m_s2
            if speed_m_s > STANDS_M_S and room_m < stop_m:
                return True
        return False

    def permits(self, now_s: float, vehicle: VehicleState, target: AttitudeTarget) -> bool:
        """Whether this target may be sent after the last one that was permitted."""
        limits, last = self._limits, self._last
        roll, pitch, thrust = target.roll_rad, target.pitch_rad, target.thrust_norm
        most_rad = inf if now_s - self._last_s > SLEW_S else limits.max_tilt_rate_rad_s * SLEW_S + ROUNDED_RAD
        if not (
            now_s - vehicle.position_time_s <= OLDEST_S
            and isfinite(target.yaw_rad)
            and hypot(roll, pitch) <= limits.max_tilt_rad + ROUNDED_RAD
            and -most_rad <= roll - last.roll_rad <= most_rad
            and -most_rad <= pitch - last.pitch_rad <= most_rad
            and 0.0 <= thrust <= 1.0
        ):  # or not a number
            return False
        self._last, self._last_s = target, now_s
        return True
