"""The setpoint of a tick: the acceleration of the phase, through the output limits, or a last level attitude before silence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct

from companion.core.command.autopilot_profile import profile_of
from companion.core.consensus.law import (
    FormationLaw,
    FormationState,
    Gains,
    KeptOff,
    feedback,
    formation_acceleration,
    formation_state,
    target,
)
from companion.core.consensus.stage import Consensus
from companion.core.control.setpoint_stream import THRUST_FRESH_S, SetpointStream
from companion.core.estimation.wind import FlightSample
from companion.core.formation.guidance import Guidance
from companion.core.safety.filter.safety_filter import SafetyFilter
from companion.core.safety.safeguard import Safety
from companion.types.autopilot import AttitudeTarget, AutopilotMode, LandedState, VehicleState
from companion.types.flight import COOPERATING, FailsafeAction, Flight, FlightPhase
from companion.types.peers import ReceivedTraffic
from companion.types.status import SeparationReport
from companion.types.values import ZERO3, Vector3

UNFILTERED = SeparationReport()
# Member lookup of an enum is slow, and every tick needs these.
ENGAGE, FORMATION, TAKEOFF = FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.TAKEOFF
OFFBOARD, STOP_STREAM = AutopilotMode.OFFBOARD, FailsafeAction.STOP_STREAM
OFF_THE_GROUND = (LandedState.IN_AIR, LandedState.TAKEOFF)
CLIMBS_M_S = 0.3  # faster than that it is not on the ground any more


class Setpoint(Struct, frozen=True, gc=False):
    """The attitude target of this tick, None where nothing is to be sent, and what was estimated for it.

    `sent_s` is when the last one was sent, or the stream began. `acceleration_enu_m_s2` is what the autopilot is believed
    to fly.
    """

    target: AttitudeTarget | None
    sent_s: float
    acceleration_enu_m_s2: Vector3
    hover_thrust_norm: float
    disturbance_enu_m_s2: Vector3
    largest_step_deg: float
    rejected: Mapping[str, int]
    separation: SeparationReport = UNFILTERED
    rft: FormationState | None = None  # to publish where the separation filter keeps this vehicle off its slot


class SetpointStage:
    """Turns guidance into an acceleration, and that into attitude and thrust."""

    def __init__(
        self,
        law: FormationLaw,
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
        self._law_flies_altitude = law_flies_altitude
        self._altitude_hold_gains = altitude_hold_gains
        self._safety_filter = safety_filter
        self._stream = stream
        self._flown_for_s = flown_for_s
        self._drag_1_s = drag_1_s
        self._hold_altitude_m = 0.0
        self._separation = UNFILTERED  # of the last setpoint
        self._taken_m_s2 = 0.0  # from the acceleration that the law wants, by other vehicles
        self._kept_off = KeptOff()

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
        stream, silent = self._stream, safety.action is STOP_STREAM
        self._observe(now_s, vehicle, before, silent)
        self._safety_filter.receive(now_s, vehicle, traffic)
        if flight.streams and not before.streams:
            stream.open(now_s, vehicle)
        attitude_target = None
        if flight.streams and not silent:
            if stream.may_follow(vehicle):
                attitude_target = self._decide(now_s, vehicle, flight, consensus, guidance)
        elif before.streams and _listens_in_silence(vehicle):
            attitude_target = stream.final_level_setpoint(now_s)
        observer = stream.observer
        return Setpoint(
            target=attitude_target,
            sent_s=stream.sent_s,
            acceleration_enu_m_s2=(
                stream.flown_acceleration_enu_m_s2(now_s, self._flown_for_s) if flight.streams else ZERO3
            ),
            hover_thrust_norm=observer.hover_thrust_norm,
            disturbance_enu_m_s2=observer.disturbance_enu_m_s2,
            largest_step_deg=stream.largest_step_deg,
            rejected=stream.rejected,
            separation=self._separation if flight.streams else UNFILTERED,
            rft=self._published_rft(now_s, vehicle, flight, consensus, guidance),
        )

    def _decide(
        self, now_s: float, vehicle: VehicleState, flight: Flight, consensus: Consensus, guidance: Guidance
    ) -> AttitudeTarget | None:
        """The attitude target of this phase; None where the output limits refuse it."""
        phase = flight.phase
        if phase is ENGAGE:  # the autopilot has not taken the stream yet
            self._hold_altitude_m = vehicle.position_enu_m[2]
            return self._stream.carry_on(now_s, vehicle)
        if phase is FORMATION:
            wanted_enu_m_s2 = self._in_formation(vehicle, consensus, guidance)
        elif flight.levels:  # no acceleration over ground
            wanted_enu_m_s2 = (0.0, 0.0, self._braking(vehicle)[2])
        else:  # the autopilot does not take over
            wanted_enu_m_s2 = self._braking(vehicle)
        safe = self._safety_filter.step(
            now_s,
            vehicle,
            phase is FORMATION,
            consensus.newest,
            consensus.fresh,
            guidance.slot,
            wanted_enu_m_s2,
            self._stream.flown_acceleration_enu_m_s2(now_s, self._flown_for_s),
            self._stream.observer.disturbance_enu_m_s2,
        )
        self._separation, self._taken_m_s2 = safe.separation, safe.taken_m_s2
        return self._stream.follow(now_s, vehicle, safe.acceleration_enu_m_s2)

    def _in_formation(self, vehicle: VehicleState, consensus: Consensus, guidance: Guidance) -> Vector3:
        """Eq. 14 about a slot that may move, or on z the vehicle's own altitude hold; m/s^2 in ENU."""
        slot = guidance.slot
        own = formation_state(vehicle.position_enu_m, vehicle.velocity_enu_m_s, slot)
        x, y, z = formation_acceleration(self._law, own, consensus.neighbours, guidance.reference, self._drag_1_s)
        dx, dy, dz = slot.acceleration_enu_m_s2
        if not self._law_flies_altitude:
            return (x + dx, y + dy, self._braking(vehicle)[2])
        self._hold_altitude_m = vehicle.position_enu_m[2]  # where a handover begins
        return (x + dx, y + dy, z + dz)

    def _published_rft(
        self, now_s: float, vehicle: VehicleState, flight: Flight, consensus: Consensus, guidance: Guidance
    ) -> FormationState | None:
        """The RFT for peers where the separation filter keeps this vehicle off its slot."""
        if flight.phase is not FORMATION:
            self._kept_off.end()
            return None
        if not self._kept_off.intervened(now_s, self._taken_m_s2):
            return None
        rft = target(self._law, consensus.neighbours, guidance.reference)
        if rft is None:
            return None
        position_enu_m = vehicle.position_enu_m
        if not self._law_flies_altitude:  # no height is wanted of the slot
            position_enu_m = (*position_enu_m[:2], rft.position_enu_m[2] + guidance.slot.position_enu_m[2])
        own = formation_state(position_enu_m, vehicle.velocity_enu_m_s, guidance.slot)
        return self._kept_off.rft(now_s, own, rft)

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
        if silent or now_s - thrust_time_s > THRUST_FRESH_S or not _flies_freely(vehicle, before.phase):
            observer.pause()
            return
        attitude_rad = (vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        observer.update(FlightSample(vehicle.position_time_s, vehicle.velocity_enu_m_s, attitude_rad, thrust_norm))


def _flies_freely(vehicle: VehicleState, phase: FlightPhase) -> bool:
    """Off the ground, and flown by the agent or as the agent requested."""
    if vehicle.landed not in OFF_THE_GROUND:
        return False
    if phase is TAKEOFF:  # it may not have left the ground yet, whatever the landed state
        return vehicle.velocity_enu_m_s[2] > CLIMBS_M_S
    return phase in COOPERATING


def _listens_in_silence(vehicle: VehicleState) -> bool:
    """The autopilot still takes setpoints, and would go on with the last one."""
    return vehicle.mode is OFFBOARD and profile_of(vehicle).flies_on_in_silence
