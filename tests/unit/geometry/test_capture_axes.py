"""Axes of motion-capture systems: every choice is a rotation, there and back, and the usual ones are as they are drawn."""

from __future__ import annotations

from math import hypot, pi, radians

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geometry.capture_axes import CaptureAxes, CaptureAxis, UpAxis, cross
from companion.geometry.frames import Quaternion, euler_from_quaternion, quaternion_from_euler
from companion.geometry.vectors import dot
from companion.types.values import Vector3

LEVEL = (1.0, 0.0, 0.0, 0.0)
coordinate = st.floats(-100.0, 100.0)
positions = st.tuples(coordinate, coordinate, coordinate)
attitudes = st.builds(quaternion_from_euler, *[st.floats(-pi, pi)] * 3)
UPS: tuple[UpAxis, ...] = ("y", "z")
FORWARDS: tuple[CaptureAxis, ...] = ("x", "-x", "y", "-y", "z", "-z")


@st.composite
def axes(draw: st.DrawFn) -> CaptureAxes:
    up = draw(st.sampled_from(UPS))
    forward = draw(st.sampled_from([name for name in FORWARDS if name.removeprefix("-") != up]))
    return CaptureAxes.of(up, forward, draw(st.floats(-180.0, 180.0)))


def rotated(quaternion: Quaternion, vector: Vector3) -> Vector3:
    w, *axis = quaternion
    u = (axis[0], axis[1], axis[2])
    x, y, z = (w * w - dot(u, u)) * 1.0, 2.0 * dot(u, vector), 2.0 * w
    a, b, c = cross(u, vector)
    return (x * vector[0] + y * u[0] + z * a, x * vector[1] + y * u[1] + z * b, x * vector[2] + y * u[2] + z * c)


@given(axes(), positions, attitudes)
def test_there_and_back(capture: CaptureAxes, position: Vector3, quaternion: Quaternion) -> None:
    back = capture.to_fleet(*capture.to_capture(position, quaternion))
    assert back[0] == pytest.approx(position, abs=1e-9)
    assert back[1] == pytest.approx(quaternion, abs=1e-9)


@given(axes(), positions, positions)
def test_positions_are_rotated_never_mirrored(capture: CaptureAxes, a: Vector3, b: Vector3) -> None:
    def to_fleet(vector: Vector3) -> Vector3:
        return capture.to_fleet(vector, LEVEL)[0]

    assert hypot(*to_fleet(a)) == pytest.approx(hypot(*a), abs=1e-9)
    assert to_fleet(cross(a, b)) == pytest.approx(cross(to_fleet(a), to_fleet(b)), abs=1e-6)


@given(axes(), positions, attitudes)
def test_a_point_of_the_body_lands_where_the_body_has_it(
    capture: CaptureAxes, point_flu: Vector3, quaternion: Quaternion
) -> None:
    """A body has the axes of its frame: a point of it that the cameras find in the room, the fleet finds at the same place."""
    level = CaptureAxes(capture.forward, capture.left, capture.up, 0.0)
    in_body = level.to_capture(point_flu, LEVEL)[0]
    in_room = rotated(quaternion, in_body)
    assert rotated(capture.to_fleet((0.0, 0.0, 0.0), quaternion)[1], point_flu) == pytest.approx(
        capture.to_fleet(in_room, LEVEL)[0], abs=1e-6
    )


@pytest.mark.parametrize(
    ("up", "forward", "turn_deg", "capture", "enu"),
    [
        ("z", "x", 0.0, (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)),
        ("y", "x", 0.0, (1.0, 2.0, 3.0), (1.0, -3.0, 2.0)),
        ("y", "-z", 0.0, (1.0, 2.0, 3.0), (-3.0, -1.0, 2.0)),
        ("z", "-x", 0.0, (1.0, 2.0, 3.0), (-1.0, -2.0, 3.0)),
        ("z", "y", 0.0, (1.0, 2.0, 3.0), (2.0, -1.0, 3.0)),
        ("z", "x", 90.0, (1.0, 2.0, 3.0), (-2.0, 1.0, 3.0)),
    ],
)
def test_usual_frames(up: UpAxis, forward: CaptureAxis, turn_deg: float, capture: Vector3, enu: Vector3) -> None:
    assert CaptureAxes.of(up, forward, turn_deg).to_fleet(capture, LEVEL)[0] == pytest.approx(enu)


def test_a_body_that_turns_left_about_the_y_axis_yaws_left_in_the_fleet() -> None:
    half = radians(30.0) / 2.0
    about_y = quaternion_from_euler(0.0, 2.0 * half, 0.0)
    _, quaternion = CaptureAxes.of("y", "x").to_fleet((0.0, 0.0, 0.0), about_y)
    assert euler_from_quaternion(quaternion) == pytest.approx((0.0, 0.0, radians(30.0)))


def test_a_frame_that_stands_askew_turns_position_and_nose() -> None:
    _, quaternion = CaptureAxes.of("z", "x", 40.0).to_fleet((0.0, 0.0, 0.0), LEVEL)
    assert euler_from_quaternion(quaternion)[2] == pytest.approx(radians(40.0))
