"""A real agent process that forwards MAVLink between its autopilot and a ground station."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common import until
from companion.ground.session import FleetSession
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.commands import CommandName
from companion.types.notices import Code
from processes import AgentFiles, agent, agent_files, companion
from wire_autopilots import LOITER, OFFBOARD, HoveringAutopilot

BEAT = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


class GroundStation:
    """Listens on a UDP port and answers the last sender, as QGroundControl does."""

    def __init__(self, listening: socket.socket) -> None:
        self._socket = listening
        self._socket.settimeout(5.0)
        self._codec = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._vehicle: tuple[str, int] | None = None

    def receive(self, seconds: float) -> list[MavlinkMessage]:
        """All messages received in this time, at least one."""
        end_s, received = time.monotonic() + seconds, []
        while time.monotonic() < end_s:
            data, self._vehicle = self._socket.recvfrom(4096)
            received += self._codec.decode(data)
        return received

    def send(self, message: MavlinkMessage) -> None:
        assert self._vehicle
        self._socket.sendto(self._codec.encode(message), self._vehicle)


@contextmanager
def ground_station(folder: Path) -> Iterator[tuple[AgentFiles, GroundStation]]:
    files = agent_files(folder)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        with files.file.open("a", encoding="utf-8") as file:
            file.write(f"ground_station: udpout:127.0.0.1:{listening.getsockname()[1]}\n")
        yield files, GroundStation(listening)


def ground_heartbeats(autopilot: HoveringAutopilot) -> list[MavlinkMessage]:
    beats = [m for m in autopilot.received if m.get_type() == "HEARTBEAT"]
    return [m for m in beats if m.type == mavlink.MAV_TYPE_GCS or m.get_srcSystem() != 1]


def test_only_the_heartbeat_of_the_ground_station_reaches_the_autopilot(tmp_path: Path) -> None:
    with (
        ground_station(tmp_path) as (files, station),
        HoveringAutopilot(1, files.udp_port) as autopilot,
        agent(files) as process,
    ):
        process.wait_for_log("heartbeat of autopilot 1")
        received = station.receive(2.0)
        assert {(m.get_srcSystem(), m.get_srcComponent()) for m in received} == {(1, mavlink.MAV_COMP_ID_AUTOPILOT1)}
        assert {"HEARTBEAT", "LOCAL_POSITION_NED"} <= {m.get_type() for m in received}
        assert ground_heartbeats(autopilot) == []
        station.send(BEAT)
        until(lambda: ground_heartbeats(autopilot))
        process.wait_for_log("ground station at 127.0.0.1")
        station.receive(1.5)
        beats = ground_heartbeats(autopilot)
        assert [(m.get_srcSystem(), m.type) for m in beats] == [(255, mavlink.MAV_TYPE_GCS)]


def test_a_pilot_at_the_ground_station_takes_over_and_its_setpoints_are_dropped(tmp_path: Path) -> None:
    with (
        ground_station(tmp_path) as (files, station),
        HoveringAutopilot(1, files.udp_port) as autopilot,
        agent(files) as process,
        FleetSession("processtest", (files.zenoh,)) as session,
    ):
        process.wait_for_log("heartbeat of autopilot 1")
        until(lambda: getattr(session.command([1], CommandName.HOLD, 5.0)[1], "accepted", False))
        process.wait_for_log("-> hold")
        until(lambda: getattr(session.command([1], CommandName.FORM, 5.0)[1], "accepted", False))
        process.wait_for_log("engage -> formation")
        assert autopilot.mode == OFFBOARD
        station.receive(0.1)
        for _ in range(100):  # beside those of the agent
            station.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.9))
            station.receive(0.01)
        process.wait_for_log(Code.GROUND_STATION_SETPOINT)
        set_mode = mavlink.MAV_CMD_DO_SET_MODE
        station.send(mavlink.MAVLink_command_long_message(1, 1, set_mode, 0, 1, *LOITER, 0, 0, 0, 0))
        process.wait_for_log("formation -> observe")
        sent = len(autopilot.target_times_s)
        station.receive(0.3)
        assert len(autopilot.target_times_s) == sent
        assert autopilot.mode == LOITER
        assert 0.9 not in [round(thrust, 3) for thrust in autopilot.thrusts]


def test_a_ground_station_without_an_address_ends_the_agent_with_2(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with files.file.open("a", encoding="utf-8") as file:
        file.write("ground_station: udpout:no.such.host.invalid:14550\n")
    result = companion("agent", "--config", str(files.file))
    assert result.returncode == 2
    assert f'{files.file}: ground_station: "udpout:no.such.host.invalid:14550": no address' in result.stderr
    assert "Traceback" not in result.stderr
