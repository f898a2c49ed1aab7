"""Step response of the attitude loop against measurements, and the reaction to unusual setpoints."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, radians

import pytest

from companion.geometry.frames import euler_from_quaternion, quaternion_from_euler
from companion.mavlink.codec import mavlink
from companion.types.values import GRAVITY_M_S2
from sitl.vehicle.config import Airframe
from sitl.vehicle.control import AttitudeSetpoint, rotation_error
from stand_ins import DT_S, HOVER, LEVEL, Px4OnBytes

WITHIN = 0.15


@dataclass(frozen=True)
class Response:
    at_ms: dict[int, float]  # share of the step in percent -> time when it was passed
    overshoot_deg: float
    peak_rate_deg_s: float


def step_response(axis: int, step_deg: float) -> Response:
    """Response of the true angle to a step of the OFFBOARD setpoint."""
    vehicle = Px4OnBytes()
    vehicle.offboard()
    angles = [0.0, 0.0, 0.0]
    angles[axis] = radians(step_deg)
    setpoint = AttitudeSetpoint(quaternion_from_euler(*angles), HOVER)
    seen, peak = [], 0.0
    for step in range(round(1.2 / DT_S)):
        if step % 5 == 0:
            vehicle.px4.take_setpoint(setpoint)
        vehicle.px4.step()
        seen.append(degrees(euler_from_quaternion(vehicle.px4.quad.quaternion)[axis]))
        peak = max(peak, abs(degrees(vehicle.px4.quad.rates_rad_s[axis])))
    at_ms = {
        share: next((i + 1) * DT_S * 1000.0 for i, angle in enumerate(seen) if angle >= share / 100 * step_deg)
        for share in (10, 50, 90)
    }
    return Response(at_ms, max(seen) - step_deg, peak)


@pytest.mark.parametrize("axis", [0, 1], ids=["roll", "pitch"])
def test_tilt_step_of_10_degrees(axis: int) -> None:
    response = step_response(axis, 10.0)
    assert response.at_ms[10] == pytest.approx(117.0, rel=WITHIN)
    assert response.at_ms[50] == pytest.approx(198.0, rel=WITHIN)
    assert response.at_ms[90] == pytest.approx(278.0, rel=WITHIN)
    assert response.overshoot_deg == pytest.approx(1.5, rel=WITHIN)


def test_yaw_step_of_60_degrees() -> None:
    response = step_response(2, 60.0)
    assert response.at_ms[90] == pytest.approx(810.0, rel=WITHIN)
    assert response.peak_rate_deg_s <= 109.0
    assert response.peak_rate_deg_s > 100.0


def test_the_error_is_the_same_for_q_and_minus_q() -> None:
    wanted = quaternion_from_euler(0.2, -0.1, 2.0)
    w, x, y, z = wanted
    measured = quaternion_from_euler(0.0, 0.1, -1.0)
    assert rotation_error(measured, (-w, -x, -y, -z)) == pytest.approx(rotation_error(measured, wanted))


def test_a_large_turn_does_not_disturb_the_tilt() -> None:
    tilt_x, tilt_y, turn = rotation_error(quaternion_from_euler(0.0, 0.0, 0.0), quaternion_from_euler(0.0, 0.0, 2.5))
    assert (tilt_x, tilt_y) == pytest.approx((0.0, 0.0))
    assert turn > 1.5
    for yaw in (0.0, 1.0, 2.5, 3.1):  # the wanted tilt in the present body axes is the same for every turn
        wanted = quaternion_from_euler(0.0, 0.2, yaw)
        x, y, _ = rotation_error(quaternion_from_euler(0.0, 0.0, 0.0), wanted)
        assert (x**2 + y**2) ** 0.5 == pytest.approx(0.2, rel=0.01)


def target(mask: int = 7, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0), thrust: float = HOVER, **more: object) -> object:
    ids = more.pop("ids", (1, 1))
    rates = more.pop("rates", (0.0, 0.0, 0.0))
    return mavlink.MAVLink_set_attitude_target_message(0, *ids, mask, q, *rates, thrust)  # type: ignore[misc]


def flown(message: object, seconds: float = 0.6, vehicle: Px4OnBytes | None = None) -> Px4OnBytes:
    """The vehicle after a hover in OFFBOARD and this SET_ATTITUDE_TARGET at 50 Hz."""
    vehicle = vehicle or Px4OnBytes()
    vehicle.offboard()
    for _ in range(round(seconds / 0.02)):
        vehicle.send(message)
        vehicle.fly(0.02)
    return vehicle


@pytest.mark.parametrize("ids", [(0, 0), (1, 0), (1, 1)])
def test_setpoints_to_this_vehicle_are_followed(ids: tuple[int, int]) -> None:
    vehicle = flown(target(thrust=0.6, ids=ids))
    assert vehicle.px4.setpoint.thrust_norm == pytest.approx(0.6)


@pytest.mark.parametrize("ids", [(2, 1), (1, 2), (0, 1), (255, 0)])
def test_setpoints_to_other_targets_are_ignored(ids: tuple[int, int]) -> None:
    assert flown(target(thrust=0.6, ids=ids)).px4.setpoint.thrust_norm == HOVER


@pytest.mark.parametrize(
    "message",
    [
        target(thrust=float("nan")),
        target(thrust=-0.1),
        target(thrust=float("-inf")),
        target(mask=7 | 0x40),
        target(q=(float("nan"), 0.0, 0.0, 0.0)),
        target(q=(0.0, 0.0, 0.0, 0.0)),
    ],
    ids=["NaN thrust", "negative thrust", "-inf thrust", "throttle ignored", "NaN q", "zero q"],
)
def test_it_falls_when_the_setpoint_is_invalid(message: object) -> None:
    vehicle = flown(message, 0.5)
    assert vehicle.px4.quad.velocity_enu_m_s[2] < -3.0


@pytest.mark.parametrize("factor", [3.0, -1.0, 0.2])
def test_a_scaled_or_negated_quaternion_is_followed(factor: float) -> None:
    roll_ned = quaternion_from_euler(radians(10.0), 0.0, radians(90.0))
    vehicle = flown(target(q=tuple(factor * part for part in roll_ned)), 1.0)
    roll, pitch, yaw = euler_from_quaternion(vehicle.px4.quad.quaternion)
    assert (degrees(roll), degrees(pitch), degrees(yaw)) == pytest.approx((10.0, 0.0, 0.0), abs=1.0)


def test_tilt_is_not_clamped() -> None:
    vehicle = flown(target(q=quaternion_from_euler(radians(50.0), 0.0, radians(90.0))), 1.0)
    assert degrees(euler_from_quaternion(vehicle.px4.quad.quaternion)[0]) == pytest.approx(50.0, abs=2.0)


def test_pitch_and_yaw_follow_the_conventions_of_mavlink() -> None:
    """Nose down in FRD is a positive pitch in FLU; yaw 0 in NED is north, yaw 90 degrees in ENU."""
    vehicle = flown(target(q=quaternion_from_euler(0.0, radians(-10.0), 0.0)), 3.0)
    _, pitch, yaw = euler_from_quaternion(vehicle.px4.quad.quaternion)
    assert (degrees(pitch), degrees(yaw)) == pytest.approx((10.0, 90.0), abs=1.0)
    east, north, _ = vehicle.px4.quad.velocity_enu_m_s
    assert north > 1.0
    assert abs(east) < north


def test_rates_are_followed() -> None:
    vehicle = flown(target(mask=0x80, rates=(0.0, 0.0, radians(30.0))), 1.0)
    yaw_rate_flu = degrees(vehicle.px4.quad.rates_rad_s[2])
    assert yaw_rate_flu == pytest.approx(-30.0, abs=1.0)


def test_the_yaw_rate_is_fed_forward() -> None:
    """type_mask 3: without the feed-forward the heading stays, with it the heading is ahead by a constant angle."""
    plain = quaternion_from_euler(0.0, 0.0, radians(90.0))
    with_it = flown(target(mask=3, q=plain, rates=(0.0, 0.0, radians(20.0))), 2.0)
    without = flown(target(mask=7, q=plain, rates=(0.0, 0.0, radians(20.0))), 2.0)
    assert abs(degrees(euler_from_quaternion(without.px4.quad.quaternion)[2])) < 0.5
    assert degrees(euler_from_quaternion(with_it.px4.quad.quaternion)[2]) == pytest.approx(-8.0, abs=1.0)


@pytest.mark.parametrize("thrust", [0.4, 0.49, 0.6, 1.0])
def test_thrust_is_linear_about_hover(thrust: float) -> None:
    vehicle = Px4OnBytes(airframe=Airframe(drag_n_per_m_s=0.0))
    vehicle.offboard()
    vehicle.fly(0.5, AttitudeSetpoint(LEVEL.quaternion, thrust))
    before = vehicle.px4.quad.velocity_enu_m_s[2]
    vehicle.fly(0.1, AttitudeSetpoint(LEVEL.quaternion, thrust))
    acceleration = (vehicle.px4.quad.velocity_enu_m_s[2] - before) / 0.1
    assert acceleration == pytest.approx(GRAVITY_M_S2 * thrust / HOVER - GRAVITY_M_S2, abs=0.01)


def test_the_ideal_airframe_is_a_double_integrator() -> None:
    vehicle = Px4OnBytes(airframe=Airframe(attitude="instant", motor_lag_s=0.0, drag_n_per_m_s=0.0))
    vehicle.offboard()
    x0, _, _ = vehicle.px4.quad.position_enu_m
    v0, _, _ = vehicle.px4.quad.velocity_enu_m_s
    pitch = radians(10.0)
    setpoint = AttitudeSetpoint(quaternion_from_euler(0.0, pitch, 0.0), HOVER)
    vehicle.fly(1.0, setpoint)
    x, _, _ = vehicle.px4.quad.position_enu_m
    acceleration = GRAVITY_M_S2 * 0.17364817766693033  # sin(10 degrees)
    assert x - x0 - v0 == pytest.approx(0.5 * acceleration, abs=1e-6)
