"""Who sends on the autopilot's link: radios, ground stations, other autopilots, and two with one system id."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from agent_on_bytes import ARDUPILOT, BOTH, HOLD, MAV_AUTOPILOT, PX4, AutopilotOnBytes, FlightOnBytes
from companion.mavlink.codec import MavlinkCodec, SigningKey, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind, HeartbeatSample
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code

M, C = mavlink, CommandName
RATE_HZ = 50.0


class Stream:
    """An autopilot's packets, from this sequence number and this time of its clock on."""

    def __init__(self, sequence: int, boot_ms: int) -> None:
        self._mav = M.MAVLink(None, srcSystem=3, srcComponent=1)
        self._mav.seq, self._boot_ms = sequence, boot_ms

    def batch(self) -> list[bytes]:
        """What it sends in one period of 50 Hz."""
        self._boot_ms += 20
        messages = [
            M.MAVLink_heartbeat_message(M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[PX4], 0, HOLD[PX4], 4, 3),
            M.MAVLink_attitude_quaternion_message(self._boot_ms, 1, 0, 0, 0, 0, 0, 0),
            M.MAVLink_local_position_ned_message(self._boot_ms, self._boot_ms / 1e3, 0, 0, 0, 0, 0),
        ]
        return [self._packed(message) for message in messages]

    def _packed(self, message: M.MAVLink_message) -> bytes:
        packed: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed


def interleaves(batches: Iterable[Iterable[bytes]]) -> bool:
    """Whether the HEARTBEATs of this link, one batch each 20 ms, ever say so."""
    translator, now_s, found = Translator(3), 100.0, False
    for batch in batches:
        now_s += 1.0 / RATE_HZ
        for packet in batch:
            beats = [s for s in translator.telemetry(packet, now_s) if isinstance(s, HeartbeatSample)]
            found = found or any(beat.interleaves for beat in beats)
    return found


def two(other: Stream, seconds: float = 2.0) -> Iterator[list[bytes]]:
    own = Stream(0, 60_000)
    for _ in range(round(seconds * RATE_HZ)):
        yield own.batch()
        yield other.batch()


@given(st.integers(0, 255), st.integers(0, 120_000))
def test_two_autopilots_with_one_id_are_seen_whatever_their_numbers_and_clocks(sequence: int, boot_ms: int) -> None:
    assert interleaves(two(Stream(sequence, boot_ms)))


@pytest.mark.parametrize("boot_ms", [60_000, 60_001, 59_990, 60_300])
def test_two_that_were_switched_on_together_are_seen(boot_ms: int) -> None:
    assert interleaves(two(Stream(0, boot_ms)))


@pytest.mark.parametrize("sequence", range(0, 256, 16))
def test_one_autopilot_on_a_bad_link_is_one(sequence: int) -> None:
    """A third of the packets is lost, each hundredth comes twice, one in a hundred too late, and at times nothing comes."""
    chance = Random(sequence).random
    stream = Stream(sequence, 60_000)
    sent = [batch for at in range(500) if (batch := stream.batch()) and at % 100 > 25]
    packets = [packet for batch in sent for packet in batch if chance() > 0.33]
    packets = [again for packet in packets for again in [packet] * (2 if chance() < 0.01 else 1)]
    for at, (before, after) in enumerate(pairwise(packets)):
        if at % 100 == 0:
            packets[at], packets[at + 1] = after, before
    assert not interleaves([packet] for packet in packets)


def test_a_reboot_is_no_second_autopilot() -> None:
    before, after = Stream(0, 60_000), Stream(0, 0)
    assert not interleaves([before.batch() for _ in range(100)] + [after.batch() for _ in range(100)])


def test_the_other_one_gone_the_autopilot_is_one_again() -> None:
    own, translator = Stream(0, 60_000), Translator(3)
    batches = [*two(Stream(90, 60_200)), *[own.batch() for _ in range(200)]]
    samples = [translator.telemetry(b"".join(batch), 0.02 * at) for at, batch in enumerate(batches)]
    beats = [s.interleaves for each in samples for s in each if isinstance(s, HeartbeatSample)]
    assert beats[150]
    assert not beats[-1]


