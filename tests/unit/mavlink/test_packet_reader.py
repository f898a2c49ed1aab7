"""Packets among garbage: each good packet is found, and an incomplete one swallows none."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink.codec import MOST_DAMAGED, MavlinkCodec, PacketReader, mavlink
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
