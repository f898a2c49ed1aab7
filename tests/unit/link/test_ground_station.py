"""Forwarding to and from a ground station: permitted packets, rate limit, no blocking."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from companion.link import ground_link
from companion.link.byte_links import LinkError
from companion.link.ground_link import GroundStationLink
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage
from companion.mavlink.ground_station import AGENT_FLIES, GroundStationFilter
from companion.types.flight import FlightPhase
from companion.types.notices import Code

OWN = {mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
BEAT = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def encoded(message: MavlinkMessage, system_id: int = 255) -> bytes:
    return MavlinkCodec(system_id, mavlink.MAV_COMP_ID_MISSIONPLANNER).encode(message)


def command(number: int, param1: float = 0.0, target: int = 3) -> MavlinkMessage:
    return mavlink.MAVLink_command_long_message(target, 1, number, 0, param1, 0, 0, 0, 0, 0, 0)


def group(number: int) -> MavlinkMessage:
    return mavlink.MAVLink_request_data_stream_message(3, 1, number, 3, 1)


P = FlightPhase
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
def test_permitted_ground_station_packets_pass_unchanged(message: MavlinkMessage) -> None:
    admission = GroundStationFilter(3, OWN)
    data = encoded(message)
    assert admission.admit(data + data, P.OBSERVE) == [data, data]
    assert admission.refused == {}


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (encoded(BEAT, system_id=3), Code.GROUND_STATION_OWN_ID),
        (encoded(TARGET), Code.GROUND_STATION_SETPOINT),
        (
            encoded(mavlink.MAVLink_set_position_target_local_ned_message(0, 3, 1, 1, 0, *[0] * 11)),
            Code.GROUND_STATION_SETPOINT,
        ),
        (encoded(command(INTERVAL, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)), Code.GROUND_STATION_RATE),
        (encoded(group(mavlink.MAV_DATA_STREAM_ALL)), Code.GROUND_STATION_RATE),
        (encoded(group(mavlink.MAV_DATA_STREAM_POSITION)), Code.GROUND_STATION_RATE),
        (b"GET / HTTP/1.1\r\n", Code.GROUND_STATION_UNREADABLE),
        (encoded(BEAT)[:-1], Code.GROUND_STATION_UNREADABLE),
        (encoded(BEAT)[:-1] + b"\x00", Code.GROUND_STATION_UNREADABLE),
    ],
)
def test_setpoints_and_unreadable_packets_are_refused(data: bytes, reason: str) -> None:
    admission = GroundStationFilter(3, OWN)
    assert admission.admit(data, P.OBSERVE) == []
    assert set(admission.refused) == {reason}
    assert admission.admit(encoded(BEAT), P.OBSERVE) == [encoded(BEAT)]  # half a packet does not swallow the next


def reposition(kind: type[MavlinkMessage] = mavlink.MAVLink_command_int_message) -> MavlinkMessage:
    if kind is mavlink.MAVLink_command_long_message:
        return command(mavlink.MAV_CMD_DO_REPOSITION)
    return kind(3, 1, 6, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 0, 0, 0, 473977420, 85455940, 10)


MOVES_OR_CONFIGURES = [
    reposition(),
    reposition(mavlink.MAVLink_command_long_message),
    command(mavlink.MAV_CMD_DO_CHANGE_SPEED),
    command(mavlink.MAV_CMD_DO_ORBIT),
    command(mavlink.MAV_CMD_CONDITION_YAW),
    command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE),
    command(mavlink.MAV_CMD_NAV_TAKEOFF),
    command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0),
    command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0),
    mavlink.MAVLink_mission_item_int_message(3, 1, 0, 6, 16, 2, 1, 0, 0, 0, 0, 0, 0, 10),  # "guided go-to"
    mavlink.MAVLink_mission_count_message(3, 1, 2),
    mavlink.MAVLink_param_set_message(3, 1, b"GUID_OPTIONS", 0, 2),
    mavlink.MAVLink_set_gps_global_origin_message(3, 473977420, 85455940, 488000),
    mavlink.MAVLink_file_transfer_protocol_message(0, 3, 1, [0] * 251),
    mavlink.MAVLink_serial_control_message(10, 0, 0, 0, 1, [0] * 70),
]
FROM_A_PILOT = [
    BEAT,
    command(mavlink.MAV_CMD_DO_SET_MODE, 1),
    command(mavlink.MAV_CMD_NAV_LAND),
    command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM),
    command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1.0),
    command(mavlink.MAV_CMD_REQUEST_MESSAGE, 1.0),
    mavlink.MAVLink_set_mode_message(3, 1, 5),
    mavlink.MAVLink_manual_control_message(3, 0, 0, 0, 0, 0),
    mavlink.MAVLink_rc_channels_override_message(3, 1, *[1500] * 8),
    mavlink.MAVLink_gps_rtcm_data_message(0, 180, [0] * 180),
    mavlink.MAVLink_param_request_read_message(3, 1, b"GUID_OPTIONS", -1),
]

UNKNOWN = [float("nan")] * 21
MEASUREMENTS = [  # of a program beside the agent that feeds positions and corrections
    mavlink.MAVLink_vision_position_estimate_message(1, 0, 0, 0, 0, 0, 0),
    mavlink.MAVLink_att_pos_mocap_message(1, [1, 0, 0, 0], 0, 0, 0),
    mavlink.MAVLink_odometry_message(1, 1, 12, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, UNKNOWN, UNKNOWN),
    mavlink.MAVLink_vision_speed_estimate_message(1, 0, 0, 0),
    mavlink.MAVLink_vicon_position_estimate_message(1, 0, 0, 0, 0, 0, 0),
    mavlink.MAVLink_global_vision_position_estimate_message(1, 0, 0, 0, 0, 0, 0),
    mavlink.MAVLink_gps_input_message(1, 0, 0, 0, 0, 3, 0, 0, 0, 1, 1, 0, 0, 0, 1, 1, 1, 10),
    mavlink.MAVLink_gps_inject_data_message(3, 1, 110, [0] * 110),
    mavlink.MAVLink_distance_sensor_message(1, 10, 1000, 150, 0, 0, 25, 0),
    mavlink.MAVLink_optical_flow_message(1, 0, 1, 1, 0.0, 0.0, 255, 1.0),
    mavlink.MAVLink_optical_flow_rad_message(1, 0, 20000, 0, 0, 0, 0, 0, 0, 255, 0, 1.0),
    mavlink.MAVLink_obstacle_distance_message(1, 0, [100] * 72, 5, 10, 1000),
    mavlink.MAVLink_wheel_distance_message(1, 2, [0.0] * 16),
    mavlink.MAVLink_terrain_data_message(473977420, 85455940, 30, 0, [488] * 16),
    mavlink.MAVLink_landing_target_message(1, 0, 12, 0, 0, 1, 0, 0),
]


@pytest.mark.parametrize("message", MEASUREMENTS, ids=lambda message: message.get_type())
def test_a_measurement_that_passes_before_arming_passes_in_flight(message: MavlinkMessage) -> None:
    for phase in P:
        admission, data = GroundStationFilter(3, OWN), encoded(message)
        assert (admission.admit(data, phase), admission.refused) == ([data], {}), phase


@pytest.mark.parametrize("phase", sorted(AGENT_FLIES))
def test_only_the_listed_packets_pass_while_the_agent_flies(phase: FlightPhase) -> None:
    admission = GroundStationFilter(3, OWN)
    for message in MOVES_OR_CONFIGURES:
        assert admission.admit(encoded(message), phase) == [], message
    assert admission.refused == {Code.GROUND_STATION_IN_FLIGHT: len(MOVES_OR_CONFIGURES)}
    for message in FROM_A_PILOT:
        assert admission.admit(encoded(message), phase) == [encoded(message)], message


def test_the_ground_station_may_configure_while_the_agent_observes() -> None:
    for message in MOVES_OR_CONFIGURES + FROM_A_PILOT:
        assert GroundStationFilter(3, OWN).admit(encoded(message), P.OBSERVE) == [encoded(message)], message


def test_packet_for_another_vehicle_is_not_forwarded() -> None:
    admission = GroundStationFilter(3, OWN)
    assert admission.admit(encoded(command(mavlink.MAV_CMD_NAV_LAND, target=4)), P.FORMATION) == []
    assert admission.refused == {}


def test_signed_and_mavlink_1_packets_pass_unchanged() -> None:
    sender = mavlink.MAVLink(None, 255, 190)
    old = sender.heartbeat_encode(6, 8, 0, 0, 4).pack(sender, force_mavlink1=True)
    sender.signing.secret_key, sender.signing.sign_outgoing = bytes(range(32)), True
    signed = sender.heartbeat_encode(6, 8, 0, 0, 4).pack(sender)
    assert GroundStationFilter(3, OWN).admit(bytes(old), P.HOLD) == [bytes(old)]
    assert GroundStationFilter(3, OWN).admit(bytes(signed), P.HOLD) == [bytes(signed)]


@given(st.binary(max_size=400))
def test_arbitrary_datagrams_never_raise(data: bytes) -> None:
    GroundStationFilter(3, OWN).admit(b"\xfd" + data, P.FORMATION)


# ---------------------------------------------------------------- the link


class Line:
    """Accepts offered packets while it is free."""

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
    """A ground station's socket that has received from the vehicle, and a link to it."""

    async def whole() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.bind(("127.0.0.1", 0))
            station.settimeout(5.0)
            line, rejected = Line(), Counter[str]()
            endpoint = f"udpout:127.0.0.1:{station.getsockname()[1]}"
            reject = lambda reason: rejected.update([reason])  # noqa: E731
            with closing(
                GroundStationLink(endpoint, GroundStationFilter(3, OWN), lambda: P.OBSERVE, line.offer, reject)
            ) as link:
                task = asyncio.create_task(link.run())
                link.pass_on([b"telemetry"])
                await asyncio.sleep(0)
                data, vehicle = await asyncio.to_thread(station.recvfrom, 100)
                assert data == b"telemetry"
                station.connect(("127.0.0.1", vehicle[1]))
                await scenario(station, link, line, rejected)  # type: ignore[misc]
                task.cancel()

    asyncio.run(whole())


