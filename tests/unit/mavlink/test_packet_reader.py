"""Packets among garbage: each good packet is found, and an incomplete one swallows none."""

from __future__ import annotations

import random

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink.codec import MOST_DAMAGED, MavlinkCodec, PacketReader, SigningKey, mavlink
from companion.types.notices import Code

POSITIONS = 2000
HALVES = st.sampled_from([1, 2, 3, 9, 10, 11, 30])


def positions(count: int) -> list[bytes]:
    sender = MavlinkCodec(1, 1)
    return [sender.encode(mavlink.MAVLink_local_position_ned_message(n, n, 0, 0, 0, 0, 1.0)) for n in range(count)]


def received_times(codec: MavlinkCodec, datagrams: list[bytes]) -> list[int]:
    return [message.time_boot_ms for datagram in datagrams for message in codec.decode(datagram)]


@pytest.mark.parametrize(
    "garbage",
    [
        b"\xfd\xff\x00",
        b"\xfd\xff",
        b"\xfe",
        b"\xfd" * 40,
        b"\xfd\xff\x00\x00\x00\x01\x01\xab\xcd\xef" + b"x" * 90,
        b"GET /",
    ],
)
def test_garbage_behind_a_packet_swallows_no_other(garbage: bytes) -> None:
    datagrams = [packet + garbage for packet in positions(POSITIONS)]
    codec = MavlinkCodec(1, 191)
    assert received_times(codec, datagrams) == list(range(POSITIONS))
    assert codec.refused[Code.MAVLINK_UNREADABLE] >= POSITIONS - 1


def test_random_garbage_behind_every_packet_swallows_none() -> None:
    generator = random.Random(1)
    datagrams = [packet + generator.randbytes(generator.randrange(1, 60)) for packet in positions(POSITIONS)]
    assert received_times(MavlinkCodec(1, 191), datagrams) == list(range(POSITIONS))


@given(st.lists(st.binary(max_size=40).filter(lambda noise: not {0xFD, 0xFE} & set(noise)), max_size=8), HALVES)
def test_every_packet_is_found_where_chunks_are_cut_anywhere(noises: list[bytes], size: int) -> None:
    packets = positions(len(noises))
    stream = b"".join(noise + packet for noise, packet in zip(noises, packets, strict=True))
    chunks = [stream[at : at + size] for at in range(0, len(stream), size)]
    assert received_times(MavlinkCodec(1, 191), chunks) == list(range(len(noises)))


def test_a_damaged_packet_costs_only_itself() -> None:
    packets = positions(3)
    damaged = bytearray(packets[1])
    damaged[1] = 200  # claims to be longer than it is
    stream = packets[0] + bytes(damaged) + packets[2] * 12
    assert received_times(MavlinkCodec(1, 191), [stream]) == [0, *[2] * 12]


def test_an_unknown_packet_is_kept_and_an_invented_one_is_garbage() -> None:
    unknown = bytearray(positions(1)[0])
    unknown[7:10] = b"\xab\xcd\xef"
    reader = PacketReader()
    kinds = [packet.message_id for packet in reader.read(bytes(unknown) + positions(1)[0])]
    assert kinds == [mavlink.MAVLINK_MSG_ID_UNKNOWN, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED]
    assert not reader.refused
    unknown[1] += 20  # it now claims the first bytes of the next one
    kinds = [packet.message_id for packet in reader.read(bytes(unknown) + positions(1)[0])]
    assert kinds == [mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED]


def unknown_packet() -> bytes:
    packet = bytearray(positions(1)[0])
    packet[7:10] = b"\xab\xcd\xef"
    return bytes(packet)


def test_packets_of_unknown_ids_wait_until_a_known_one_follows() -> None:
    reader, unknown, known = PacketReader(), unknown_packet(), positions(1)[0]
    assert reader.read(known + unknown) != []
    assert reader.read(unknown) == []
    assert [packet.data for packet in reader.read(known)] == [unknown, unknown, known]
    assert reader.is_between_packets
    assert not reader.refused


@pytest.mark.parametrize("before", [b"x", b"\xfd", b"\xfe\x00"])
def test_a_packet_of_unknown_id_without_a_certain_begin_or_end_is_passed_to_nobody(before: bytes) -> None:
    unknown, known = unknown_packet(), positions(1)[0]
    for stream in (before + unknown + known, unknown + before + known, unknown[:-1] + known):
        assert [packet.data for packet in PacketReader().read(stream + known * 9)] == [known] * 10


