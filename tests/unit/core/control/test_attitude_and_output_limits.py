"""Eq. 7 and 8 (corrected) against eq. 2, and output limits with arbitrary setpoints."""

from math import cos, hypot, inf, nan, pi, radians, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.control.setpoint import attitude_target, level_acceleration, limit_acceleration
from companion.core.safety.limits import OutputLimiter, OutputLimits
from companion.geometry.airspace import Fence
from companion.types.autopilot import AttitudeTarget
from companion.types.values import GRAVITY_M_S2

LIMITS = OutputLimits(
    max_tilt_rad=radians(25.0),
    max_tilt_rate_rad_s=radians(200.0),
    min_thrust_ratio=0.3,
    max_thrust_ratio=1.6,
    max_thrust_rate_1_s=10.0,
    fence=Fence((-10.0, -10.0, 0.0), (10.0, 10.0, 20.0)),
)
LEVEL = AttitudeTarget(0.0, 0.0, 0.0, 0.5)
acceleration = st.floats(-8.0, 8.0)
angle = st.floats(-pi, pi)
anything = st.floats(allow_nan=True, allow_infinity=True)


def resultant(target: AttitudeTarget, hover_thrust_norm: float) -> tuple[float, float, float]:
    """Acceleration of a vehicle with this attitude and thrust (eq. 2)."""
    force = target.thrust_norm / hover_thrust_norm * GRAVITY_M_S2
    phi, theta, psi = target.roll_rad, target.pitch_rad, target.yaw_rad
    return (
        (sin(psi) * sin(phi) + cos(psi) * cos(phi) * sin(theta)) * force,
        (cos(phi) * sin(psi) * sin(theta) - cos(psi) * sin(phi)) * force,
        cos(theta) * cos(phi) * force - GRAVITY_M_S2,
    )


@given(acceleration, acceleration, acceleration, angle)
def test_attitude_and_thrust_give_the_commanded_acceleration(ux: float, uy: float, uz: float, yaw: float) -> None:
    wanted = (ux, uy, uz)
    first = attitude_target(wanted, yaw, 0.0, 0.0, 0.49)
    reached = attitude_target(wanted, yaw, first.roll_rad, first.pitch_rad, 0.49)  # once the attitude is there
    assert resultant(reached, 0.49) == pytest.approx(wanted, abs=1e-9)


@given(acceleration, acceleration, angle)
def test_an_attitude_shows_the_acceleration_that_it_was_commanded_for(ux: float, uy: float, yaw: float) -> None:
    target = attitude_target((ux, uy, 0.0), yaw, 0.0, 0.0, 0.49)
    assert level_acceleration(target.roll_rad, target.pitch_rad, yaw) == pytest.approx((ux, uy), abs=1e-9)


@pytest.mark.parametrize(("roll", "pitch"), [(pi, 0.0), (-2.0, 0.5), (0.3, 1.6), (nan, 0.0)])
def test_a_vehicle_upside_down_shows_no_acceleration(roll: float, pitch: float) -> None:
    assert level_acceleration(roll, pitch, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("yaw", "wanted", "sign"),
    [
        (0.0, (1.0, 0.0, 0.0), ("pitch", 1)),
        (0.0, (0.0, 1.0, 0.0), ("roll", -1)),
        (pi / 2, (0.0, 1.0, 0.0), ("pitch", 1)),
    ],
)
def test_signs_of_roll_and_pitch(yaw: float, wanted: tuple[float, float, float], sign: tuple[str, int]) -> None:
    target = attitude_target(wanted, yaw, 0.0, 0.0, 0.5)
    angles = {"roll": target.roll_rad, "pitch": target.pitch_rad}
    assert angles.pop(sign[0]) * sign[1] == pytest.approx(0.1016, abs=1e-3)
    assert angles.popitem()[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("uz", "roll"), [(-GRAVITY_M_S2, 0.0), (-20.0, 0.0), (0.0, pi / 2 + 0.1), (nan, 0.0)])
def test_impossible_acceleration_is_refused(uz: float, roll: float) -> None:
    with pytest.raises(ValueError, match="no attitude"):
        attitude_target((0.0, 0.0, uz), 0.0, roll, 0.0, 0.5)


def test_a_fall_with_the_last_of_the_thrust_has_an_attitude() -> None:
    target = attitude_target((0.0, 0.0, 0.5 - GRAVITY_M_S2), 0.0, 0.0, 0.0, 0.5)
    assert target.thrust_norm == pytest.approx(0.5 * 0.5 / GRAVITY_M_S2)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), angle)
def test_limited_acceleration_stays_within_tilt_and_thrust_limits(ux: float, uy: float, uz: float, yaw: float) -> None:
    limited = limit_acceleration((ux, uy, uz), LIMITS.max_tilt_rad, 0.3, 1.6)
    assert 0.3 * GRAVITY_M_S2 - 1e-9 <= limited[2] + GRAVITY_M_S2 <= 1.6 * GRAVITY_M_S2 + 1e-9
    target = attitude_target(limited, yaw, 0.0, 0.0, 0.5)
    assert cos(target.roll_rad) * cos(target.pitch_rad) >= cos(LIMITS.max_tilt_rad) - 1e-9
    assert limited[0] * uy == pytest.approx(limited[1] * ux, rel=1e-6, abs=1e-6)  # the direction over ground is kept


