"""The messages of vehicles and ground: peer packets, reports, commands, replies, targets, traffic, in MessagePack.

The first byte of every message is the wire version; MessagePack follows. So a receiver can distinguish another version from a
damaged message, whatever the format of that version. Maps are easily written in any language, as a sender of targets or a
receiver of ADS-B needs it.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec.structs import astuple

from companion.types.autopilot import PositionError
from companion.types.commands import CONTENT, Command, CommandReply, ReferenceChange
from companion.types.errors import CompanionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import EAST, FlownSlot, FormationChange, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import (
    MOST_LOST,
    MOST_VALUES,
    BodyPose,
    LeaderReport,
    LostAge,
    LostVehicle,
    Motion,
    PeerPacket,
    Sender,
    TargetSample,
    TermProof,
    TermSignature,
    TrafficSample,
)
from companion.types.rejections import rejection_key
from companion.types.status import Status
from companion.types.values import (
    ChangeDuration,
    Finite,
    FlatForm,
    MissionTime,
    Number,
    Place,
    Position,
    SlotsOfAll,
    Vector3,
    VehicleId,
    VehicleIds,
)

WIRE_VERSION = 11

T = TypeVar("T")

# All that msgspec raises for malformed bytes: invalid UTF-8 and deep nesting have their own errors.
DECODE_ERRORS = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
_PLACE = re.compile(r" - at `(\$[\w.\[\]]{1,60})`$")


class WireError(CompanionError):
    """A message that cannot be decoded. `str()` is the reason; `key` is the counter of such rejections."""

    def __init__(self, code: Code, text: str, detail: int | None = None) -> None:
        super().__init__(text)
        self.code = code
        self.key = rejection_key(code, detail)


def seal(payload: bytes) -> bytes:
    """The payload with the version byte before it."""
    return bytes((WIRE_VERSION,)) + payload


def decode_sealed(decoder: msgspec.msgpack.Decoder[T], data: bytes, code: Code, what: str) -> T:
    """The decoded message, with all values within the bounds of their types.

    Raises WireError, for a malformed message of this code. It names the place of the wrong value, never the value: that may
    be any text.
    """
    if not data:
        raise WireError(Code.MESSAGE_EMPTY, "empty message")
    if data[0] != WIRE_VERSION:
        raise WireError(Code.WIRE_VERSION_DIFFERS, f"wire version {data[0]}, expected {WIRE_VERSION}", data[0])
    try:
        return decoder.decode(memoryview(data)[1:])
    except DECODE_ERRORS as error:
        place = _PLACE.search(str(error))
        raise WireError(code, f"malformed {what}" + (f" at {place[1]}" if place else "")) from error


class Percentiles(msgspec.Struct, frozen=True, gc=False):
    """Of one measured time in microseconds."""

    p50: Finite
    p99: Finite
    max: Finite


class Timing(msgspec.Struct, frozen=True, gc=False):
    """How well an agent keeps its 50 Hz, counted since it entered formation (or since its start).

    `late_us`: start of a tick after its due time, one period after the tick before. `missed`: periods without a tick,
    that is how many more periods went by than ticks came; it never falls.
    `telemetry_to_command_us`: from a position's arrival at the socket to its setpoint handed to the socket.
    """

    rate_hz: Finite
    ticks: Number
    missed: Number
    late_us: Percentiles
    telemetry_to_command_us: Percentiles
    cpu_percent: Finite
    rss_mb: Finite


class StatusReport(msgspec.Struct, frozen=True, gc=False):
    """One vehicle's status with its timing."""

    status: Status
    timing: Timing


STATUS_FORM = FlatForm(Status)
FlatReport: type[Any] = msgspec.defstruct(
    "StatusReport", [("status", STATUS_FORM.type), ("timing", Timing)], frozen=True, gc=False
)
"""A StatusReport as it is in bytes: its status without parts."""


def flat_report(report: StatusReport) -> Any:
    return FlatReport(STATUS_FORM.flat(report.status), report.timing)


def report_of(flat: Any) -> StatusReport:
    """The report of a FlatReport."""
    return StatusReport(STATUS_FORM.whole(flat.status), flat.timing)


