"""Accuracy of the automatic modes of the stand-in: in wind, with noise, and with the ideal attitude of the paper."""

from __future__ import annotations

from math import hypot
from typing import Any

import pytest

from companion.mavlink.codec import mavlink
from companion.types.values import Vector3
from sitl.autopilots.px4.autopilot import Px4Mode
from sitl.vehicle.config import Airframe, Wind
from stand_ins import DT_S, LEVEL, Px4OnBytes

WIND_OF_5_M_S = Wind(mean_enu_m_s=(4.0, 3.0, 0.0))
SIH_AIRFRAME = Airframe(drag_n_per_m_s=1.0)  # of PX4's simulator; about four times the usual drag


def worst_error_m(vehicle: Px4OnBytes, goal_m: Vector3, seconds: float) -> float:
    """Largest error in m of the true position to `goal_m`, over time and axes."""
    worst = 0.0
    for _ in range(round(seconds / 0.1)):
        vehicle.fly(0.1)
        position = vehicle.px4.quad.position_enu_m
        worst = max(worst, *(abs(a - b) for a, b in zip(position, goal_m, strict=True)))
    return worst


def test_a_vehicle_on_the_ground_is_not_moved_by_the_wind() -> None:
    vehicle = Px4OnBytes(airframe=SIH_AIRFRAME, wind=WIND_OF_5_M_S)
    vehicle.fly(5.0)
    vehicle.px4.arm()
    vehicle.fly(5.0)
    assert vehicle.px4.quad.position_enu_m == (0.0, 0.0, 0.0)


def test_hold_with_ideal_sensors_is_within_1_cm() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off(1.0)
    assert worst_error_m(vehicle, (0.0, 0.0, 1.0), 30.0) < 0.01


@pytest.mark.parametrize("airframe", [Airframe(), SIH_AIRFRAME])
def test_hold_is_within_1_cm_in_steady_wind(airframe: Airframe) -> None:
    vehicle = Px4OnBytes(airframe=airframe, wind=WIND_OF_5_M_S)
    vehicle.take_off(1.0)
    vehicle.fly(45.0)
    assert worst_error_m(vehicle, (0.0, 0.0, 1.0), 30.0) < 0.01


def test_hold_is_within_10_cm_of_the_estimate_with_noise_and_wind() -> None:
    vehicle = Px4OnBytes(sensors="default", wind=WIND_OF_5_M_S)
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


def test_landing_from_hold_keeps_the_position_in_wind() -> None:
    vehicle = Px4OnBytes(wind=WIND_OF_5_M_S)
    vehicle.take_off(3.0)
    vehicle.fly(25.0)
    vehicle.set_mode(Px4Mode.LAND)
    while vehicle.px4.armed:
        vehicle.fly(0.1)
        x, y, _ = vehicle.px4.quad.position_enu_m
        assert hypot(x, y) < 0.05


def test_the_wind_estimate_is_reset_between_flights() -> None:
    vehicle = Px4OnBytes(wind=WIND_OF_5_M_S)
    drifts = []
    for _ in range(2):
        x0, _, _ = vehicle.px4.quad.position_enu_m
        vehicle.take_off(1.0)
        drifts.append(vehicle.px4.quad.position_enu_m[0] - x0)
        vehicle.fly(15.0)
        vehicle.set_mode(Px4Mode.LAND)
        vehicle.fly(8.0)
        vehicle.set_mode(Px4Mode.LOITER)
    assert drifts[0] > 0.1
    assert drifts[1] == pytest.approx(drifts[0], rel=0.1)


@pytest.mark.parametrize("sensors", ["ideal", "default", "px4_sih"])
@pytest.mark.parametrize("airframe", [Airframe(), Airframe(attitude="instant"), SIH_AIRFRAME])
def test_every_airframe_takes_off_holds_and_lands(sensors: Any, airframe: Airframe) -> None:
    vehicle = Px4OnBytes(sensors=sensors, airframe=airframe)
    vehicle.take_off(1.0)
    assert vehicle.height_m == pytest.approx(1.0, abs=0.5)
    vehicle.fly(0.2, LEVEL)
    vehicle.set_mode(Px4Mode.OFFBOARD)
    vehicle.fly(0.5, LEVEL)
    vehicle.set_mode(Px4Mode.LAND)
    vehicle.fly(8.0)
    assert not vehicle.px4.armed
    assert vehicle.height_m == 0.0


def test_a_take_off_altitude_is_used_once() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off(1.0)
    vehicle.set_mode(Px4Mode.LAND)
    vehicle.fly(8.0)
    vehicle.set_mode(Px4Mode.TAKEOFF)  # without an altitude: MIS_TAKEOFF_ALT
    assert vehicle.px4.arm() is None
    vehicle.fly(8.0)
    assert vehicle.height_m == pytest.approx(2.5, abs=0.05)


def test_it_does_not_descend_to_take_off() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off(3.0)
    assert vehicle.px4.take_off(vehicle.altitude_amsl_m - 2.0)
    assert vehicle.texts()[-1] == "Already higher than takeoff altitude"
    vehicle.fly(5.0)
    assert vehicle.height_m == pytest.approx(3.0, abs=0.05)
    assert vehicle.px4.mode is Px4Mode.LOITER


def test_the_system_status_is_uninit_in_a_mode_that_prevents_arming() -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(5.0)
    vehicle.set_mode(Px4Mode.OFFBOARD)
    assert vehicle.px4.arm() == "Resolve system health failures first"  # there is no stream
    assert vehicle.px4.system_status == mavlink.MAV_STATE_UNINIT
    vehicle.set_mode(Px4Mode.LOITER)
    assert vehicle.px4.system_status == mavlink.MAV_STATE_STANDBY
    assert vehicle.px4.arm() is None


def test_landing_touches_the_ground_at_the_landing_speed() -> None:
    vehicle = Px4OnBytes(sensors="default")
    vehicle.take_off(3.0)
    vehicle.set_mode(Px4Mode.LAND)
    sink = 0.0
    while not vehicle.px4.quad.on_ground:
        sink = vehicle.px4.quad.velocity_enu_m_s[2]
        vehicle.fly(DT_S)
    assert sink == pytest.approx(-0.7, abs=0.15)
