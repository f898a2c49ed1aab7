"""Two independent clients, mavutil of pymavlink and mavsdk, fly a stand-in process that behaves like ArduCopter, over TCP."""

from __future__ import annotations

import asyncio
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import nan
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.telemetry.telemetry import FlightMode
from pymavlink import mavutil

from processes import StandInProcess, stand_in

M = mavutil.mavlink
TIMEOUT_S = 15.0
READY = "stand_in: {autopilot: ardupilot, armable_after_s: 1, sensors: ideal, parameters: {GUID_OPTIONS: 8}}\n"
GUIDED, BRAKE, LAND = 4, 17, 9


class Client:
    """A ground station by mavutil of pymavlink, which has its own framing, sequence numbers and timeouts."""

    def __init__(self, process: StandInProcess) -> None:
        self.link: Any = mavutil.mavlink_connection(f"tcp:127.0.0.1:{process.ports.tcp}", source_system=255)

    def wait(self, kind: str, timeout_s: float = TIMEOUT_S) -> Any:
        message = self.link.recv_match(type=kind, blocking=True, timeout=timeout_s)
        assert message is not None, f"no {kind} came"
        return message

    def command(self, number: int, *parameters: float) -> int:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        self.link.mav.command_long_send(1, 1, number, 0, *padded)
        while (ack := self.wait("COMMAND_ACK")).command != number:
            pass
        result: int = ack.result
        return result

    def wait_for_mode(self, mode: int) -> None:
        deadline_s = time.monotonic() + TIMEOUT_S
        while (heard := self.wait("HEARTBEAT").custom_mode) != mode:
            assert time.monotonic() < deadline_s, f"mode {heard} remains, expected {mode}"


@contextmanager
def client_of(folder: Path, configuration: str = READY) -> Iterator[tuple[StandInProcess, Client]]:
    with stand_in(folder, configuration) as process:
        client = Client(process)
        try:
            yield process, client
        finally:
            client.link.close()


def test_a_flight_by_pymavlink(tmp_path: Path) -> None:
    with client_of(tmp_path) as (process, client):
        heartbeat = client.wait("HEARTBEAT")
        assert (heartbeat.type, heartbeat.autopilot) == (M.MAV_TYPE_QUADROTOR, M.MAV_AUTOPILOT_ARDUPILOTMEGA)
        assert client.link.mode_mapping()["BRAKE"] == BRAKE
        for name in ("HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED"):
            message_id = getattr(M, f"MAVLINK_MSG_ID_{name}")
            assert client.command(M.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 20_000) == M.MAV_RESULT_ACCEPTED
        while client.command(M.MAV_CMD_DO_SET_MODE, 1, GUIDED) or client.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1):
            time.sleep(0.2)
        client.wait_for_mode(GUIDED)
        assert client.command(M.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == M.MAV_RESULT_ACCEPTED
        while client.wait("LOCAL_POSITION_NED").z > -1.9:
            pass
        rolls_rad = []
        for _ in range(60):  # an attitude comes 50 times a second
            client.link.mav.set_attitude_target_send(0, 1, 1, 7, [0.9976, 0.0698, 0.0, 0.0], 0.0, 0.0, 0.0, 0.365)
            rolls_rad.append(client.wait("ATTITUDE").roll)
        assert max(rolls_rad) == pytest.approx(0.14, abs=0.01)
        assert client.command(M.MAV_CMD_DO_SET_MODE, 1, BRAKE) == M.MAV_RESULT_ACCEPTED
        client.wait_for_mode(BRAKE)
        assert client.command(M.MAV_CMD_DO_SET_MODE, 1, LAND) == M.MAV_RESULT_ACCEPTED
        process.wait_until_disarmed()


def test_a_return_to_launch_by_pymavlink(tmp_path: Path) -> None:
    with client_of(tmp_path, READY.replace("GUID_OPTIONS: 8", "RTL_LOIT_TIME: 1000")) as (process, client):
        client.wait("HEARTBEAT")
        message_id = M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
        assert client.command(M.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 100_000) == M.MAV_RESULT_ACCEPTED
        while client.command(M.MAV_CMD_DO_SET_MODE, 1, GUIDED) or client.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1):
            time.sleep(0.2)
        assert client.command(M.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == M.MAV_RESULT_ACCEPTED
        while client.wait("EXTENDED_SYS_STATE").landed_state != M.MAV_LANDED_STATE_IN_AIR:
            pass
        assert client.command(M.MAV_CMD_NAV_RETURN_TO_LAUNCH) == M.MAV_RESULT_ACCEPTED
        client.wait_for_mode(client.link.mode_mapping()["RTL"])
        while client.wait("EXTENDED_SYS_STATE").landed_state != M.MAV_LANDED_STATE_LANDING:
            pass
        process.wait_until_disarmed()
        assert process.newest.mode == "RTL"


def test_rates_outlive_a_client_and_only_one_can_connect(tmp_path: Path) -> None:
    with client_of(tmp_path) as (process, client):
        client.command(M.MAV_CMD_SET_MESSAGE_INTERVAL, M.MAVLINK_MSG_ID_ATTITUDE, 20_000)
        client.wait("ATTITUDE")
        with socket.create_connection(("127.0.0.1", process.ports.tcp)) as second:
            second.settimeout(TIMEOUT_S)
            assert second.recv(100) == b""
        client.wait("ATTITUDE")
        client.link.close()
        time.sleep(0.2)
        again = Client(process)
        again.wait("ATTITUDE", 1.0)
        again.link.close()


def test_a_quaternion_that_is_not_a_number_ends_the_process(tmp_path: Path) -> None:
    with client_of(tmp_path) as (process, client):
        while client.wait("HEARTBEAT").custom_mode != GUIDED:  # a mode set before "ArduPilot Ready" is lost
            client.command(M.MAV_CMD_DO_SET_MODE, 1, GUIDED)
        client.link.mav.set_attitude_target_send(0, 1, 1, 7, [nan] * 4, 0.0, 0.0, 0.0, 0.365)
        assert process.process.wait(TIMEOUT_S) == -signal.SIGABRT
        assert "not a number" in process.log


def test_a_flight_by_mavsdk(tmp_path: Path) -> None:
    async def flight(process: StandInProcess) -> None:
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        async with asyncio.timeout(60.0), Mavsdk(configuration) as mavsdk:
            await mavsdk.add_any_connection(f"tcpout://127.0.0.1:{process.ports.tcp}")
            system = await mavsdk.first_autopilot(20.0)
            assert system is not None
            action, parameters, telemetry = ActionAsync(system), ParamAsync(system), TelemetryAsync(system)
            assert await parameters.get_param_float("GUID_TIMEOUT") == 3.0
            assert await parameters.get_param_int("GUID_OPTIONS") == 8
            await parameters.set_param_int("GUID_OPTIONS", 0)
            assert await parameters.get_param_int("GUID_OPTIONS") == 0
            await telemetry.set_rate_position(20.0)  # ArduCopter sends only what is requested
            await action.set_takeoff_altitude(2.0)
            async with asyncio.timeout(20.0):
                while True:
                    try:
                        await action.arm()
                        break
                    except ActionError:  # too early
                        await asyncio.sleep(0.5)
            await action.takeoff()
            async for position in telemetry.subscribe_position():
                if position.relative_altitude_m > 1.8:
                    break
            await action.land()
            async for mode in telemetry.subscribe_flight_mode():
                if mode == FlightMode.LAND:
                    break
            async for armed in telemetry.subscribe_armed():
                if not armed:
                    break

    with stand_in(tmp_path, READY) as process:
        asyncio.run(flight(process))
