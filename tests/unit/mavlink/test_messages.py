"""The project's dialect beside pymavlink's: the messages in use are the same, and all others pass as they came."""

from __future__ import annotations

from typing import Any

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common, development

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, OtherMessage, PacketReader, SigningKey, mavlink

IN_USE = sorted(id_ for id_, kind in mavlink.mavlink_map.items() if isinstance(kind, type))
OTHERS = sorted(set(mavlink.mavlink_map) - set(IN_USE))
SECRET = bytes(range(32))
BYTE = st.integers(0, 255)
CASES = settings(max_examples=300)


def of_pymavlink(packet: bytes) -> MavlinkMessage:
    return development.MAVLink(None).decode(bytearray(packet))


def packed(message_id: int, payload: bytes, sequence: int, system: int) -> bytes:
    """A MAVLink 2 packet of this message. Zeros at the end of the payload are not sent."""
    payload = payload.rstrip(b"\0") or b"\0"
    header = bytes((len(payload), 0, 0, sequence, system, 1)) + message_id.to_bytes(3, "little")
    extra = bytes((development.mavlink_map[message_id].crc_extra,))
    return b"\xfd" + header + payload + mcrf4xx(header + payload + extra).to_bytes(2, "little")


@st.composite
def other_packets(draw: st.DrawFn) -> bytes:
    message_id = draw(st.sampled_from(OTHERS))
    size = development.mavlink_map[message_id].unpacker.size
    return packed(message_id, draw(st.binary(min_size=1, max_size=size)), draw(BYTE), draw(BYTE))


def read(packet: bytes) -> list[MavlinkMessage]:
    return [packet.message for packet in PacketReader().read(packet)]


def test_every_message_is_known() -> None:
    assert set(mavlink.mavlink_map) >= set(common.mavlink_map)


@pytest.mark.parametrize("message_id", IN_USE)
def test_a_message_in_use_has_the_fields_of_pymavlink(message_id: int) -> None:
    ours: Any = mavlink.mavlink_map[message_id]
    theirs = development.mavlink_map[message_id]
    known = len(ours.fieldnames)  # a later MAVLink may add extensions
    assert (ours.msgname, ours.crc_extra) == (theirs.msgname, theirs.crc_extra)
    assert ours.fieldnames == theirs.fieldnames[:known]
    assert ours.fieldtypes == theirs.fieldtypes[:known]
    assert ours.orders == theirs.orders[:known]
    assert theirs.unpacker.format.startswith(ours.unpacker.format)


def test_names_have_the_values_of_pymavlink() -> None:
    ours = {entry.name: value for enum in mavlink.enums.values() for value, entry in enum.items()}
    kept = [name for name in ours if not name.endswith("_ENUM_END")]
    assert len(kept) > 200
    assert {name: ours[name] for name in kept} == {name: getattr(development, name) for name in kept}


@CASES
@given(other_packets())
def test_another_message_passes_as_it_came(packet: bytes) -> None:
    (message,), known = read(packet), of_pymavlink(packet)
    assert isinstance(message, OtherMessage)
    assert (message.get_msgId(), message.get_type()) == (known.get_msgId(), known.get_type())
    assert bytes(message.get_msgbuf()) == packet
    assert vars(message.get_header()) == vars(known.get_header())
    assert getattr(message, "target_system", None) == getattr(known, "target_system", None)
    assert PacketReader().read(packet[:-1] + bytes((packet[-1] ^ 1,))) == []


@CASES
@given(other_packets())
def test_another_message_is_sent_on_with_the_same_payload(packet: bytes) -> None:
    sender = development.MAVLink(None, srcSystem=7, srcComponent=191)
    assert MavlinkCodec(7, 191).encode(*read(packet)) == of_pymavlink(packet).pack(sender)


@CASES
@given(other_packets())
def test_another_message_is_signed_and_refused_like_any(packet: bytes) -> None:
    key = SigningKey(SECRET, 1, lambda: 1.8e9)
    signed = MavlinkCodec(7, 191, key).encode(*read(packet))
    receiver = MavlinkCodec(1, 1, SigningKey(SECRET, 2, lambda: 1.8e9))
    assert [message.get_type() for message in receiver.decode(signed)] == [of_pymavlink(packet).get_type()]
    stranger = MavlinkCodec(1, 1, SigningKey(bytes(32), 2, lambda: 1.8e9))
    assert stranger.decode(signed) == [] and stranger.refused.total() == 1
    assert receiver.decode(packet) == [] and receiver.refused.total() == 1


@CASES
@given(st.sampled_from([id_ for id_ in OTHERS if id_ < 256]), st.data())
def test_another_message_of_mavlink_1_passes(message_id: int, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=1, max_size=development.mavlink_map[message_id].unpacker.size))
    header = bytes((len(payload), 0, 1, 1, message_id))
    extra = bytes((development.mavlink_map[message_id].crc_extra,))
    packet = b"\xfe" + header + payload + mcrf4xx(header + payload + extra).to_bytes(2, "little")
    (message,) = read(packet)
    assert (message.get_msgId(), bytes(message.get_msgbuf())) == (message_id, packet)