# ---------------------------------------------------------------- from two addresses


def beside(own_at_s: Iterable[float], other_at_s: Iterable[float], other: bytes) -> list[float]:
    """When the HEARTBEATs of the followed address said that another one sends too. Only HEARTBEATs are sent."""
    translator, own = Translator(3, PX4), beat(3, 1, M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[PX4])
    found = []
    for now_s, is_own in sorted([*((t, True) for t in own_at_s), *((t, False) for t in other_at_s)]):
        if not is_own:
            translator.receive_beside(other, now_s)
        elif any(s.interleaves for s in translator.telemetry(own, now_s) if isinstance(s, HeartbeatSample)):
            found.append(now_s)
    return found


def times(begin_s: float, end_s: float, rate_hz: float) -> list[float]:
    return [begin_s + step / rate_hz for step in range(round((end_s - begin_s) * rate_hz))]


@pytest.mark.parametrize("rate_hz", [1.0, 4.0, 50.0])
@pytest.mark.parametrize("own_hz", [1.0, 50.0])
def test_two_with_one_id_are_seen_though_one_address_is_followed(own_hz: float, rate_hz: float) -> None:
    found = beside(times(0.0, 30.0, own_hz), times(10.01, 20.0, rate_hz), beat(3, 1, M.MAV_TYPE_QUADROTOR, 12))
    assert 10.01 < found[0] < 14.0
    assert 19.0 < found[-1] < 25.0  # and no longer, as the other one is gone


def test_a_router_that_starts_again_at_another_port_is_no_second_autopilot() -> None:
    """The old port is silent from then on; the link follows the new one after a while."""
    same = beat(3, 1, M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[PX4])
    assert beside([*times(0.0, 10.0, 50.0), *times(15.2, 20.0, 50.0)], times(10.01, 15.0, 50.0), same) == []


@pytest.mark.parametrize(
    "other",
    [b"", b"\xfd" * 300, b"\xfe\x00\x00\x03\x01\x00\x00\x00"],  # the last with a wrong checksum
)
def test_what_is_no_packet_of_the_autopilot_is_no_second_one(other: bytes) -> None:
    assert beside(times(0.0, 20.0, 50.0), times(0.01, 20.0, 5.0), other) == []


@pytest.mark.parametrize(("system_id", "component_id"), [(4, 1), (3, 191), (255, 190)])
def test_others_at_another_address_are_none_with_this_id(system_id: int, component_id: int) -> None:
    other = beat(system_id, component_id, M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[PX4])
    assert beside(times(0.0, 20.0, 50.0), times(0.01, 20.0, 5.0), other) == []


def test_on_a_signed_link_a_stranger_is_no_second_autopilot() -> None:
    key = SigningKey(bytes([7] * 32), 1, lambda: 1_800_000_000.0)
    translator, own = Translator(3, PX4, key), MavlinkCodec(3, 1, key)
    message = M.MAVLink_heartbeat_message(M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[PX4], 0, HOLD[PX4], 4, 3)
    forged = MavlinkCodec(3, 1, SigningKey(bytes([8] * 32), 1, key.unix_time_s))
    for step in range(100):
        (sample, _) = translator.telemetry(own.encode(message), 0.1 * step)
        assert isinstance(sample, HeartbeatSample)
        assert not sample.interleaves
        translator.receive_beside(forged.encode(message), 0.1 * step + 0.05)
    assert (translator.rejected, translator.refused_signature) == ({}, None)  # it is not this autopilot that errs


# ---------------------------------------------------------------- in flight


class Pair(AutopilotOnBytes):
    """Two autopilots with one system id behind one port; both obey. The other one was switched on earlier by this time."""

    def __init__(self, kind: AutopilotKind, earlier_s: float) -> None:
        super().__init__(kind)
        self.earlier_s = earlier_s
        self.other: AutopilotOnBytes | None = AutopilotOnBytes(kind)

    def send_at(self, now_s: float) -> bytes:
        theirs = self.other.send_at(now_s + self.earlier_s) if self.other else b""
        return theirs + super().send_at(now_s)

    def receive(self, data: bytes) -> None:
        if self.other:
            self.other.receive(data)
        super().receive(data)


