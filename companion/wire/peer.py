"""PeerPacket <-> bytes: a MessagePack array, so that 50 packets a second stay small on the air."""

from __future__ import annotations

import msgspec

from companion.types import (
    EAST,
    FlightPhase,
    FlownSlot,
    FormationChange,
    Heading,
    HeldReference,
    LeaderWord,
    PeerPacket,
    PositionError,
    Role,
    Vector3,
)
from companion.wire.version import DECODE_ERRORS, WireError, seal, unseal

_Word = tuple[int, int, int, float, int, tuple[float, float, float] | None]
"""Leader id, epoch, stamp, reference_s, claim, heading with its rate and acceleration; None to the east and still."""


class _PeerWire(msgspec.Struct, array_like=True, frozen=True, forbid_unknown_fields=True):
    vehicle_id: int
    session: int
    sequence: int
    formation_hash: int
    phase: FlightPhase
    role: Role
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3
    state_age_s: float
    sent_s: float
    prc: int
    leader_word: _Word | None
    slot: tuple[
        Vector3, Vector3, Vector3, int, int, bool
    ]  # position, velocity, acceleration, formation, waiting, moves
    position_error: tuple[float, float] | None  # horizontal_m, vertical_m
    reference: tuple[int, int, float] | None  # flown, waiting, begun_s
    change: tuple[int, tuple[tuple[int, Vector3], ...], float, float, tuple[int, ...]] | None  # as FormationChange
    armed: bool


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(_PeerWire)


def encode_peer(packet: PeerPacket) -> bytes:
    word, slot, error, held = packet.leader_word, packet.slot, packet.position_error, packet.reference
    change = packet.change
    return seal(
        _encoder.encode(
            _PeerWire(
                packet.vehicle_id,
                packet.session,
                packet.sequence,
                packet.formation_hash,
                packet.phase,
                packet.role,
                packet.position_enu_m,
                packet.velocity_enu_m_s,
                packet.acceleration_enu_m_s2,
                packet.state_age_s,
                packet.sent_s,
                packet.prc,
                _word_on_wire(word) if word else None,
                (
                    slot.position_enu_m,
                    slot.velocity_enu_m_s,
                    slot.acceleration_enu_m_s2,
                    slot.formation,
                    slot.waiting,
                    slot.moves,
                ),
                (error.horizontal_m, error.vertical_m) if error else None,
                (held.flown, held.waiting, held.begun_s) if held else None,
                (change.number, change.slots_enu_m, change.begins_s, change.lasts_s, change.absent) if change else None,
                packet.armed,
            )
        )
    )


def _word_on_wire(word: LeaderWord) -> _Word:
    heading = word.heading
    turns = None if heading == EAST else (heading.angle_rad, heading.rate_rad_s, heading.acceleration_rad_s2)
    return (word.leader_id, word.epoch, word.stamp, word.reference_s, word.claim, turns)


def _word_from(wire: _Word) -> LeaderWord:
    leader_id, epoch, stamp, reference_s, claim, turns = wire
    return LeaderWord(leader_id, epoch, stamp, reference_s, claim, Heading(*turns) if turns else EAST)


def decode_peer(data: bytes) -> PeerPacket:
    """Checks form and version only; what the numbers may be is `core/peers.py`'s. Raises WireError."""
    try:
        wire = _decoder.decode(unseal(data))
    except DECODE_ERRORS as error:
        raise WireError("malformed peer packet") from error
    return PeerPacket(
        wire.vehicle_id,
        wire.session,
        wire.sequence,
        wire.formation_hash,
        wire.phase,
        wire.role,
        wire.position_enu_m,
        wire.velocity_enu_m_s,
        wire.acceleration_enu_m_s2,
        wire.state_age_s,
        wire.sent_s,
        wire.prc,
        _word_from(wire.leader_word) if wire.leader_word else None,
        FlownSlot(*wire.slot),
        PositionError(*wire.position_error) if wire.position_error else None,
        HeldReference(*wire.reference) if wire.reference else None,
        FormationChange(*wire.change) if wire.change else None,
        wire.armed,
    )
