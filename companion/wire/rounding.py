"""Numbers as they leave a vehicle: rounded far below what any sensor resolves.

A float of 64 bits has 17 digits, most of them noise that no recording could compress. The control loop rounds before it sends
and records, so that every receiver acts on exactly what recordings hold. So a replay on another make of processor, whose last
digit of a sine differs, gives the same commands too. Rounding is idempotent.
"""

from __future__ import annotations

from msgspec.structs import replace

from companion.geometry.vectors import rounded
from companion.types.autopilot import AttitudeTarget, PositionError
from companion.types.formation import FlownSlot, Heading, LeaderBeacon
from companion.types.peers import LostVehicle, PeerPacket
from companion.types.status import ControlReport, MotionReport, SeparationReport, Status
from companion.types.tick import Outbox
from companion.types.values import Vector3

LENGTH = 4  # decimals: 0.1 mm
VELOCITY = 3  # 1 mm/s
ACCELERATION = 2  # 1 cm/s^2; the noise of a good velocity alone makes that much
TIME = 4  # 0.1 ms
ANGLE = 6  # 1 urad, 1 urad/s
SHARE = 6  # a millionth of full thrust
SETPOINT = 6  # 1 urad, and a millionth of full thrust


def round_outbox(outbox: Outbox) -> Outbox:
    """The outbox with its setpoint, packet and status as they leave the vehicle. Requests, replies and events stay."""
    target, packet, status = outbox.attitude_target, outbox.peer_packet, outbox.status
    return replace(
        outbox,
        attitude_target=round_target(target) if target else None,
        peer_packet=_round_packet(packet) if packet else None,
        status=_round_status(status) if status else None,
    )


def round_target(target: AttitudeTarget) -> AttitudeTarget:
    """The setpoint as it is handed to the autopilot's link."""
    return AttitudeTarget(
        round(target.roll_rad, SETPOINT),
        round(target.pitch_rad, SETPOINT),
        round(target.yaw_rad, SETPOINT),
        round(target.thrust_norm, SETPOINT),
    )


def _round_packet(packet: PeerPacket) -> PeerPacket:
    """What vehicles compare for equality is kept: numbers, and the slots of a change."""
    motion, beacon, error, rft = packet.motion, packet.leader.beacon, packet.position_error, packet.rft
    return replace(
        packet,
        motion=replace(
            motion,
            position_enu_m=rounded(motion.position_enu_m, LENGTH),
            velocity_enu_m_s=rounded(motion.velocity_enu_m_s, VELOCITY),
            acceleration_enu_m_s2=rounded(motion.acceleration_enu_m_s2, ACCELERATION),
            state_age_s=round(motion.state_age_s, TIME),
            sent_s=round(motion.sent_s, TIME),
        ),
        leader=replace(packet.leader, beacon=_beacon(beacon) if beacon else None),
        slot=_slot(packet.slot),
        position_error=_error(error) if error else None,
        rft=_motion(*rft) if rft else None,
        lost=tuple([_lost(lost) for lost in packet.lost]) if packet.lost else (),
        law_values=tuple([rounded(value, LENGTH) for value in packet.law_values]) if packet.law_values else (),
    )


def _round_status(status: Status) -> Status:
    motion, control, lead, formation = status.motion, status.control, status.leadership, status.formation
    beacon, age_s, target_age_s = lead.leader_beacon, lead.leader_beacon_age_s, formation.target_age_s
    reference_enu_m, error, ages_s = (
        formation.reference_enu_m,
        motion.position_error,
        status.neighbourhood.neighbour_ages_s,
    )
    return replace(
        status,
        motion=MotionReport(
            position_enu_m=rounded(motion.position_enu_m, LENGTH),
            velocity_enu_m_s=rounded(motion.velocity_enu_m_s, VELOCITY),
            state_age_s=round(motion.state_age_s, TIME),
            position_error=_error(error) if error else None,
        ),
        control=ControlReport(
            hover_thrust_norm=round(control.hover_thrust_norm, SHARE),
            disturbance_enu_m_s2=rounded(control.disturbance_enu_m_s2, ACCELERATION),
            largest_step_deg=round(control.largest_step_deg, LENGTH),
        ),
        leadership=replace(
            lead,
            leader_beacon=_beacon(beacon) if beacon else None,
            leader_beacon_age_s=None if age_s is None else round(age_s, TIME),
        ),
        neighbourhood=replace(status.neighbourhood, neighbour_ages_s=tuple([round(age_s, TIME) for age_s in ages_s])),
        formation=replace(
            formation,
            slot=_slot(formation.slot),
            reference_enu_m=rounded(reference_enu_m, LENGTH) if reference_enu_m else None,
            reference_s=round(formation.reference_s, TIME),
            target_age_s=None if target_age_s is None else round(target_age_s, TIME),
            heading=_heading(formation.heading),
        ),
        safety=replace(status.safety, separation=_separation(status.safety.separation)),
    )


def _motion(
    position_enu_m: Vector3, velocity_enu_m_s: Vector3, acceleration_enu_m_s2: Vector3
) -> tuple[Vector3, Vector3, Vector3]:
    return (
        rounded(position_enu_m, LENGTH),
        rounded(velocity_enu_m_s, VELOCITY),
        rounded(acceleration_enu_m_s2, ACCELERATION),
    )


def _lost(lost: LostVehicle) -> LostVehicle:
    return LostVehicle(
        lost.vehicle_id,
        rounded(lost.position_enu_m, LENGTH),
        rounded(lost.velocity_enu_m_s, VELOCITY),
        round(lost.age_s, TIME),
    )


def _slot(slot: FlownSlot) -> FlownSlot:
    return replace(
        slot,
        position_enu_m=rounded(slot.position_enu_m, LENGTH),
        velocity_enu_m_s=rounded(slot.velocity_enu_m_s, VELOCITY),
        acceleration_enu_m_s2=rounded(slot.acceleration_enu_m_s2, ACCELERATION),
        moves_for_s=round(slot.moves_for_s, TIME),
    )


def _beacon(beacon: LeaderBeacon) -> LeaderBeacon:
    return replace(beacon, reference_s=round(beacon.reference_s, TIME), heading=_heading(beacon.heading))


def _heading(heading: Heading) -> Heading:
    return Heading(
        round(heading.angle_rad, ANGLE), round(heading.rate_rad_s, ANGLE), round(heading.acceleration_rad_s2, ANGLE)
    )


def _error(error: PositionError) -> PositionError:
    return PositionError(round(error.horizontal_m, LENGTH), round(error.vertical_m, LENGTH))


def _separation(separation: SeparationReport) -> SeparationReport:
    nearest = separation.nearest
    if nearest:
        nearest = replace(
            nearest, distance_m=round(nearest.distance_m, LENGTH), required_m=round(nearest.required_m, LENGTH)
        )
    return replace(separation, nearest=nearest, changed_m_s2=round(separation.changed_m_s2, ACCELERATION))
