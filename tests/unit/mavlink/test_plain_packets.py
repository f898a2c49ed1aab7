"""Packets read and made without pymavlink: the same messages, the same bytes, the same refusals as pymavlink's own."""

from __future__ import annotations

from typing import Any

from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mavlink.codec import MavlinkMessage, Packet, PacketReader, encode_plain, mavlink, read_plain

HOT = (
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE,
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
)
BYTE = st.integers(0, 255)
MESSAGE_IDS = st.sampled_from(HOT) | st.sampled_from(sorted(mavlink.mavlink_map)) | st.integers(0, 2**24 - 1)
MESSAGES = settings(max_examples=400)


def built(message_id: int, payload: bytes, sequence: int, system: int, flags: int, compatible: int) -> bytes:
    """A packet with a good checksum, and thirteen bytes of a signature where the flags announce one."""
    header = bytes((len(payload), flags, compatible, sequence, system, 1)) + message_id.to_bytes(3, "little")
    known = mavlink.mavlink_map.get(message_id)
    extra = bytes((known.crc_extra if known else 0,))
    checksum = mcrf4xx(header + payload + extra).to_bytes(2, "little")
    return b"\xfd" + header + payload + checksum + bytes(13 if flags & 1 else 0)


FLAGS = st.sampled_from((0, 0, 0, 0, 1, 2))
PACKETS = st.builds(built, MESSAGE_IDS, st.binary(max_size=255), BYTE, BYTE, FLAGS, BYTE)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A packet with one byte changed, cut off, or followed by more."""
    packet = bytearray(draw(PACKETS))
    at = draw(st.integers(0, len(packet) - 1))
    match draw(st.sampled_from(("changed", "cut", "longer"))):
        case "changed":
            packet[at] ^= draw(st.integers(1, 255))
        case "cut":
            del packet[at:]
        case "longer":
            packet += draw(st.binary(min_size=1, max_size=30))
    return bytes(packet)


def content(message: MavlinkMessage) -> dict[str, Any]:
    """All attributes, comparable: bytes of any type, NaN, and the header's own attributes."""
    found = {name: repr(bytes(v) if isinstance(v, bytearray) else v) for name, v in vars(message).items()}
    found["_header"] = repr(vars(message.get_header()))
    return {"type": type(message).__name__} | found


def of_pymavlink(packet: bytes) -> dict[str, Any] | None:
    try:
        return content(mavlink.MAVLink(None).decode(bytearray(packet)))
    except mavlink.MAVError:
        return None


@MESSAGES
@given(PACKETS)
def test_a_message_is_that_of_pymavlink(packet: bytes) -> None:
    assert (plain := read_plain(packet)) is None or content(plain.message) == of_pymavlink(packet)


@MESSAGES
@given(damaged() | st.binary(max_size=300))
def test_what_pymavlink_refuses_is_no_message(data: bytes) -> None:
    assert (plain := read_plain(data)) is None or content(plain.message) == of_pymavlink(data)


@given(st.sampled_from(HOT), st.binary(min_size=1, max_size=60), BYTE)
def test_the_messages_of_a_flight_are_read_without_pymavlink(message_id: int, payload: bytes, sequence: int) -> None:
    packet = built(message_id, payload, sequence, 1, 0, 0)
    assert read_plain(packet) is not None
    assert read_plain(packet[:-1] + bytes((packet[-1] ^ 1,))) is None


@given(st.sampled_from(HOT), st.binary(min_size=1, max_size=60), st.booleans())
def test_values_are_the_fields_of_the_message_in_their_order_on_the_wire(
    message_id: int, payload: bytes, by_pymavlink: bool
) -> None:
    reader = reader_of_pymavlink() if by_pymavlink else PacketReader(mavlink.MAVLink(None))
    (packet,) = reader.read(built(message_id, payload, 0, 1, 0, 0))
    message = mavlink.MAVLink(None).decode(bytearray(packet.data))
    fields = (getattr(message, name) for name in message.ordered_fieldnames)
    expected = [number for field in fields for number in (field if isinstance(field, list) else [field])]
    assert repr(packet.values) == repr(tuple(expected))  # NaN too


@MESSAGES
@given(st.sampled_from(HOT) | st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(max_size=255), BYTE, BYTE)
def test_a_packet_is_that_of_pymavlink(message_id: int, payload: bytes, sequence: int, system: int) -> None:
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=191)
    message = mav.decode(bytearray(built(message_id, payload, 0, 1, 0, 0)))
    mav.seq = sequence
    packet = encode_plain(message, mav)
    assert packet == message.pack(mav) if message_id in HOT else packet in (None, message.pack(mav))


def facts(packet: Packet) -> tuple[object, ...]:
    return packet.data, packet.message_id, packet.system_id, packet.component_id, packet.is_signed


def reader_of_pymavlink() -> PacketReader:
    """A reader whose packets all pass through pymavlink: with a key, and unsigned packets accepted."""
    mav = mavlink.MAVLink(None)
    mav.signing.secret_key = bytes(32)
    mav.signing.allow_unsigned_callback = lambda _mav, _message_id: True
    return PacketReader(mav)


@settings(max_examples=300)
@given(st.lists(PACKETS | damaged() | st.binary(max_size=40), max_size=8), st.sampled_from((0, 1, 7, 30, 200)))
def test_a_stream_gives_the_messages_and_refusals_of_pymavlink(parts: list[bytes], size: int) -> None:
    stream = b"".join(parts)
    chunks = [stream[at : at + size] for at in range(0, len(stream), size)] if size else parts
    fast, slow = PacketReader(mavlink.MAVLink(None)), reader_of_pymavlink()
    for chunk in chunks:
        quick, judged = fast.read(chunk), slow.read(chunk)
        assert [content(packet.message) for packet in quick] == [content(packet.message) for packet in judged]
        assert [facts(packet) for packet in quick] == [facts(packet) for packet in judged]
        assert fast.refused == slow.refused
        assert fast.is_between_packets == slow.is_between_packets