@given(st.lists(st.tuples(anything, anything, anything, anything, st.floats(0.0, 0.1)), min_size=1, max_size=30))
def test_setpoints_stay_within_all_limits(wishes: list[tuple[float, float, float, float, float]]) -> None:
    gate = OutputLimiter(LIMITS)
    gate.open_at(0.0, LEVEL, 0.5)
    now_s, last = 0.0, LEVEL
    for roll, pitch, yaw, thrust, elapsed_s in wishes:
        now_s += elapsed_s
        wanted = AttitudeTarget(roll, pitch, yaw, thrust)
        admitted = gate.admit(now_s, wanted, 0.5)
        if any(x != x or x in (inf, -inf) for x in (roll, pitch, yaw, thrust)):
            assert admitted is None
            continue
        assert admitted is not None
        assert hypot(admitted.roll_rad, admitted.pitch_rad) <= LIMITS.max_tilt_rad + 1e-9
        assert 0.5 * 0.3 - 1e-9 <= admitted.thrust_norm <= 0.5 * 1.6 + 1e-9
        assert abs(admitted.thrust_norm - last.thrust_norm) <= 10.0 * 0.5 * 0.1 + 1e-9
        last = admitted


def test_setpoint_slews_towards_the_command() -> None:
    gate = OutputLimiter(LIMITS)
    gate.open_at(0.0, LEVEL, 0.5)
    first = gate.admit(0.02, AttitudeTarget(0.3, 0.0, 0.0, 0.5), 0.5)
    assert first is not None
    assert first.roll_rad == pytest.approx(radians(4.0))
    for tick in range(2, 10):
        first = gate.admit(0.02 * tick, AttitudeTarget(0.3, 0.0, 0.0, 0.5), 0.5)
    assert first is not None
    assert first.roll_rad == pytest.approx(0.3)


def test_yaw_slews_the_short_way_round() -> None:
    gate = OutputLimiter(LIMITS)
    gate.open_at(0.0, AttitudeTarget(0.0, 0.0, radians(179.0), 0.5), 0.5)
    admitted = gate.admit(0.02, AttitudeTarget(0.0, 0.0, radians(-179.0), 0.5), 0.5)
    assert admitted is not None
    assert admitted.yaw_rad == pytest.approx(radians(-179.0))


def test_closed_limiter_passes_no_setpoint() -> None:
    assert OutputLimiter(LIMITS).admit(1.0, LEVEL, 0.5) is None


@pytest.mark.parametrize(
    ("position", "inside"),
    [((0.0, 0.0, 1.0), True), ((10.0, -10.0, 20.0), True), ((10.1, 0.0, 1.0), False), ((nan, 0.0, 1.0), False)],
)
def test_fence_check(position: tuple[float, float, float], inside: bool) -> None:
    assert LIMITS.fence.contains(position) is inside


def test_thrust_is_at_most_full_thrust_whatever_hover_needs() -> None:
    gate, hover_thrust_norm = OutputLimiter(LIMITS), 0.8
    gate.open_at(0.0, AttitudeTarget(0.0, 0.0, 0.0, 0.8), hover_thrust_norm)
    for tick in range(1, 50):
        admitted = gate.admit(0.02 * tick, AttitudeTarget(0.0, 0.0, 0.0, 1.2), hover_thrust_norm)
    assert admitted is not None
    assert admitted.thrust_norm == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("gap_s", "slews_for_s"), [(0.02, 0.02), (0.07, 0.07), (0.1, 0.1), (0.3, 0.1), (60.0, 0.1), (-1.0, 0.0)]
)
def test_a_gap_between_setpoints_allows_no_more_than_five_ticks(gap_s: float, slews_for_s: float) -> None:
    """A clock that goes back allows nothing."""
    gate = OutputLimiter(LIMITS)
    gate.open_at(7.0, LEVEL, 0.5)
    admitted = gate.admit(7.0 + gap_s, AttitudeTarget(-0.43, 0.0, 0.43, 0.75), 0.5)
    assert admitted is not None
    step_rad = LIMITS.max_tilt_rate_rad_s * slews_for_s
    assert (admitted.roll_rad, admitted.yaw_rad) == pytest.approx((-min(step_rad, 0.43), min(step_rad, 0.43)))
    assert admitted.thrust_norm == pytest.approx(0.5 + min(10.0 * 0.5 * slews_for_s, 0.25))


def test_thrust_slews_down_as_fast_as_up() -> None:
    gate = OutputLimiter(LIMITS)
    gate.open_at(0.0, LEVEL, 0.5)
    thrusts = [gate.admit(0.02 * tick, AttitudeTarget(0.0, 0.0, 0.0, 0.2), 0.5) for tick in range(1, 5)]
    assert [target and target.thrust_norm for target in thrusts] == pytest.approx([0.4, 0.3, 0.2, 0.2])


def test_too_much_tilt_keeps_its_direction() -> None:
    gate = OutputLimiter(LIMITS)
    gate.open_at(0.0, AttitudeTarget(0.6, -0.8, 0.0, 0.5), 0.5)
    admitted = gate.admit(0.02, AttitudeTarget(0.6, -0.8, 0.0, 0.5), 0.5)
    assert admitted is not None
    assert (admitted.roll_rad, admitted.pitch_rad) == pytest.approx((0.6 * radians(25.0), -0.8 * radians(25.0)))