@BOTH
@pytest.mark.parametrize("earlier_s", [0.0, 0.3, -0.01, 40.0])
def test_arm_is_refused_while_two_autopilots_answer_to_one_id(kind: AutopilotKind, earlier_s: float) -> None:
    flight = FlightOnBytes(kind)
    flight.autopilot = pair = Pair(kind, earlier_s)
    flight.ticks(4.0)
    assert_refused(flight, C.PREPARE)
    assert flight.status is not None
    assert Code.AUTOPILOT_ID_SHARED in [notice.code for notice in flight.status.safety.lacks]
    other, pair.other = pair.other, None  # it has its own id now
    flight.ticks(5.0)
    assert flight.do(C.PREPARE) is FlightPhase.READY
    pair.other = other
    flight.ticks(2.0)
    assert_refused(flight, C.ARM)
    assert not pair.armed


def assert_refused(flight: FlightOnBytes, name: CommandName) -> None:
    flight.tick(name)
    accepted, code, reason = flight.replies[-1]
    assert (accepted, code) == (False, Code.AUTOPILOT_ID_SHARED)
    assert "two streams with this system id" in reason


# ---------------------------------------------------------------- others


def beat(system_id: int, component_id: int, kind: int, autopilot: int) -> bytes:
    message = M.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)
    return MavlinkCodec(system_id, component_id).encode(message)


def radio_status() -> bytes:
    """As a SiK radio inserts it, never signed."""
    radio = common.MAVLink(None, srcSystem=51, srcComponent=68)
    packed: bytes = common.MAVLink_radio_status_message(200, 200, 90, 20, 20, 0, 0).pack(radio)
    return packed


GROUND_STATION = beat(255, 190, M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID)
ARDUPILOT_S_OWN = beat(
    250, 1, M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID
)  # a ground station with an autopilot's component
COMPANION = beat(7, 191, M.MAV_TYPE_ONBOARD_CONTROLLER, M.MAV_AUTOPILOT_INVALID)
OTHER_AUTOPILOT = beat(7, 1, M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[ARDUPILOT])


@pytest.mark.parametrize(
    ("packets", "autopilots", "words"),
    [
        ([radio_status()], set(), "a radio (system 51, component 68)"),
        ([GROUND_STATION], set(), "a ground station (system 255, component 190)"),
        ([ARDUPILOT_S_OWN], set(), "a ground station (system 250, component 1)"),
        ([COMPANION], set(), "system 7, component 191"),
        ([GROUND_STATION, radio_status(), OTHER_AUTOPILOT], {7}, "a radio (system 51, component 68)"),
        ([], set(), ""),
    ],
)
def test_a_radio_or_a_ground_station_is_no_autopilot(packets: list[bytes], autopilots: set[int], words: str) -> None:
    translator = Translator(3, PX4)
    for packet in packets:
        assert translator.telemetry(packet, 9.0) == []
    assert translator.others.autopilots == autopilots
    assert words in str(translator.others)


def test_many_senders_are_counted() -> None:
    translator = Translator(3, PX4)
    for system_id in range(100, 120):
        translator.telemetry(beat(system_id, 191, 18, 8), 9.0)
    assert str(translator.others).endswith("system 107, component 191, 12 others")


def test_a_radio_on_a_signed_link_is_not_an_autopilot_that_does_not_sign() -> None:
    translator = Translator(3, PX4, SigningKey(bytes([7] * 32), 1, lambda: 1_800_000_000.0))
    translator.telemetry(radio_status(), 9.0)
    assert translator.refused_signature is None
    assert str(translator.others) == "a radio (system 51, component 68)"
    translator.telemetry(OTHER_AUTOPILOT, 9.0)
    assert translator.refused_signature is Code.MAVLINK_UNSIGNED
