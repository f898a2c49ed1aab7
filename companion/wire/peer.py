"""PeerPacket <-> bytes."""

from __future__ import annotations

import msgspec
from msgspec.structs import astuple

from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import EAST, FlownSlot, FormationChange, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import ChangeDuration, MissionTime, Number, SlotsOfAll, Vector3, VehicleId, VehicleIds
from companion.wire.messages import _encoder, seal, unsealed

_BeaconWire = tuple[VehicleId, Number, Number, float, Number, tuple[float, float, float] | None]
"""Leader id, epoch, stamp, reference_s, claim, heading with rate and acceleration (None: east and constant)."""


class _PeerWire(msgspec.Struct, array_like=True, frozen=True, forbid_unknown_fields=True):
    """A peer packet on the wire: an array, to keep 50 packets per second small."""

    vehicle_id: VehicleId
    session: Number
    sequence: Number
    formation_hash: int
    phase: FlightPhase
    role: Role
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3
    state_age_s: float
    sent_s: float
    prc: int
    leader_beacon: _BeaconWire | None
    # Each of these has the fields of its type in their order.
    slot: tuple[Vector3, Vector3, Vector3, Number, Number, ChangeDuration]
    position_error: tuple[float, float] | None
    reference: tuple[Number, Number, float] | None
    change: tuple[Number, SlotsOfAll, MissionTime, ChangeDuration, VehicleIds] | None
    armed: bool
    rft: tuple[Vector3, Vector3, Vector3] | None  # position, velocity, acceleration


_peer_decoder = msgspec.msgpack.Decoder(_PeerWire)


def encode_peer(packet: PeerPacket) -> bytes:
    """The message for a peer packet."""
    sender, motion, leader = packet.sender, packet.motion, packet.leader
    beacon, error, held, change = leader.beacon, packet.position_error, packet.reference, packet.change
    return seal(
        _encoder.encode(
            _PeerWire(
                vehicle_id=sender.vehicle_id,
                session=sender.session,
                sequence=sender.sequence,
                formation_hash=sender.formation_hash,
                phase=packet.phase,
                role=packet.role,
                position_enu_m=motion.position_enu_m,
                velocity_enu_m_s=motion.velocity_enu_m_s,
                acceleration_enu_m_s2=motion.acceleration_enu_m_s2,
                state_age_s=motion.state_age_s,
                sent_s=motion.sent_s,
                prc=leader.prc,
                leader_beacon=_beacon_wire(beacon) if beacon else None,
                slot=astuple(packet.slot),
                position_error=astuple(error) if error else None,
                reference=astuple(held) if held else None,
                change=astuple(change) if change else None,
                armed=packet.armed,
                rft=packet.rft,
            )
        )
    )


def _beacon_wire(beacon: LeaderBeacon) -> _BeaconWire:
    heading = beacon.heading
    turns = None if heading == EAST else (heading.angle_rad, heading.rate_rad_s, heading.acceleration_rad_s2)
    return (beacon.leader_id, beacon.epoch, beacon.stamp, beacon.reference_s, beacon.claim, turns)


def _beacon_from(wire: _BeaconWire) -> LeaderBeacon:
    leader_id, epoch, stamp, reference_s, claim, turns = wire
    return LeaderBeacon(leader_id, epoch, stamp, reference_s, claim, Heading(*turns) if turns else EAST)


def decode_peer(data: bytes) -> PeerPacket:
    """The peer packet of a message. Checks form, version and sizes; `PeerTable` checks the values. Raises WireError."""
    wire = unsealed(_peer_decoder, data, Code.PEER_MALFORMED, "peer packet")
    beacon, error, held, change = wire.leader_beacon, wire.position_error, wire.reference, wire.change
    return PeerPacket(
        sender=Sender(wire.vehicle_id, wire.session, wire.sequence, wire.formation_hash),
        phase=wire.phase,
        role=wire.role,
        motion=Motion(
            position_enu_m=wire.position_enu_m,
            velocity_enu_m_s=wire.velocity_enu_m_s,
            acceleration_enu_m_s2=wire.acceleration_enu_m_s2,
            state_age_s=wire.state_age_s,
            sent_s=wire.sent_s,
        ),
        leader=LeaderReport(wire.prc, _beacon_from(beacon) if beacon else None),
        slot=FlownSlot(*wire.slot),
        position_error=PositionError(*error) if error else None,
        reference=HeldReference(*held) if held else None,
        change=FormationChange(*change) if change else None,
        armed=wire.armed,
        rft=wire.rft,
    )
