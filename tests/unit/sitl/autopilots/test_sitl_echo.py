"""ATTITUDE_TARGET of the PX4 stand-in: delay and rate after a setpoint."""

from __future__ import annotations

import pytest

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink.codec import mavlink
from sitl.autopilots.px4.autopilot import Px4Mode
from sitl.vehicle.control import AttitudeSetpoint
from stand_ins import DT_S, HOVER, LEVEL, Px4OnBytes

SET_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
ATTITUDE_TARGET = mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET


def flying(interval_us: float) -> Px4OnBytes:
    vehicle = Px4OnBytes()
    vehicle.offboard()
    assert vehicle.results(SET_INTERVAL, ATTITUDE_TARGET, interval_us) == [mavlink.MAV_RESULT_ACCEPTED]
    vehicle.fly(0.1, LEVEL)
    vehicle.sent.clear()
    return vehicle


@pytest.mark.parametrize("phase_s", [0.0, 0.004, 0.008, 0.012])
def test_a_setpoint_is_echoed_within_10_ms(phase_s: float) -> None:
    vehicle = flying(8_000.0)
    vehicle.fly(phase_s)
    vehicle.sent.clear()
    vehicle.px4.take_setpoint(AttitudeSetpoint(quaternion_from_euler(0.1, 0.0, 0.0), HOVER))
    vehicle.fly(0.008)
    (echo,) = vehicle.messages("ATTITUDE_TARGET")
    assert 2.0 * echo.q[1] == pytest.approx(0.0707, abs=0.001)  # half of the roll, seen from a yaw of 90 degrees NED
    assert echo.thrust == pytest.approx(HOVER)


def test_each_setpoint_is_echoed_once_and_no_faster_than_requested() -> None:
    vehicle = flying(8_000.0)
    vehicle.fly(1.0, AttitudeSetpoint(LEVEL.quaternion, LEVEL.thrust_norm), stream_hz=50.0)
    assert len(vehicle.messages("ATTITUDE_TARGET")) == 1  # one setpoint, however often it is repeated
    for _ in range(50):
        vehicle.fly(0.02, AttitudeSetpoint(LEVEL.quaternion, LEVEL.thrust_norm))
    assert len(vehicle.messages("ATTITUDE_TARGET")) == pytest.approx(51, abs=1)
    slow = flying(100_000.0)
    for _ in range(50):
        slow.fly(0.02, AttitudeSetpoint(LEVEL.quaternion, LEVEL.thrust_norm))
    assert len(slow.messages("ATTITUDE_TARGET")) == pytest.approx(10, abs=1)


def test_setpoints_of_automatic_modes_are_reported() -> None:
    vehicle = flying(100_000.0)
    vehicle.set_mode(Px4Mode.LOITER)
    vehicle.sent.clear()
    vehicle.fly(250 * DT_S)
    assert len(vehicle.messages("ATTITUDE_TARGET")) == pytest.approx(10, abs=1)
