"""The way to a ground station and back: what may pass, how fast, and that nothing waits for it."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.link import ground_link
from companion.link.endpoint import LinkError
from companion.link.ground_link import TOO_MUCH, GroundStationLink
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.ground_station import (
    ITS_RATE,
    ITS_SETPOINT,
    ITS_VOICE,
    UNREADABLE_FROM_IT,
    GroundStationFilter,
)

OWN = {mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
BEAT = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def said(message: MavlinkMessage, system_id: int = 255) -> bytes:
    return MavlinkCodec(system_id, mavlink.MAV_COMP_ID_MISSIONPLANNER).encode(message)


def command(number: int, param1: float = 0.0, target: int = 3) -> MavlinkMessage:
    return mavlink.MAVLink_command_long_message(target, 1, number, 0, param1, 0, 0, 0, 0, 0, 0)


def group(number: int) -> MavlinkMessage:
    return mavlink.MAVLink_request_data_stream_message(3, 1, number, 3, 1)


INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
TARGET = mavlink.MAVLink_set_attitude_target_message(0, 3, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.5)


@pytest.mark.parametrize(
    "message",
    [
        BEAT,
        command(mavlink.MAV_CMD_DO_SET_MODE, 1),
        command(mavlink.MAV_CMD_NAV_LAND, target=0),
        command(INTERVAL, mavlink.MAVLINK_MSG_ID_VFR_HUD),
        group(mavlink.MAV_DATA_STREAM_EXTRA2),
        mavlink.MAVLink_param_request_list_message(3, 1),
        mavlink.MAVLink_manual_control_message(3, 0, 0, 0, 0, 0),
    ],
    ids=lambda message: message.get_type(),
)
def test_what_a_ground_station_does_passes_as_it_came(message: MavlinkMessage) -> None:
    admission = GroundStationFilter(3, OWN)
    data = said(message)
    assert admission.admit(data + data) == [data, data]
    assert admission.refused == {}


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (said(BEAT, system_id=3), ITS_VOICE),
        (said(TARGET), ITS_SETPOINT),
        (said(mavlink.MAVLink_set_position_target_local_ned_message(0, 3, 1, 1, 0, *[0] * 11)), ITS_SETPOINT),
        (said(command(INTERVAL, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)), ITS_RATE),
        (said(group(mavlink.MAV_DATA_STREAM_ALL)), ITS_RATE),
        (said(group(mavlink.MAV_DATA_STREAM_POSITION)), ITS_RATE),
        (b"GET / HTTP/1.1\r\n", UNREADABLE_FROM_IT),
        (said(BEAT)[:-1], UNREADABLE_FROM_IT),
        (said(BEAT)[:-1] + b"\x00", UNREADABLE_FROM_IT),
    ],
)
def test_what_is_the_agents_and_what_is_no_mavlink_is_refused(data: bytes, reason: str) -> None:
    admission = GroundStationFilter(3, OWN)
    assert admission.admit(data) == []
    assert set(admission.refused) == {reason}
    assert admission.admit(said(BEAT)) == [said(BEAT)]  # half a packet does not swallow the next


def test_what_is_for_another_vehicle_does_not_take_this_ones_line() -> None:
    admission = GroundStationFilter(3, OWN)
    assert admission.admit(said(command(mavlink.MAV_CMD_NAV_LAND, target=4))) == []
    assert admission.refused == {}


def test_signed_packets_and_those_of_mavlink_1_pass_as_they_are() -> None:
    sender = common.MAVLink(None, 255, 190)
    old = sender.heartbeat_encode(6, 8, 0, 0, 4).pack(sender, force_mavlink1=True)
    sender.signing.secret_key, sender.signing.sign_outgoing = bytes(range(32)), True
    signed = sender.heartbeat_encode(6, 8, 0, 0, 4).pack(sender)
    assert GroundStationFilter(3, OWN).admit(bytes(old)) == [bytes(old)]
    assert GroundStationFilter(3, OWN).admit(bytes(signed)) == [bytes(signed)]


@given(st.binary(max_size=400))
def test_no_datagram_raises(data: bytes) -> None:
    GroundStationFilter(3, OWN).admit(b"\xfd" + data)


# ---------------------------------------------------------------- the link


class Line:
    """Takes what is offered while it is free."""

    def __init__(self) -> None:
        self.is_free = True
        self.took: list[bytes] = []

    def offer(self, packet: bytes) -> bool:
        if self.is_free:
            self.took.append(packet)
        return self.is_free


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(10.0):
        while not condition():
            await asyncio.sleep(0.005)


def run(scenario: Callable[[socket.socket, GroundStationLink, Line, Counter[str]], object]) -> None:
    """A ground station's socket, which has heard the vehicle, and a link to it."""

    async def whole() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.bind(("127.0.0.1", 0))
            station.settimeout(5.0)
            line, rejected = Line(), Counter[str]()
            endpoint = f"udpout:127.0.0.1:{station.getsockname()[1]}"
            reject = lambda reason: rejected.update([reason])  # noqa: E731
            with closing(GroundStationLink(endpoint, GroundStationFilter(3, OWN), line.offer, reject)) as link:
                task = asyncio.create_task(link.run())
                link.pass_on([b"telemetry"])
                await asyncio.sleep(0)
                data, vehicle = await asyncio.to_thread(station.recvfrom, 100)
                assert data == b"telemetry"
                station.connect(("127.0.0.1", vehicle[1]))
                await scenario(station, link, line, rejected)  # type: ignore[misc]
                task.cancel()

    asyncio.run(whole())


