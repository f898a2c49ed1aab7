"""A ground station connects to the real sockets of a stand-in; which senders and framings it accepts."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest
from pymavlink.dialects.v10 import common as mavlink_1

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from processes import StandInProcess, stand_in
from sitl.autopilots.px4.autopilot import Px4

M = mavlink
TIMEOUT_S = 10.0
COMPONENT_METADATA = 397  # not in the dialect, like PROTOCOL_VERSION
PROTOCOL_VERSION = 300


class Station:
    """A ground station on one UDP socket, by default on any free port."""

    def __init__(self, autopilot_port: int, own_port: int = 0, system_id: int = 255) -> None:
        self._autopilot = ("127.0.0.1", autopilot_port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", own_port))
        self.codec = MavlinkCodec(system_id, M.MAV_COMP_ID_MISSIONPLANNER)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def send(self, message: MavlinkMessage) -> None:
        self.send_bytes(self.codec.encode(message))

    def send_bytes(self, data: bytes) -> None:
        self._socket.sendto(data, self._autopilot)

    def heartbeat(self) -> None:
        self.send(M.MAVLink_heartbeat_message(M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID, 0, 0, M.MAV_STATE_ACTIVE, 3))

    def command(self, command: int, *parameters: float) -> None:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(M.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def receive(self, timeout_s: float) -> Iterator[MavlinkMessage]:
        """All messages received within this time."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            self._socket.settimeout(left_s)
            try:
                data = self._socket.recv(4096)
            except TimeoutError:
                return
            yield from self.codec.decode(data)

    def wait_for(self, kind: str, wanted: Callable[[MavlinkMessage], bool] = lambda _message: True) -> MavlinkMessage:
        for message in self.receive(TIMEOUT_S):
            if message.get_type() == kind and wanted(message):
                return message
        pytest.fail(f"no {kind} came")

    def acknowledged(self, command: int) -> int:
        result: int = self.wait_for("COMMAND_ACK", lambda ack: ack.command == command).result
        return result


@contextmanager
def station_of(folder: Path) -> Iterator[tuple[StandInProcess, Station]]:
    """A stand-in, and a ground station that has connected to its ground link."""
    with stand_in(folder) as process, Station(process.ports.ground_link) as station:
        station.heartbeat()
        yield process, station