def test_packets_are_forwarded_unchanged_in_both_directions() -> None:
    async def scenario(station: socket.socket, link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        station.send(encoded(BEAT))
        await until(lambda: line.took == [encoded(BEAT)])
        link.pass_on([b"one", b"two"])
        assert [await asyncio.to_thread(station.recv, 100) for _ in range(2)] == [b"one", b"two"]
        assert rejected == {}

    run(scenario)


def test_packet_from_another_address_is_refused() -> None:
    async def scenario(station: socket.socket, _link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(encoded(BEAT), station.getpeername())
            await until(lambda: rejected[Code.GROUND_STATION_ADDRESS])
        assert line.took == []

    run(scenario)


def test_late_command_is_dropped() -> None:
    async def scenario(station: socket.socket, _link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        line.is_free = False
        station.send(encoded(command(mavlink.MAV_CMD_NAV_TAKEOFF)))
        await until(lambda: rejected[Code.GROUND_STATION_OVERLOAD] == 1)
        line.is_free = True
        station.send(encoded(BEAT))
        await until(lambda: line.took)
        assert line.took == [encoded(BEAT)]

    run(scenario)


def test_flood_is_limited_to_the_capacity_of_the_link() -> None:
    async def scenario(station: socket.socket, _link: GroundStationLink, line: Line, rejected: Counter[str]) -> None:
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        sent = 0
        while loop.time() - start_s < 1.0:
            for _ in range(8):
                station.send(encoded(BEAT))
                sent += 1
            await asyncio.sleep(0.002)
        await until(lambda: len(line.took) + rejected[Code.GROUND_STATION_OVERLOAD] == sent)
        assert len(line.took) <= (loop.time() - start_s) / ground_link.PACE_S + 1
        assert len(line.took) > 20  # a flood does not stop what has room

    run(scenario)


def test_missing_ground_station_blocks_nothing() -> None:
    async def scenario(station: socket.socket, link: GroundStationLink, line: Line, _rejected: Counter[str]) -> None:
        peer = station.getpeername()
        port = station.getsockname()[1]
        station.close()
        for _ in range(100):
            link.pass_on([b"no receiver"])
            await asyncio.sleep(0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
            again.bind(("127.0.0.1", port))
            again.sendto(encoded(BEAT), peer)
            await until(lambda: line.took == [encoded(BEAT)])

    run(scenario)


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [("udpout:127.0.0.1:70000", "expected 1 to 65535"), ("udpout:no.such.host.invalid:1", "no address found for")],
)
def test_invalid_address_is_reported(endpoint: str, words: str) -> None:
    with pytest.raises(LinkError, match=words):
        GroundStationLink(endpoint, GroundStationFilter(3, OWN), lambda: P.OBSERVE, Line().offer, lambda _: None)
