"""Frame conversions against hand-computed cases, and their inverses."""

from math import pi, radians

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geometry.frames import (
    enu_from_geodetic,
    enu_from_ned,
    euler_enu_from_ned,
    euler_from_quaternion,
    geodetic_from_enu,
    ned_from_enu,
    quaternion_from_euler,
    wrap_degrees,
    wrap_pi,
)

metre = st.floats(-1000.0, 1000.0)
tilt = st.floats(-1.5, 1.5)
heading = st.floats(-3.14, 3.14)
degree = st.floats(-180.0, 180.0)
inhabited = st.floats(-85.0, 85.0)
ORIGIN = (47.397742, 8.545594, 488.0)


def test_ned_is_converted_to_enu() -> None:
    assert enu_from_ned((1.0, 2.0, -3.0)) == (2.0, 1.0, 3.0)


@given(metre, metre, metre)
def test_enu_and_ned_are_inverse(x: float, y: float, z: float) -> None:
    assert ned_from_enu(enu_from_ned((x, y, z))) == (x, y, z)


def test_euler_of_a_nose_up_vehicle_facing_north() -> None:
    # FRD in NED: yaw 0 is north, positive pitch is nose up. FLU in ENU: north is +90 degrees, nose up is negative pitch.
    assert euler_enu_from_ned(0.1, 0.2, 0.0) == pytest.approx((0.1, -0.2, pi / 2))


@given(tilt, tilt, heading)
def test_euler_conversion_is_its_own_inverse(roll: float, pitch: float, yaw: float) -> None:
    assert euler_enu_from_ned(*euler_enu_from_ned(roll, pitch, yaw)) == pytest.approx((roll, pitch, yaw), abs=1e-12)


@given(tilt, tilt, heading)
def test_quaternion_and_euler_are_inverse(roll: float, pitch: float, yaw: float) -> None:
    assert euler_from_quaternion(quaternion_from_euler(roll, pitch, yaw)) == pytest.approx((roll, pitch, yaw), abs=1e-7)


def test_invalid_quaternion_is_refused() -> None:
    with pytest.raises(ValueError, match="norm"):
        euler_from_quaternion((2.0, 0.0, 0.0, 0.0))


@given(st.floats(-100.0, 100.0))
def test_angle_is_wrapped_to_plus_minus_pi(angle: float) -> None:
    wrapped = wrap_pi(angle)
    assert -pi <= wrapped < pi
    assert (angle - wrapped) / (2 * pi) == pytest.approx(round((angle - wrapped) / (2 * pi)), abs=1e-9)


def test_length_of_a_degree_at_zurich() -> None:
    # WGS84: 111.177 km per degree of latitude and 75.5 km per degree of longitude at 47.4 degrees north.
    east, north, up = enu_from_geodetic(ORIGIN[0] + 0.001, ORIGIN[1] + 0.001, 490.0, ORIGIN)
    assert north == pytest.approx(111.177, abs=0.02)
    assert east == pytest.approx(75.49, abs=0.05)
    assert up == pytest.approx(2.0)


@given(metre, metre, metre)
def test_geodetic_and_enu_are_inverse(x: float, y: float, z: float) -> None:
    assert enu_from_geodetic(*geodetic_from_enu((x, y, z), ORIGIN), ORIGIN) == pytest.approx((x, y, z), abs=1e-6)


@given(inhabited, degree, metre, metre)
def test_geodetic_and_enu_are_inverse_around_the_globe(lat_deg: float, lon_deg: float, x: float, y: float) -> None:
    origin = (lat_deg, lon_deg, 488.0)
    place = geodetic_from_enu((x, y, 0.0), origin)
    assert -180.0 <= place[1] <= 180.0
    assert enu_from_geodetic(*place, origin) == pytest.approx((x, y, 0.0), abs=1e-6)


@given(inhabited, degree, st.floats(-0.01, 0.01))
def test_neighbours_are_near_on_both_sides_of_each_meridian(lat_deg: float, lon_deg: float, east_deg: float) -> None:
    there_deg = wrap_degrees(lon_deg + east_deg)
    east, north, _ = enu_from_geodetic(lat_deg, there_deg, 0.0, (lat_deg, lon_deg, 0.0))
    assert (abs(east) <= 0.0101 * 111_320.0, north) == (True, 0.0)
    west, _, _ = enu_from_geodetic(lat_deg, lon_deg, 0.0, (lat_deg, there_deg, 0.0))
    assert west == pytest.approx(-east, abs=1e-6)


@given(degree)
def test_a_longitude_within_half_a_turn_keeps_its_bits(longitude_deg: float) -> None:
    assert wrap_degrees(longitude_deg) == longitude_deg
    assert wrap_degrees(longitude_deg + 360.0) == pytest.approx(wrap_degrees(longitude_deg - 360.0), abs=1e-9) or (
        abs(longitude_deg) == pytest.approx(180.0)
    )


def test_twenty_metres_across_the_180th_meridian() -> None:
    origin = (-16.8, 179.9999, 10.0)
    assert enu_from_geodetic(-16.8, -179.9999, 10.0, origin)[0] == pytest.approx(21.3, abs=0.1)
    assert geodetic_from_enu((21.3, 0.0, 0.0), origin)[1] == pytest.approx(-179.9999, abs=1e-6)


def test_nose_down_pitch_accelerates_forward() -> None:
    # A quaternion of +10 degrees pitch in FLU turns body up (z) towards body forward (x).
    w, x, y, z = quaternion_from_euler(0.0, radians(10.0), 0.0)
    up_x = 2.0 * (x * z + w * y)
    assert up_x > 0.0
