"""How well the stand-in flies its own modes: in wind, with noise, and with the ideal attitude of the paper."""

from __future__ import annotations

from math import hypot
from typing import Any

import pytest
from sitl_vehicle import DT_S, LEVEL, Vehicle

from companion.mavlink.codec import mavlink
from companion.types import Vector3
from sitl.config import Airframe, Wind
from sitl.px4_modes import Mode

WIND_OF_5_M_S = Wind(mean_enu_m_s=(4.0, 3.0, 0.0))
SIH_AIRFRAME = Airframe(drag_n_per_m_s=1.0)  # as PX4's simulator has it; about four times as much as is usual


def worst_error_m(vehicle: Vehicle, goal_m: Vector3, seconds: float) -> float:
    """Of the true position against `goal_m`, largest of all axes."""
    worst = 0.0
    for _ in range(round(seconds / 0.1)):
        vehicle.fly(0.1)
        position = vehicle.px4.quad.position_enu_m
        worst = max(worst, *(abs(a - b) for a, b in zip(position, goal_m, strict=True)))
    return worst


def test_the_ground_holds_it_against_the_wind() -> None:
    vehicle = Vehicle(airframe=SIH_AIRFRAME, wind=WIND_OF_5_M_S)
    vehicle.fly(5.0)
    vehicle.px4.arm()
    vehicle.fly(5.0)
    assert vehicle.px4.quad.position_enu_m == (0.0, 0.0, 0.0)


def test_hold_with_ideal_sensors_is_within_1_cm() -> None:
    vehicle = Vehicle()
    vehicle.take_off(1.0)
    assert worst_error_m(vehicle, (0.0, 0.0, 1.0), 30.0) < 0.01


@pytest.mark.parametrize("airframe", [Airframe(), SIH_AIRFRAME])
def test_hold_leans_into_the_wind(airframe: Airframe) -> None:
    vehicle = Vehicle(airframe=airframe, wind=WIND_OF_5_M_S)
    vehicle.take_off(1.0)
    vehicle.fly(45.0)
    assert worst_error_m(vehicle, (0.0, 0.0, 1.0), 30.0) < 0.01


def test_hold_with_noise_in_the_wind_follows_the_estimate_within_a_tenth_of_a_metre() -> None:
    vehicle = Vehicle(sensors="default", wind=WIND_OF_5_M_S)
    vehicle.fly(4.2)
    goal = vehicle.px4.quad.estimated_position_local_enu_m()
    vehicle.take_off(1.0)
    vehicle.fly(15.0)
    squares, count = 0.0, 300
    for _ in range(count):
        vehicle.fly(0.1)
        x, y, z = vehicle.px4.quad.estimated_position_local_enu_m()
        squares += (x - goal[0]) ** 2 + (y - goal[1]) ** 2 + (z - goal[2] - 1.0) ** 2
    assert (squares / count) ** 0.5 < 0.1


def test_landing_from_hold_in_the_wind_stays_on_the_spot() -> None:
    vehicle = Vehicle(wind=WIND_OF_5_M_S)
    vehicle.take_off(3.0)
    vehicle.fly(25.0)
    vehicle.set_mode(Mode.LAND)
    while vehicle.px4.armed:
        vehicle.fly(0.1)
        x, y, _ = vehicle.px4.quad.position_enu_m
        assert hypot(x, y) < 0.05


def test_a_new_flight_begins_without_the_wind_of_the_last() -> None:
    vehicle = Vehicle(wind=WIND_OF_5_M_S)
    drifts = []
    for _ in range(2):
        x0, _, _ = vehicle.px4.quad.position_enu_m
        vehicle.take_off(1.0)
        drifts.append(vehicle.px4.quad.position_enu_m[0] - x0)
        vehicle.fly(15.0)
        vehicle.set_mode(Mode.LAND)
        vehicle.fly(8.0)
        vehicle.set_mode(Mode.LOITER)
    assert drifts[0] > 0.1
    assert drifts[1] == pytest.approx(drifts[0], rel=0.1)


@pytest.mark.parametrize("sensors", ["ideal", "default", "px4_sih"])
@pytest.mark.parametrize("airframe", [Airframe(), Airframe(attitude="instant"), SIH_AIRFRAME])
def test_every_airframe_takes_off_holds_and_lands(sensors: Any, airframe: Airframe) -> None:
    vehicle = Vehicle(sensors=sensors, airframe=airframe)
    vehicle.take_off(1.0)
    assert vehicle.height_m == pytest.approx(1.0, abs=0.5)
    vehicle.fly(0.2, LEVEL)
    vehicle.set_mode(Mode.OFFBOARD)
    vehicle.fly(0.5, LEVEL)
    vehicle.set_mode(Mode.LAND)
    vehicle.fly(8.0)
    assert not vehicle.px4.armed
    assert vehicle.height_m == 0.0


def test_an_altitude_to_take_off_to_counts_once() -> None:
    vehicle = Vehicle()
    vehicle.take_off(1.0)
    vehicle.set_mode(Mode.LAND)
    vehicle.fly(8.0)
    vehicle.set_mode(Mode.TAKEOFF)  # without one: MIS_TAKEOFF_ALT
    assert vehicle.px4.arm() is None
    vehicle.fly(8.0)
    assert vehicle.height_m == pytest.approx(2.5, abs=0.05)


def test_it_does_not_descend_to_take_off() -> None:
    vehicle = Vehicle()
    vehicle.take_off(3.0)
    assert vehicle.px4.take_off(vehicle.altitude_amsl_m - 2.0)
    assert vehicle.texts()[-1] == "Already higher than takeoff altitude"
    vehicle.fly(5.0)
    assert vehicle.height_m == pytest.approx(3.0, abs=0.05)
    assert vehicle.px4.mode is Mode.LOITER


def test_a_mode_that_cannot_be_armed_in_shows_in_the_status() -> None:
    vehicle = Vehicle()
    vehicle.fly(5.0)
    vehicle.set_mode(Mode.OFFBOARD)
    assert vehicle.px4.arm() == "Resolve system health failures first"  # there is no stream
    assert vehicle.px4.system_status == mavlink.MAV_STATE_UNINIT
    vehicle.set_mode(Mode.LOITER)
    assert vehicle.px4.system_status == mavlink.MAV_STATE_STANDBY
    assert vehicle.px4.arm() is None


def test_landing_touches_the_ground_at_the_landing_speed() -> None:
    vehicle = Vehicle(sensors="default")
    vehicle.take_off(3.0)
    vehicle.set_mode(Mode.LAND)
    sink = 0.0
    while not vehicle.px4.quad.stands:
        sink = vehicle.px4.quad.velocity_enu_m_s[2]
        vehicle.fly(DT_S)
    assert sink == pytest.approx(-0.7, abs=0.15)
