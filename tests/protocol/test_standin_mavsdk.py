"""mavsdk, an independent client, flies a real stand-in process and reads and sets its parameters."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.offboard import Attitude, AttitudeRate, OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.telemetry.telemetry import FlightMode, LandedState

from processes import StandInProcess, stand_in

HOVER_THRUST = 0.49
TIMEOUT_S = 60.0
IDEAL = "stand_in: {sensors: ideal, armable_after_s: 1}\n"


@dataclass
class Client:
    """One mavsdk system and its plugins."""

    action: ActionAsync
    offboard: OffboardAsync
    parameters: ParamAsync
    telemetry: TelemetryAsync

    async def wait_until_armable(self) -> None:
        async for health in self.telemetry.subscribe_health():
            if health.is_armable:
                return

    async def wait_for_mode(self, mode: FlightMode) -> None:
        async for now in self.telemetry.subscribe_flight_mode():
            if now == mode:
                return

    async def wait_until_disarmed(self) -> None:
        async for armed in self.telemetry.subscribe_armed():
            if not armed:
                return

    async def take_off(self) -> None:
        await self.wait_until_armable()
        await self.action.set_takeoff_altitude(1.5)
        await self.action.arm()
        await self.action.takeoff()
        await self.wait_for_mode(FlightMode.HOLD)


@asynccontextmanager
async def client(process: StandInProcess) -> AsyncIterator[Client]:
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{process.ports.companion}")
        system = await mavsdk.first_autopilot(20.0)
        assert system is not None
        assert await system.get_system_id() == 1
        yield Client(ActionAsync(system), OffboardAsync(system), ParamAsync(system), TelemetryAsync(system))


def fly(process: StandInProcess, flight: Callable[[Client], Awaitable[None]]) -> None:
    """Run one client to its end, within TIMEOUT_S."""

    async def run() -> None:
        async with asyncio.timeout(TIMEOUT_S), client(process) as connected:
            await flight(connected)

    asyncio.run(run())


def test_health_and_parameters(tmp_path: Path) -> None:
    async def flight(c: Client) -> None:
        async for health in c.telemetry.subscribe_health():
            if health.is_home_position_ok and health.is_local_position_ok and health.is_global_position_ok:
                break
        with pytest.raises(ActionError):  # too early
            await c.action.arm()
        await c.wait_until_armable()
        assert await c.telemetry.health_all_ok()
        every = await c.parameters.get_all_params()
        assert {p.name: p.value for p in every.int_params}["COM_OBL_RC_ACT"] == 0
        assert {p.name: p.value for p in every.float_params}["COM_OF_LOSS_T"] == 1.0
        await c.parameters.set_param_float("MPC_LAND_SPEED", 0.8)
        await c.parameters.set_param_int("COM_OBL_RC_ACT", -5)
        assert await c.parameters.get_param_float("MPC_LAND_SPEED") == pytest.approx(0.8)
        assert await c.parameters.get_param_int("COM_OBL_RC_ACT") == -5
        with pytest.raises(ParamError):
            await c.parameters.set_param_float("COM_OBL_RC_ACT", 1.0)

    with stand_in(tmp_path) as process:
        fly(process, flight)


def test_a_return_to_launch(tmp_path: Path) -> None:
    async def flight(c: Client) -> None:
        await c.take_off()
        await c.action.set_return_to_launch_altitude(2.5)
        await c.action.return_to_launch()
        await c.wait_for_mode(FlightMode.RETURN_TO_LAUNCH)
        async for state in c.telemetry.subscribe_landed_state():
            if state == LandedState.LANDING:
                break
        assert await c.telemetry.flight_mode() == FlightMode.RETURN_TO_LAUNCH
        await c.wait_until_disarmed()

    with stand_in(tmp_path, IDEAL) as process:
        fly(process, flight)


def test_a_flight_with_offboard_attitude(tmp_path: Path) -> None:
    async def flight(c: Client) -> None:
        await c.take_off()
        where = await c.telemetry.position_velocity_ned()
        assert where.position.down_m == pytest.approx(-1.5, abs=0.2)
        yaw_deg = (await c.telemetry.attitude_euler()).yaw_deg
        await c.offboard.set_attitude(Attitude(0.0, 0.0, yaw_deg, HOVER_THRUST))
        await c.offboard.start()
        await c.offboard.set_attitude(Attitude(10.0, 0.0, yaw_deg, HOVER_THRUST))
        await asyncio.sleep(1.0)
        assert (await c.telemetry.attitude_euler()).roll_deg == pytest.approx(10.0, abs=1.0)
        assert await c.telemetry.flight_mode() == FlightMode.OFFBOARD
        await c.offboard.set_attitude(Attitude(-10.0, 0.0, yaw_deg, HOVER_THRUST))
        await asyncio.sleep(1.0)
        await c.offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 40.0, HOVER_THRUST))
        await asyncio.sleep(0.8)
        turned_deg = ((await c.telemetry.attitude_euler()).yaw_deg - yaw_deg) % 360.0
        assert turned_deg == pytest.approx(30.0, abs=15.0)
        with pytest.raises(ActionError):  # in the air
            await c.action.disarm()
        await c.offboard.stop()
        await c.wait_for_mode(FlightMode.HOLD)
        await c.action.land()
        await c.wait_until_disarmed()
        assert await c.telemetry.landed_state() == LandedState.ON_GROUND

    with stand_in(tmp_path, IDEAL) as process:
        fly(process, flight)
        flown = process.truth()
    assert max(row.z_m for row in flown) == pytest.approx(1.5, abs=0.5)
    offboard = [degrees(row.roll_rad) for row in flown if row.mode == "OFFBOARD"]
    assert max(offboard) == pytest.approx(11.5, abs=0.5)  # the measured overshoot is 1.5 degrees
    assert min(offboard) < -9.0


def test_mavsdk_repeats_the_last_setpoint_while_the_program_hangs(tmp_path: Path) -> None:
    async def flight(c: Client) -> None:
        await c.parameters.set_param_int("COM_OBL_RC_ACT", 4)
        await c.take_off()
        yaw_deg = (await c.telemetry.attitude_euler()).yaw_deg
        await c.offboard.set_attitude(Attitude(0.0, 0.0, yaw_deg, HOVER_THRUST))
        await c.offboard.start()
        time.sleep(2.5)  # the whole program hangs, its thread repeats the last setpoint
        assert await c.telemetry.flight_mode() == FlightMode.OFFBOARD

    with stand_in(tmp_path, IDEAL) as process:
        fly(process, flight)
        process.wait_for_mode("LAND")
        process.wait_until_disarmed()
        flown = process.truth()
    assert sum(row.mode == "OFFBOARD" for row in flown) > (2.5 + 1.0) * 50
    assert flown[-1].z_m == 0.0