def test_a_stream_of_unknown_ids_alone_is_not_kept_for_ever() -> None:
    reader = PacketReader()
    assert [reader.read(unknown_packet()) for _ in range(200)] == [[]] * 200
    assert reader.refused[Code.MAVLINK_UNREADABLE] > 0
    assert len(reader.read(positions(1)[0] * 2)) >= 2


@st.composite
def packets_in_a_payload(draw: st.DrawFn) -> bytes:
    """A packet of TUNNEL, whose payload has whole packets of others, with one bit of it wrong."""
    first = mavlink.MAVLink_heartbeat_message(2, 3, 4, 5, 6, 3).pack(
        mavlink.MAVLink(None, srcSystem=draw(st.integers(1, 250))), force_mavlink1=draw(st.booleans())
    )
    inner = draw(st.binary(max_size=20)) + bytes(first) * draw(st.integers(1, 4)) + draw(st.binary(max_size=20))
    header = bytes((len(inner) + 5, 0, 0, 1, 1, 1)) + (385).to_bytes(3, "little")
    outer = bytearray(b"\xfd" + header + b"\1\1\0\0" + bytes((len(inner),)) + inner + b"\0\0")
    outer[-2:] = (mcrf4xx(bytes(outer[1:-2]) + b"\x93") ^ 1 << draw(st.integers(0, 15))).to_bytes(2, "little")
    return bytes(outer)


@given(packets_in_a_payload(), st.sampled_from([1, 2, 3, 9, 10, 11]))  # a chunk that is a packet counts as one
def test_what_a_damaged_packet_carries_is_no_packet(damaged: bytes, size: int) -> None:
    good = positions(20)  # a seeming packet of 280 bytes waits for so many
    stream = good[0] + damaged + b"".join(good[1:])
    for step in (size, len(stream)):
        reader = PacketReader()
        chunks = [stream[at : at + step] for at in range(0, len(stream), step)]
        assert [packet.data for chunk in chunks for packet in reader.read(chunk)] == good


def test_a_packet_whose_second_half_begins_with_what_it_carries_is_whole() -> None:
    heartbeat = bytes(mavlink.MAVLink_heartbeat_message(2, 3, 4, 5, 6, 3).pack(mavlink.MAVLink(None, srcSystem=9)))
    inner = heartbeat * 2
    outer = b"\xfd" + bytes((len(inner) + 5, 0, 0, 1, 1, 1)) + (385).to_bytes(3, "little")
    outer += b"\1\1\0\0" + bytes((len(inner),)) + inner
    outer += mcrf4xx(outer[1:] + b"\x93").to_bytes(2, "little")
    reader, at = PacketReader(), outer.index(heartbeat)
    assert [packet.data for half in (outer[:at], outer[at:]) for packet in reader.read(half)] == [outer]


def test_a_signed_link_passes_no_packet_of_unknown_id_without_a_signature() -> None:
    codec = MavlinkCodec(1, 191, SigningKey(bytes(range(32)), 1, lambda: 1.8e9))
    sender = MavlinkCodec(1, 1, SigningKey(bytes(range(32)), 2, lambda: 1.8e9))
    known = sender.encode(mavlink.MAVLink_heartbeat_message(2, 3, 4, 5, 6, 3))
    codec.read(unknown_packet() + known)
    assert [packet.data for packet in codec.packets] == [known]


def test_work_per_call_is_bounded() -> None:
    damaged = bytearray(positions(1)[0])
    damaged[-1] ^= 0xFF
    reader = PacketReader()
    assert reader.read(bytes(damaged) * (MOST_DAMAGED + 1) + positions(1)[0]) == []
    assert len(reader.read(positions(1)[0])) == 1


@given(st.lists(st.binary(max_size=600), max_size=6))
def test_arbitrary_bytes_never_raise(chunks: list[bytes]) -> None:
    codec = MavlinkCodec(1, 191)
    for chunk in chunks:
        codec.decode(b"\xfd" + chunk)
    assert len(codec.decode(positions(1)[0])) == 1