def test_packets_pass_both_ways_as_they_came() -> None:
    async def scenario(station: socket.socket, link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        station.send(said(BEAT))
        await until(lambda: line.took == [said(BEAT)])
        link.pass_on([b"one", b"two"])
        assert [await asyncio.to_thread(station.recv, 100) for _ in range(2)] == [b"one", b"two"]
        assert rejected == {}

    run(scenario)


def test_a_stranger_is_not_the_ground_station() -> None:
    async def scenario(station: socket.socket, _link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(said(BEAT), station.getpeername())
            await until(lambda: rejected[ground_link.ELSEWHERE])
        assert line.took == []

    run(scenario)


def test_a_command_that_would_come_late_is_dropped() -> None:
    async def scenario(station: socket.socket, _link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        line.is_free = False
        station.send(said(command(mavlink.MAV_CMD_NAV_TAKEOFF)))
        await until(lambda: rejected[TOO_MUCH] == 1)
        line.is_free = True
        station.send(said(BEAT))
        await until(lambda: line.took)
        assert line.took == [said(BEAT)]

    run(scenario)


def test_a_flood_is_cut_to_what_the_line_has_room_for() -> None:
    async def scenario(station: socket.socket, _link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        sent = 0
        while loop.time() - start_s < 1.0:
            for _ in range(8):
                station.send(said(BEAT))
                sent += 1
            await asyncio.sleep(0.002)
        await until(lambda: len(line.took) + rejected[TOO_MUCH] == sent)
        assert len(line.took) <= (loop.time() - start_s) / ground_link.PACE_S + 1
        assert len(line.took) > 20  # a flood does not stop what has room

    run(scenario)


def test_a_ground_station_that_is_not_there_stops_nobody() -> None:
    async def scenario(station: socket.socket, link: GroundStationLink, line: Line, _rejected: Counter[str]) -> None:
        peer = station.getpeername()
        port = station.getsockname()[1]
        station.close()
        for _ in range(100):
            link.pass_on([b"nobody hears this"])
            await asyncio.sleep(0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
            again.bind(("127.0.0.1", port))
            again.sendto(said(BEAT), peer)
            await until(lambda: line.took == [said(BEAT)])

    run(scenario)


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [("udpout:127.0.0.1:70000", "expected 1 to 65535"), ("udpout:no.such.host.invalid:1", "no address is known for")],
)
def test_an_address_that_is_none_is_told(endpoint: str, words: str) -> None:
    with pytest.raises(LinkError, match=words):
        GroundStationLink(endpoint, GroundStationFilter(3, OWN), Line().offer, lambda _: None)
