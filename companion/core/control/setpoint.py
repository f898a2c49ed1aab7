"""The setpoint of a tick: the acceleration of the phase as attitude and thrust, or a last braking one before silence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from math import atan, cos, degrees, hypot, inf, sin, tan

from msgspec import Struct

from companion.core.consensus.kept_off import KeptOff, target
from companion.core.consensus.law import FlownLaw, feedback, formation_state
from companion.core.consensus.peers import PeerState
from companion.core.consensus.stage import Consensus
from companion.core.control.descent import Descent
from companion.core.estimation.wind import DisturbanceObserver, FlightSample
from companion.core.filter.filter import SafetyFilter
from companion.core.formation.guidance import Guidance
from companion.core.safety.assurance import CommandMonitor
from companion.core.safety.limits import OutputLimiter, OutputLimits
from companion.core.safety.safeguard import Safety
from companion.geometry.vectors import between, shortened
from companion.types.autopilot import AttitudeTarget, AutopilotMode, LandedState, VehicleState, in_air
from companion.types.flight import COOPERATING, FailsafeAction, Flight, FlightPhase
from companion.types.formation import FormationState, Gains
from companion.types.notices import Code
from companion.types.peers import ReceivedTraffic
from companion.types.rejections import count_rejection
from companion.types.status import SeparationReport
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

UNFILTERED = SeparationReport()
NO_PEERS: Mapping[int, PeerState] = {}
# Member lookup of an enum is slow, and every tick needs these.
ENGAGE, FORMATION, TAKEOFF = FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.TAKEOFF
OBSERVE = FlightPhase.OBSERVE
OFFBOARD, STOP_STREAM = AutopilotMode.OFFBOARD, FailsafeAction.STOP_STREAM
OFF_THE_GROUND = (LandedState.IN_AIR, LandedState.TAKEOFF)
CLIMBS_M_S = 0.3  # faster than that it is not on the ground any more


class Setpoint(Struct, frozen=True, gc=False):
    """The attitude target of this tick, None where nothing is to be sent, and what was estimated for it.

    `sent_s` is when the last one was sent, or the stream began. `acceleration_enu_m_s2` is what the autopilot is believed
    to fly, also under a pilot.
    """

    target: AttitudeTarget | None
    sent_s: float
    acceleration_enu_m_s2: Vector3
    hover_thrust_norm: float
    disturbance_enu_m_s2: Vector3
    largest_step_deg: float
    rejected: Mapping[str, int]
    separation: SeparationReport = UNFILTERED
    rft: FormationState | None = None  # published while the separation filter keeps this vehicle off its slot
    law_values: tuple[Vector3, ...] = ()  # what the law publishes of its own


class SetpointStage:
    """Turns guidance into an acceleration, and that into attitude and thrust."""

    def __init__(
        self,
        law: FlownLaw,
        law_flies_altitude: bool,
        altitude_hold_gains: Gains,
        safety_filter: SafetyFilter,
        stream: SetpointStream,
        flown_for_s: float,
        drag_1_s: float,
    ) -> None:
        """Without `law_flies_altitude` the vehicle holds the altitude at which it came into formation.

        `flown_for_s`: for so long the last setpoint is believed to be flown.
        """
        self._law = law
        self._publishes = law.law.publishes > 0
        self._law_flies_altitude = law_flies_altitude
        self._altitude_hold_gains = altitude_hold_gains
        self._safety_filter = safety_filter
        self._stream = stream
        self._flown_for_s = flown_for_s
        self._drag_1_s = drag_1_s
        self._hold_altitude_m = 0.0
        self._separation = UNFILTERED  # what the filter reported with the last setpoint
        self._removed_m_s2 = 0.0  # from the acceleration that the law wants, by other vehicles
        self._kept_off = KeptOff()
        self._descent = Descent()

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        before: Flight,
        flight: Flight,
        consensus: Consensus,
        guidance: Guidance,
        safety: Safety,
        traffic: Iterable[ReceivedTraffic] = (),
    ) -> Setpoint:
        """`before` is the flight at the beginning of the tick, `flight` the one after commands and requests."""
        stream, phase, silent = self._stream, flight.phase, safety.action is STOP_STREAM
        self._observe(now_s, vehicle, before, silent)
        if traffic or self._safety_filter.traffic:
            self._safety_filter.receive(now_s, vehicle, traffic)
        if flight.streams and not before.streams:
            self._begin(now_s, vehicle)
        attitude_target = None
        if flight.streams and not silent:
            if phase is ENGAGE:  # the autopilot has not taken the stream yet
                attitude_target = self._carry_on(now_s, vehicle)
            elif flight.descends:  # unfiltered, as a landing of the autopilot
                attitude_target = stream.follow(now_s, vehicle, self._descent.acceleration_enu_m_s2(now_s, vehicle))
            elif vehicle.position_time_s > stream.position_used_s:  # a decision needs a new position
                peers, disturbance_enu_m_s2 = consensus.peers, stream.observer.disturbance_enu_m_s2
                slot, fresh = (guidance.slot, peers.fresh) if phase is FORMATION else (None, NO_PEERS)
                wanted_enu_m_s2 = self._wanted(vehicle, flight, consensus, guidance)
                last_enu_m_s2 = stream.flown_acceleration_enu_m_s2(now_s, self._flown_for_s)
                safe = self._safety_filter.step(
                    now_s, vehicle, slot, peers.known, peers.fresh, wanted_enu_m_s2, last_enu_m_s2, disturbance_enu_m_s2
                )
                self._separation, self._removed_m_s2 = safe.separation, safe.removed_accel_m_s2
                allowed_enu_m_s2 = stream.checked(now_s, vehicle, fresh, safe.acceleration_enu_m_s2)
                attitude_target = stream.follow(now_s, vehicle, allowed_enu_m_s2)
        elif before.streams and vehicle.mode is OFFBOARD and carries(vehicle) and self._ends(now_s, flight):
            attitude_target = stream.last_before_silence(now_s, self._leads_to_enu_m_s(now_s, vehicle))
        rft = None
        # The RFT of before may be that of a peer in doubt, and followers would confirm it to each other.
        if phase is not FORMATION or consensus.peers.in_doubt:
            self._kept_off.end()
        elif self._removed_m_s2 > 0.0 or self._kept_off.is_kept_off:
            rft = self._published_rft(now_s, vehicle, consensus, guidance)
        flown_enu_m_s2 = stream.flown_acceleration_enu_m_s2(now_s, self._flown_for_s) if flight.streams else ZERO3
        if phase is OBSERVE:
            flown_enu_m_s2 = self._piloted(now_s, vehicle)
        return Setpoint(
            target=attitude_target,
            sent_s=stream.sent_s,
            acceleration_enu_m_s2=flown_enu_m_s2,
            hover_thrust_norm=stream.observer.hover_thrust_norm,
            disturbance_enu_m_s2=stream.observer.disturbance_enu_m_s2,
            largest_step_deg=stream.largest_step_deg,
            rejected=stream.rejected,
            separation=self._separation if flight.streams else UNFILTERED,
            rft=rft,
            law_values=self._law_values(vehicle, phase, consensus, guidance, rft) if self._publishes else (),
        )

    def _ends(self, now_s: float, flight: Flight) -> bool:
        """The stream ends by decision, or no new position has come for a while."""
        return not flight.streams or now_s - self._stream.sent_s >= ENDS_AFTER_S

    def _leads_to_enu_m_s(self, now_s: float, vehicle: VehicleState) -> Vector3:
        """The velocity after the attitude lag: until then an evasion goes on that has hardly begun."""
        if now_s - vehicle.position_time_s > ENDS_WITHIN_S:
            return vehicle.velocity_enu_m_s
        return self._safety_filter.ahead(now_s, vehicle, self._stream.commanded_enu_m_s2).velocity_enu_m_s

    def _begin(self, now_s: float, vehicle: VehicleState) -> None:
        self._stream.open(now_s, vehicle)
        self._descent.restart()
        self._law.end()

    def _law_values(
        self,
        vehicle: VehicleState,
        phase: FlightPhase,
        consensus: Consensus,
        guidance: Guidance,
        rft: FormationState | None,
    ) -> tuple[Vector3, ...]:
        """Of a vehicle that cooperates: its neighbours may be in formation before it."""
        if phase not in COOPERATING or vehicle.position_time_s == -inf:
            return ()
        states, commanded_enu_m_s2 = consensus.neighbours.states, self._stream.commanded_enu_m_s2
        return self._law.values(vehicle, guidance.slot, commanded_enu_m_s2, states, guidance.reference, rft)

    def _carry_on(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget | None:
        """What the vehicle does already. A decision needs a new position here, too."""
        if vehicle.position_time_s <= self._stream.position_used_s:
            return None
        self._hold_altitude_m = vehicle.position_enu_m[2]
        return self._stream.carry_on(now_s, vehicle)

    def _wanted(self, vehicle: VehicleState, flight: Flight, consensus: Consensus, guidance: Guidance) -> Vector3:
        """The acceleration of this phase, m/s^2 in ENU, before the safety filter.

        In formation eq. 14 about a slot that may move, or on z the vehicle's own altitude hold.
        """
        if flight.phase is not FORMATION:  # brakes, then the autopilot takes over, level first, or does not take over
            x, y, z = self._braking(vehicle)
            if flight.levels:
                return (0.0, 0.0, z)
            x, y, _ = shortened((x, y, 0.0), self._safety_filter.braking_alone_m_s2)
            return (x, y, z)
        slot = guidance.slot
        commanded_enu_m_s2, states = self._stream.commanded_enu_m_s2, consensus.neighbours.states
        x, y, z = self._law.acceleration(vehicle, slot, commanded_enu_m_s2, states, guidance.reference)
        dx, dy, dz = slot.acceleration_enu_m_s2
        if not self._law_flies_altitude:
            return (x + dx, y + dy, self._braking(vehicle)[2])
        self._hold_altitude_m = vehicle.position_enu_m[2]  # where a handover begins
        return (x + dx, y + dy, z + dz)

    def _published_rft(
        self, now_s: float, vehicle: VehicleState, consensus: Consensus, guidance: Guidance
    ) -> FormationState | None:
        """The RFT for peers while the separation filter keeps this vehicle off its slot."""
        if not self._kept_off.intervened(now_s, self._removed_m_s2):
            return None
        rft = target(self._law.law, consensus.neighbours.states, guidance.reference)
        if rft is None:
            return None
        position_enu_m = vehicle.position_enu_m
        if not self._law_flies_altitude:  # no height is wanted of the slot
            position_enu_m = (*position_enu_m[:2], rft.position_enu_m[2] + guidance.slot.position_enu_m[2])
        own = formation_state(position_enu_m, vehicle.velocity_enu_m_s, guidance.slot)
        return self._kept_off.rft(now_s, own, rft)

    def _piloted(self, now_s: float, vehicle: VehicleState) -> Vector3:
        """The acceleration that the attitude shows: peers hear of a pilot's turn before the velocity changes.

        Of the autopilot's own modes peers expect everything from braking to flying on.
        """
        if now_s - vehicle.attitude_time_s > ATTITUDE_FRESH_S or not in_air(vehicle):
            return ZERO3
        x, y = level_acceleration(vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        (vx, vy, _), (dx, dy, _) = vehicle.velocity_enu_m_s, self._stream.observer.disturbance_enu_m_s2
        flown_enu_m_s2 = (x - self._drag_1_s * vx + dx, y - self._drag_1_s * vy + dy, 0.0)
        return shortened(flown_enu_m_s2, self._stream.largest_level_m_s2)

    def _braking(self, vehicle: VehicleState) -> Vector3:
        """Against the velocity, and back to the altitude held; m/s^2 in ENU."""
        climb_m = vehicle.position_enu_m[2] - self._hold_altitude_m
        return feedback(self._altitude_hold_gains, (0.0, 0.0, climb_m), vehicle.velocity_enu_m_s)

    def _observe(self, now_s: float, vehicle: VehicleState, before: Flight, silent: bool) -> None:
        """Estimate hover thrust and wind, in flight under a known thrust only."""
        stream, observer = self._stream, self._stream.observer
        if not vehicle.armed:
            observer.landed()
        thrust_time_s, thrust_norm = vehicle.thrust_time_s, vehicle.thrust_norm  # as the autopilot reports it
        if vehicle.mode is OFFBOARD and before.streams:
            thrust_time_s, thrust_norm = stream.sent_s, stream.sent.thrust_norm
        flies_freely = before.phase in COOPERATING  # flown by the agent or as the agent requested
        if before.phase is TAKEOFF:  # it may not have left the ground yet, whatever the landed state
            flies_freely = vehicle.velocity_enu_m_s[2] > CLIMBS_M_S
        flies_freely = flies_freely and vehicle.landed in OFF_THE_GROUND
        if silent or now_s - thrust_time_s > THRUST_FRESH_S or not flies_freely:
            observer.pause()
            return
        attitude_rad = (vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        observer.update(FlightSample(vehicle.position_time_s, vehicle.velocity_enu_m_s, attitude_rad, thrust_norm))


ENDS_AFTER_S = 0.04  # without a setpoint; a position that comes late after all is worth waiting for
ENDS_WITHIN_S = 0.2
STOPS_IN_S = 1.5  # PX4's COM_OF_LOSS_T and ArduCopter's GUID_TIMEOUT are 0.6 to 2 s, with `companion doctor --fix` 1 s
STOPS_M_S2 = 1.5  # at most: the velocity may have changed meanwhile
ATTITUDE_FRESH_S = 0.1  # five periods of 50 Hz
THRUST_FRESH_S = 0.3  # PX4 sends its thrust 10 times a second by default


class SetpointStream:
    """One vehicle's setpoints. `rejected` counts what was decided and must not be sent.

    `largest_step_deg` is of roll and pitch together, from one setpoint to the next since the stream began; the first one is
    compared with the attitude that the vehicle had.
    """

    def __init__(self, limits: OutputLimits, observer: DisturbanceObserver, monitor: CommandMonitor) -> None:
        self._limits = limits
        self._monitor = monitor
        self._gate = OutputLimiter(limits)
        self.observer = observer
        self.rejected: Counter[str] = Counter()
        self.largest_step_deg = 0.0
        self.position_used_s = -inf  # time of the newest position used for a setpoint
        self.sent_s = 0.0  # when the last setpoint was sent, or the stream opened
        self._ended = False  # the last setpoint before a silence was sent
        self.commanded_enu_m_s2 = ZERO3  # commanded by the last setpoint, without the part against the disturbance
        self.sent = AttitudeTarget(0.0, 0.0, 0.0, 0.0)  # the last setpoint
        self._yaw_rad = 0.0

    @property
    def largest_level_m_s2(self) -> float:
        """At the largest tilt, at a constant height."""
        return GRAVITY_M_S2 * tan(self._limits.max_tilt_rad)

    def open(self, now_s: float, vehicle: VehicleState) -> None:
        """Begin a stream from what the vehicle does now."""
        self._yaw_rad = vehicle.yaw_rad
        self.sent_s, self.commanded_enu_m_s2 = now_s, ZERO3
        current = self._as_it_flies(now_s, vehicle)
        self.sent, self.largest_step_deg = current, 0.0
        self._gate.open_at(now_s, current, self.observer.hover_thrust_norm)

    def carry_on(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget | None:
        """What the vehicle does already, until the autopilot has taken the stream."""
        return self._send(now_s, vehicle, ZERO3, self._as_it_flies(now_s, vehicle))

    def checked(
        self, now_s: float, vehicle: VehicleState, fresh: Mapping[int, PeerState], filtered_enu_m_s2: Vector3
    ) -> Vector3:
        """The filtered acceleration, or braking where the monitor finds that it leaves no way to stop."""
        allowed_enu_m_s2 = self._monitor.acceleration(now_s, vehicle, fresh, filtered_enu_m_s2)
        if allowed_enu_m_s2 is not filtered_enu_m_s2:
            self.rejected = count_rejection(self.rejected, Code.COMMAND_BRAKED)
        return allowed_enu_m_s2

    def follow(self, now_s: float, vehicle: VehicleState, wanted_enu_m_s2: Vector3) -> AttitudeTarget | None:
        """The attitude for this acceleration, as near as tilt and thrust allow, against the estimated disturbance."""
        (x, y, z), (dx, dy, dz), limits = wanted_enu_m_s2, self.observer.disturbance_enu_m_s2, self._limits
        x, y, z = limit_acceleration(
            (x - dx, y - dy, z - dz), limits.max_tilt_rad, limits.min_thrust_ratio, limits.max_thrust_ratio
        )
        try:
            target = attitude_target(
                (x, y, z), self._yaw_rad, vehicle.roll_rad, vehicle.pitch_rad, self.observer.hover_thrust_norm
            )
        except ValueError:
            self.position_used_s = vehicle.position_time_s
            self.rejected = count_rejection(self.rejected, Code.SETPOINT_IMPOSSIBLE)
            return None
        return self._send(now_s, vehicle, (x + dx, y + dy, z + dz), target)

    def last_before_silence(self, now_s: float, moving_enu_m_s: Vector3) -> AttitudeTarget | None:
        """Braking against the wind, once in each silence: an autopilot goes on with the last setpoint for a while.

        What the vehicle flew a moment ago may have been an evasion. `moving_enu_m_s` is the velocity that the attitude lag
        leads to. After ENDS_WITHIN_S none is sent: an agent that was frozen must not disturb what the autopilot does itself.
        """
        if self._ended or now_s - self.sent_s > ENDS_WITHIN_S:
            return None
        self._ended = True
        (vx, vy, vz), (dx, dy, dz) = moving_enu_m_s, self.observer.disturbance_enu_m_s2
        x, y, z = shortened((-vx / STOPS_IN_S, -vy / STOPS_IN_S, -vz / STOPS_IN_S), STOPS_M_S2)
        limits, hover_thrust_norm = self._limits, self.observer.hover_thrust_norm
        possible = limit_acceleration(
            (x - dx, y - dy, z - dz), limits.max_tilt_rad, limits.min_thrust_ratio, limits.max_thrust_ratio
        )
        target = attitude_target(possible, self._yaw_rad, 0.0, 0.0, hover_thrust_norm)
        self.commanded_enu_m_s2 = ZERO3
        self._gate.open_at(now_s, target, hover_thrust_norm)  # no slew: no next setpoint will come closer
        return self._gate.admit(now_s, target, hover_thrust_norm)

    def flown_acceleration_enu_m_s2(self, now_s: float, for_s: float) -> Vector3:
        """What the autopilot is believed to fly: the last setpoint goes on for a while over ticks that decide nothing."""
        return ZERO3 if now_s - self.sent_s > for_s else self.commanded_enu_m_s2

    def _send(
        self, now_s: float, vehicle: VehicleState, acceleration_enu_m_s2: Vector3, wanted: AttitudeTarget
    ) -> AttitudeTarget | None:
        self.position_used_s = vehicle.position_time_s
        target = self._gate.admit(now_s, wanted, self.observer.hover_thrust_norm)
        if target is None or not self._monitor.permits(now_s, vehicle, target):
            self.rejected = count_rejection(self.rejected, Code.SETPOINT_IMPOSSIBLE)
            return None
        sent = self.sent
        step_deg = degrees(hypot(target.roll_rad - sent.roll_rad, target.pitch_rad - sent.pitch_rad))
        if step_deg > self.largest_step_deg:
            self.largest_step_deg = step_deg
        self.sent, self.sent_s, self.commanded_enu_m_s2 = target, now_s, acceleration_enu_m_s2
        self._ended = False
        return target

    def _as_it_flies(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget:
        """The attitude that the vehicle has, with the thrust that carries it: no step where the autopilot takes over."""
        if now_s - vehicle.thrust_time_s <= THRUST_FRESH_S:
            thrust = vehicle.thrust_norm
        else:
            share = max(0.5, cos(vehicle.roll_rad) * cos(vehicle.pitch_rad))
            thrust = self.observer.hover_thrust_norm / share
        return AttitudeTarget(vehicle.roll_rad, vehicle.pitch_rad, self._yaw_rad, thrust)


def limit_acceleration(
    acceleration_enu_m_s2: Vector3, max_tilt_rad: float, min_thrust_ratio: float, max_thrust_ratio: float
) -> Vector3:
    """The nearest acceleration that is possible within the tilt limit, m/s^2. Its horizontal direction is kept.

    Thrust ratios are vertical thrust over weight.
    """
    ux, uy, uz = acceleration_enu_m_s2
    lift, least, highest = uz + GRAVITY_M_S2, min_thrust_ratio * GRAVITY_M_S2, max_thrust_ratio * GRAVITY_M_S2
    if not least <= lift <= highest:
        lift = between(lift, least, highest)
    level = hypot(ux, uy)
    most = lift * tan(max_tilt_rad)
    scale = most / level if level > most else 1.0
    return (ux * scale, uy * scale, lift - GRAVITY_M_S2)


def attitude_target(
    acceleration_enu_m_s2: Vector3,
    yaw_rad: float,
    measured_roll_rad: float,
    measured_pitch_rad: float,
    hover_thrust_norm: float,
) -> AttitudeTarget:
    """Attitude and thrust that give the wanted acceleration.

    Eq. 8 as printed is wrong. Correct, with a = u/(uZ + g): theta = atan(aX cos psi + aY sin psi) and
    phi = atan(cos theta (aX sin psi - aY cos psi)). Eq. 7, F = m (uZ + g)/(cos theta cos phi), uses the measured angles.
    Raises ValueError where uZ + g <= 0 or a measured angle is not within +-pi/2 (Remark 1: loss of control).
    """
    ux, uy, uz = acceleration_enu_m_s2
    lift = uz + GRAVITY_M_S2
    vertical_share = cos(measured_pitch_rad) * cos(measured_roll_rad)
    if not lift > 0.0 or not vertical_share > 0.0:
        raise ValueError("no attitude gives this acceleration")
    ax, ay = ux / lift, uy / lift
    cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
    pitch = atan(ax * cos_yaw + ay * sin_yaw)
    roll = atan(cos(pitch) * (ax * sin_yaw - ay * cos_yaw))
    return AttitudeTarget(roll, pitch, yaw_rad, hover_thrust_norm * lift / (GRAVITY_M_S2 * vertical_share))


def carries(vehicle: VehicleState) -> bool:
    """Whether thrust carries the vehicle at its attitude."""
    return cos(vehicle.roll_rad) * cos(vehicle.pitch_rad) > 0.0


def level_acceleration(roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float]:
    """(east, north) m/s^2 in still air at this attitude and a constant height: the reverse of `attitude_target`.

    No acceleration beyond +-pi/2, where no thrust carries the vehicle.
    """
    cos_roll, cos_pitch = cos(roll_rad), cos(pitch_rad)
    if not (cos_roll > 0.0 and cos_pitch > 0.0):
        return (0.0, 0.0)
    ahead, right = tan(pitch_rad), tan(roll_rad) / cos_pitch
    cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
    return GRAVITY_M_S2 * (ahead * cos_yaw + right * sin_yaw), GRAVITY_M_S2 * (ahead * sin_yaw - right * cos_yaw)