def test_the_requests_of_a_connecting_qgroundcontrol_are_answered(tmp_path: Path) -> None:
    with station_of(tmp_path) as (_, station):
        heartbeat = station.wait_for("HEARTBEAT")
        assert (heartbeat.type, heartbeat.autopilot) == (M.MAV_TYPE_QUADROTOR, M.MAV_AUTOPILOT_PX4)

        station.command(M.MAV_CMD_REQUEST_MESSAGE, M.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        version = station.wait_for("AUTOPILOT_VERSION")
        assert version.flight_sw_version >> 8 == 0x011000
        assert version.capabilities & M.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        assert not version.capabilities & M.MAV_PROTOCOL_CAPABILITY_FTP
        for number in (PROTOCOL_VERSION, COMPONENT_METADATA):
            station.command(M.MAV_CMD_REQUEST_MESSAGE, number)
            station.wait_for("COMMAND_ACK", lambda ack: ack.result == M.MAV_RESULT_DENIED)

        station.send(M.MAVLink_param_request_list_message(1, 1))
        values = {}
        for message in station.receive(TIMEOUT_S):
            if message.get_type() == "PARAM_VALUE" and message.param_index < message.param_count:
                values[message.param_index] = message.param_id
                if len(values) == message.param_count:
                    break
        assert sorted(values.values()) == sorted(Px4.data.parameters)
        station.send(M.MAVLink_param_request_read_message(1, 1, b"_HASH_CHECK", -1))
        assert station.wait_for("PARAM_VALUE").param_id == "_HASH_CHECK"

        for kind in (M.MAV_MISSION_TYPE_MISSION, M.MAV_MISSION_TYPE_FENCE, M.MAV_MISSION_TYPE_RALLY):
            station.send(M.MAVLink_mission_request_list_message(1, 1, kind))
            count = station.wait_for("MISSION_COUNT")
            assert (count.count, count.mission_type) == (0, kind)


def test_a_file_request_is_refused_in_its_session(tmp_path: Path) -> None:
    session, open_file, nak = 7, 4, 129
    with station_of(tmp_path) as (_, station):
        request = bytearray(251)
        request[0], request[2], request[3] = 5, session, open_file
        station.send(M.MAVLink_file_transfer_protocol_message(0, 1, 1, request))
        reply = bytes(station.wait_for("FILE_TRANSFER_PROTOCOL").payload)
    assert (reply[0], reply[2], reply[3], reply[5]) == (6, session, nak, open_file)


def test_the_onboard_link_streams_at_once_and_both_links_report_a_new_origin(tmp_path: Path) -> None:
    with (
        station_of(tmp_path) as (process, station),
        Station(process.ports.onboard, process.ports.companion) as companion,
    ):
        for kind in ("HEARTBEAT", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION", "EXTENDED_SYS_STATE"):
            companion.wait_for(kind)
        station.send(M.MAVLink_set_gps_global_origin_message(1, 473977000, 85455000, 490_000))
        for side in (station, companion):
            assert side.wait_for("GPS_GLOBAL_ORIGIN", lambda m: m.altitude == 490_000).latitude == 473977000


def test_the_first_sender_stays_the_peer(tmp_path: Path) -> None:
    with station_of(tmp_path) as (process, first), Station(process.ports.ground_link) as second:
        first.wait_for("HEARTBEAT")
        second.heartbeat()
        second.command(M.MAV_CMD_REQUEST_MESSAGE, M.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        assert not list(second.receive(1.2))
        first.wait_for("HEARTBEAT")


def test_texts_reach_only_a_link_with_a_ground_station(tmp_path: Path) -> None:
    with (
        station_of(tmp_path) as (process, station),
        Station(process.ports.onboard, process.ports.companion) as companion,
    ):
        companion.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)  # at once: too early
        assert companion.acknowledged(M.MAV_CMD_COMPONENT_ARM_DISARM) == M.MAV_RESULT_TEMPORARILY_REJECTED
        text = station.wait_for("STATUSTEXT").text
        assert not [m for m in companion.receive(0.5) if m.get_type() == "STATUSTEXT"]
    assert "Arming denied: Resolve system health failures first".startswith(text)


def test_intervals_outlive_a_reconnection(tmp_path: Path) -> None:
    with stand_in(tmp_path) as process:
        with Station(process.ports.onboard, process.ports.companion) as companion:
            companion.command(M.MAV_CMD_SET_MESSAGE_INTERVAL, M.MAVLINK_MSG_ID_ODOMETRY, -1.0)
            assert companion.acknowledged(M.MAV_CMD_SET_MESSAGE_INTERVAL) == M.MAV_RESULT_ACCEPTED
        with Station(process.ports.onboard, process.ports.companion) as companion:
            kinds = [message.get_type() for message in companion.receive(1.0)]
    assert "LOCAL_POSITION_NED" in kinds
    assert "ODOMETRY" not in kinds


def test_mavlink_1_and_signed_packets_are_accepted_and_garbage_is_skipped(tmp_path: Path) -> None:
    with station_of(tmp_path) as (_, station):
        station.wait_for("HEARTBEAT")
        station.send_bytes(b"\xfd\xff\xff" + b"garbage" * 20)  # the header of a long packet that never ends
        for _ in range(20):
            station.heartbeat()
        old = mavlink_1.MAVLink(None, srcSystem=255, srcComponent=190)
        station.send_bytes(mavlink_1.MAVLink_param_request_read_message(1, 1, b"MAV_TYPE", -1).pack(old))
        assert station.wait_for("PARAM_VALUE").param_id == "MAV_TYPE"

        signing = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        signing.signing.secret_key = b"k" * 32
        signing.signing.link_id, signing.signing.timestamp, signing.signing.sign_outgoing = 1, 10**12, True
        packet = M.MAVLink_param_request_read_message(1, 1, b"MAV_SYS_ID", -1).pack(signing)
        assert packet[2] == M.MAVLINK_IFLAG_SIGNED
        station.send_bytes(packet)
        assert station.wait_for("PARAM_VALUE").param_id == "MAV_SYS_ID"


def test_timesync_is_answered_with_the_clock_of_time_boot(tmp_path: Path) -> None:
    with station_of(tmp_path) as (_, station):
        station.wait_for("HEARTBEAT")
        sent_ns = time.monotonic_ns()
        station.send(M.MAVLink_timesync_message(0, sent_ns))
        answer = station.wait_for("TIMESYNC", lambda message: message.tc1 != 0)
        attitude = station.wait_for("ATTITUDE")
    assert answer.ts1 == sent_ns
    assert answer.tc1 / 1e6 == pytest.approx(attitude.time_boot_ms, abs=2000.0)