_encoder = msgspec.msgpack.Encoder()
_report_decoder = msgspec.msgpack.Decoder(FlatReport)
_command_decoder = msgspec.msgpack.Decoder(Command)
_reply_decoder = msgspec.msgpack.Decoder(CommandReply)


def encode(message: StatusReport | Command | CommandReply | TargetSample | TrafficSample | BodyPose) -> bytes:
    """The message as a MessagePack map behind the version byte."""
    return seal(_encoder.encode(flat_report(message) if isinstance(message, StatusReport) else message))


def decode_report(data: bytes) -> StatusReport:
    """Raises WireError."""
    return report_of(decode_sealed(_report_decoder, data, Code.REPORT_MALFORMED, "status report"))


def decode_command(data: bytes) -> Command:
    """Raises WireError."""
    command = decode_sealed(_command_decoder, data, Code.COMMAND_MALFORMED, "command")
    wanted = CONTENT.get(command.name, type(None))
    if not isinstance(command.content, wanted):
        raise WireError(
            Code.COMMAND_MALFORMED,
            f"command {command.name} with {type(command.content).__name__}, expected {wanted.__name__}",
        )
    if isinstance(command.content, ReferenceChange):
        for value in command.content.reference.values():
            if isinstance(value, str) and not value.isprintable():  # it is part of replies and logs
                raise WireError(Code.COMMAND_MALFORMED, "command reference with control characters")
    return command


def decode_reply(data: bytes) -> CommandReply:
    """Raises WireError."""
    return decode_sealed(_reply_decoder, data, Code.REPORT_MALFORMED, "command reply")


_target_decoder = msgspec.msgpack.Decoder(TargetSample)


def decode_target(data: bytes) -> TargetSample:
    """The target sample of a message. Checks only form and version; `Targets` checks the values. Raises WireError."""
    return decode_sealed(_target_decoder, data, Code.TARGET_MALFORMED, "target sample")


_traffic_decoder = msgspec.msgpack.Decoder(TrafficSample)


def decode_traffic(data: bytes) -> TrafficSample:
    """The traffic sample of a message, every number within its bounds. Raises WireError."""
    return decode_sealed(_traffic_decoder, data, Code.TRAFFIC_MALFORMED, "traffic sample")


_pose_decoder = msgspec.msgpack.Decoder(BodyPose)


def decode_pose(data: bytes) -> BodyPose:
    """The pose of a message, every number within its bounds; `PoseJudge` checks the rest. Raises WireError."""
    return decode_sealed(_pose_decoder, data, Code.POSE_MALFORMED, "pose")


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
    term_proof: tuple[Number, TermSignature] | None
    home_enu_m: Place | None
    lost: Annotated[tuple[tuple[VehicleId, Position, Vector3, LostAge], ...], msgspec.Meta(max_length=MOST_LOST)]
    law_values: Annotated[tuple[Vector3, ...], msgspec.Meta(max_length=MOST_VALUES)]


_peer_decoder = msgspec.msgpack.Decoder(_PeerWire)


def encode_peer(packet: PeerPacket) -> bytes:
    """The message for a peer packet."""
    sender, motion, leader = packet.sender, packet.motion, packet.leader
    beacon, error, held, change = leader.beacon, packet.position_error, packet.reference, packet.change
    proof = leader.proof
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
                term_proof=(proof.session, proof.signature) if proof else None,
                home_enu_m=packet.home_enu_m,
                lost=tuple([astuple(lost) for lost in packet.lost]) if packet.lost else (),
                law_values=packet.law_values,
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
    wire = decode_sealed(_peer_decoder, data, Code.PEER_MALFORMED, "peer packet")
    beacon, error, held, change = wire.leader_beacon, wire.position_error, wire.reference, wire.change
    proof = TermProof(*wire.term_proof) if wire.term_proof else None
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
        leader=LeaderReport(wire.prc, _beacon_from(beacon) if beacon else None, proof),
        slot=FlownSlot(*wire.slot),
        position_error=PositionError(*error) if error else None,
        reference=HeldReference(*held) if held else None,
        change=FormationChange(*change) if change else None,
        armed=wire.armed,
        rft=wire.rft,
        home_enu_m=wire.home_enu_m,
        lost=tuple([LostVehicle(*lost) for lost in wire.lost]) if wire.lost else (),
        law_values=wire.law_values,
    )
