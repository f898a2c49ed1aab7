"""Estimator errors, gusts and origins: their configured size, their seeds and their consistency."""

from __future__ import annotations

from math import sqrt
from random import Random
from statistics import fmean, pstdev

import pytest

from companion.geometry.frames import enu_from_geodetic, enu_from_ned
from companion.mavlink.codec import mavlink
from sitl.vehicle.config import SENSORS, Sensors, Wind
from sitl.vehicle.disturbances import GaussMarkov, Normals
from stand_ins import Px4OnBytes


def ensemble(sensors: Sensors, seconds: float = 0.0, number: int = 200) -> list[Px4OnBytes]:
    """Vehicles that differ only in their seeds."""
    vehicles = [Px4OnBytes(sensors=sensors, seed=seed) for seed in range(number)]
    for vehicle in vehicles:
        vehicle.fly(seconds)
    return vehicles


def position_error_m(vehicle: Px4OnBytes, axis: int) -> float:
    quad = vehicle.px4.quad
    origin = enu_from_geodetic(*quad.origin, quad.world_origin)
    return quad.estimated_position_local_enu_m()[axis] + origin[axis] - quad.position_enu_m[axis]


def test_normal_numbers_are_those_of_random_gauss() -> None:
    normals, random = Normals(Random(7)), Random(7)
    for count in (3, 12, 1, 2, 12):
        assert normals.take(count) == [random.gauss(0.0, 1.0) for _ in range(count)]


def test_gauss_markov_has_its_spread_from_the_start_and_decorrelates_within_its_time() -> None:
    starts, later = [], []
    for seed in range(2000):
        normals = Normals(Random(seed))
        process = GaussMarkov(normals, (0.3, 0.3, 0.3), 2.0, 0.1)
        starts.append(process.value[0])
        for _ in range(20):
            process.step(*normals.take(3))
        later.append(process.value[0])
    assert pstdev(starts) == pytest.approx(0.3, rel=0.06)
    assert pstdev(later) == pytest.approx(0.3, rel=0.06)
    correlation = fmean(a * b for a, b in zip(starts, later, strict=True)) / 0.3**2
    assert correlation == pytest.approx(0.368, abs=0.06)  # 1/e after its time


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_position_error_has_the_configured_spread(axis: int) -> None:
    sensors = SENSORS["px4_sih"]
    errors = [position_error_m(vehicle, axis) for vehicle in ensemble(sensors)]
    assert pstdev(errors) == pytest.approx(sensors.position_sd_m[axis], rel=0.2)
    assert abs(fmean(errors)) < 3.0 * sensors.position_sd_m[axis] / sqrt(len(errors))


def test_velocity_and_attitude_errors_have_the_configured_spread() -> None:
    sensors = Sensors(velocity_sd_m_s=0.1, velocity_white_sd_m_s=0.05, attitude_sd_deg=1.0)
    vehicles = ensemble(sensors)
    velocities = [vehicle.px4.quad.estimated_velocity_enu_m_s()[0] for vehicle in vehicles]
    rolls = [vehicle.px4.quad.estimated_euler_rad()[0] for vehicle in vehicles]
    assert pstdev(velocities) == pytest.approx(sqrt(0.1**2 + 0.05**2), rel=0.2)
    assert pstdev(rolls) == pytest.approx(0.01745, rel=0.2)


def test_ideal_sensors_have_no_error() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    quad = vehicle.px4.quad
    assert all(position_error_m(vehicle, axis) == pytest.approx(0.0, abs=1e-9) for axis in range(3))
    assert quad.estimated_velocity_enu_m_s() == quad.velocity_enu_m_s
    assert quad.estimated_quaternion() == quad.quaternion


def test_flights_with_the_same_seed_are_identical() -> None:
    def flight(seed: int, vehicle_id: int) -> tuple[float, ...]:
        wind = Wind(mean_enu_m_s=(1.0, 0.0, 0.0), gust_sd_m_s=0.5)
        vehicle = Px4OnBytes(sensors="px4_sih", wind=wind, seed=seed, vehicle_id=vehicle_id)
        vehicle.fly(4.2)
        vehicle.px4.arm()
        vehicle.px4.take_off(None)
        vehicle.fly(4.0)
        return (*vehicle.px4.quad.state, *vehicle.px4.quad.origin)

    assert flight(7, 2) == flight(7, 2)
    assert flight(7, 2) != flight(8, 2)
    assert flight(7, 2) != flight(7, 3)


def test_origins_have_the_configured_spread() -> None:
    sensors = SENSORS["default"]
    vehicles = ensemble(sensors)
    for axis in range(3):
        positions = [
            enu_from_geodetic(*vehicle.px4.quad.origin, vehicle.px4.quad.world_origin)[axis] for vehicle in vehicles
        ]
        assert pstdev(positions) == pytest.approx(sensors.origin_sd_m[axis], rel=0.2)


@pytest.mark.parametrize("rebased", [False, True])
def test_local_and_global_position_agree_to_1_cm(rebased: bool) -> None:
    vehicle = Px4OnBytes(sensors="px4_sih")
    vehicle.take_off()
    if rebased:
        vehicle.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473_978_000, 85_456_500, 480_000))
    quad = vehicle.px4.quad
    local, wide = (
        vehicle.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)[0]
        for number in (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    )
    position = enu_from_geodetic(wide.lat / 1e7, wide.lon / 1e7, wide.alt / 1e3, quad.origin)
    assert enu_from_ned((local.x, local.y, local.z)) == pytest.approx(position, abs=0.011)


def test_the_true_position_is_unchanged_by_a_new_origin() -> None:
    vehicle = Px4OnBytes(sensors=Sensors(origin_sd_m=(0.3, 0.3, 0.8)))
    vehicle.take_off()
    before = vehicle.px4.quad.position_enu_m
    vehicle.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473_978_000, 85_456_500, 480_000))
    assert vehicle.px4.quad.origin == (47.3978, 8.54565, 480.0)
    vehicle.fly(5.0)
    assert vehicle.px4.quad.position_enu_m == pytest.approx(before, abs=0.02)


def test_gusts_move_the_vehicle_about_its_hold_position() -> None:
    calm, windy = (
        Px4OnBytes(wind=Wind(mean_enu_m_s=(mean, 0.0, 0.0), gust_sd_m_s=sd)) for mean, sd in ((0, 0), (4, 1))
    )
    for vehicle in (calm, windy):
        vehicle.take_off()
    assert calm.px4.quad.position_enu_m[0] == pytest.approx(0.0, abs=0.01)
    xs = []
    for _ in range(50):
        windy.fly(0.2)
        xs.append(windy.px4.quad.position_enu_m[0])
    assert pstdev(xs) > 0.01
    assert abs(fmean(xs[25:])) < 0.6  # hold leans into the wind
