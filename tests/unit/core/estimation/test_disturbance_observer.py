"""The observer of hover thrust and wind on a point mass with known truth."""

from collections.abc import Callable, Iterator
from math import atan2, cos, hypot, inf, nan, sin

import pytest
from msgspec.structs import replace

from companion.core.estimation.wind import (
    HOVER_RANGE_NORM,
    LONGEST_GAP_S,
    MAX_DISTURBANCE_M_S2,
    MAX_DISTURBANCE_RATE_M_S3,
    MAX_HOVER_RATE_1_S,
    DisturbanceObserver,
    FlightSample,
)
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

TICK_S = 0.02
HOVER = 0.49
BANDWIDTH_1_S = 4.0
Pilot = Callable[[float], tuple[Vector3, float]]  # time -> attitude and thrust


def hovering(_time_s: float) -> tuple[Vector3, float]:
    return ZERO3, HOVER


def flown(
    pilot: Pilot = hovering,
    push_enu_m_s2: Vector3 = ZERO3,
    drag_1_s: float = 0.0,
    seconds: float = 5.0,
    velocity_enu_m_s: Vector3 = ZERO3,
) -> Iterator[FlightSample]:
    """Point mass with ideal motors, small integration steps, one measurement per TICK_S."""
    vx, vy, vz = velocity_enu_m_s
    steps, time_s = 20, 0.0
    for _ in range(round(seconds / TICK_S)):
        yield FlightSample(time_s, (vx, vy, vz), *pilot(time_s))
        for step in range(steps):
            (roll, pitch, yaw), thrust = pilot(time_s + step * TICK_S / steps)
            lift = thrust / HOVER * GRAVITY_M_S2
            ahead, left = cos(roll) * sin(pitch) * lift, -sin(roll) * lift
            ax = ahead * cos(yaw) - left * sin(yaw) + push_enu_m_s2[0] - drag_1_s * vx
            ay = ahead * sin(yaw) + left * cos(yaw) + push_enu_m_s2[1] - drag_1_s * vy
            az = cos(roll) * cos(pitch) * lift - GRAVITY_M_S2 + push_enu_m_s2[2] - drag_1_s * vz
            vx, vy, vz = vx + ax * TICK_S / steps, vy + ay * TICK_S / steps, vz + az * TICK_S / steps
        time_s += TICK_S


def observer(hover: float = HOVER, drag_1_s: float = 0.0, bandwidth_1_s: float = BANDWIDTH_1_S) -> DisturbanceObserver:
    return DisturbanceObserver(hover, drag_1_s, bandwidth_1_s)


def fed(observing: DisturbanceObserver, motions: Iterator[FlightSample]) -> DisturbanceObserver:
    for motion in motions:
        observing.update(motion)
    return observing


# ---------------------------------------------------------------- what is found


@pytest.mark.parametrize("wrong", [0.7, 1.3])
def test_hover_thrust_error_is_estimated(wrong: float) -> None:
    assert fed(observer(HOVER * wrong), flown()).hover_thrust_norm == pytest.approx(HOVER, rel=0.01)


@pytest.mark.parametrize("yaw", [0.0, 1.1, -2.5])
def test_wind_is_estimated_at_any_heading(yaw: float) -> None:
    def leaning(_time_s: float) -> tuple[Vector3, float]:
        return (0.1, -0.15, yaw), HOVER / (cos(0.1) * cos(0.15))

    found = fed(observer(), flown(leaning, (1.5, -1.0, 0.0)))
    assert found.disturbance_enu_m_s2 == pytest.approx((1.5, -1.0, 0.0), abs=0.02)
    assert found.hover_thrust_norm == pytest.approx(HOVER, rel=0.005)


def test_upward_force_lowers_the_hover_thrust() -> None:
    found = fed(observer(), flown(push_enu_m_s2=(0.0, 0.0, 0.1 * GRAVITY_M_S2)))
    assert found.hover_thrust_norm == pytest.approx(HOVER / 1.1, rel=0.01)
    assert found.disturbance_enu_m_s2 == pytest.approx(ZERO3, abs=1e-6)


def test_configured_drag_is_no_disturbance() -> None:
    fast = {"drag_1_s": 0.5, "velocity_enu_m_s": (8.0, 0.0, -3.0)}
    known = fed(observer(drag_1_s=0.5), flown(**fast))  # type: ignore[arg-type]
    assert known.disturbance_enu_m_s2 == pytest.approx(ZERO3, abs=1e-3)
    assert known.hover_thrust_norm == pytest.approx(HOVER, rel=1e-3)
    unknown = fed(observer(), flown(**fast, seconds=1.5))  # type: ignore[arg-type]
    assert unknown.disturbance_enu_m_s2[0] < -1.0


def test_manoeuvres_are_no_disturbance() -> None:
    def swaying(time_s: float) -> tuple[Vector3, float]:
        return (0.3 * sin(2.0 * time_s), 0.3 * cos(3.0 * time_s), time_s), HOVER * (1.0 + 0.1 * sin(time_s))

    found = observer()
    for motion in flown(swaying):
        found.update(motion)
        assert hypot(*found.disturbance_enu_m_s2) < 0.15
        assert found.hover_thrust_norm == pytest.approx(HOVER, rel=0.02)


def test_bandwidth_zero_disables_the_observer() -> None:
    found = fed(observer(0.4, bandwidth_1_s=0.0), flown(push_enu_m_s2=(2.0, 0.0, 0.0)))
    assert (found.hover_thrust_norm, found.disturbance_enu_m_s2) == (0.4, ZERO3)


# ---------------------------------------------------------------- bounds


def test_estimate_keeps_its_rate_and_its_limits() -> None:
    found = observer(0.2)
    before = (0.2, ZERO3)
    for motion in flown(push_enu_m_s2=(30.0, -40.0, 0.0), seconds=6.0):
        found.update(motion)
        assert abs(found.hover_thrust_norm - before[0]) <= MAX_HOVER_RATE_1_S * before[0] * TICK_S + 1e-9
        for a, b in zip(before[1], found.disturbance_enu_m_s2, strict=True):
            assert abs(b - a) <= MAX_DISTURBANCE_RATE_M_S3 * TICK_S + 1e-9
        assert hypot(*found.disturbance_enu_m_s2) <= MAX_DISTURBANCE_M_S2 + 1e-9
        before = (found.hover_thrust_norm, found.disturbance_enu_m_s2)
    assert hypot(*before[1]) == pytest.approx(MAX_DISTURBANCE_M_S2)
    assert atan2(before[1][1], before[1][0]) == pytest.approx(atan2(-4.0, 3.0), abs=0.2)


@pytest.mark.parametrize(("thrust", "bound"), [(0.02, HOVER_RANGE_NORM[0]), (1.0, HOVER_RANGE_NORM[1])])
def test_hover_thrust_stays_within_its_bounds(thrust: float, bound: float) -> None:
    """A vehicle held by a rope: it neither falls nor climbs."""
    found = observer()
    for tick in range(3000):
        found.update(FlightSample(tick * TICK_S, ZERO3, ZERO3, thrust))
    assert found.hover_thrust_norm == pytest.approx(bound)


# ---------------------------------------------------------------- what is no measurement


def test_estimator_reset_is_not_estimated_as_wind() -> None:
    found = observer()
    for tick, motion in enumerate(flown()):
        jumped = replace(motion, velocity_enu_m_s=(3.0, 0.0, -2.0)) if tick > 100 else motion
        found.update(jumped)
    assert found.disturbance_enu_m_s2 == pytest.approx(ZERO3, abs=1e-3)
    assert found.hover_thrust_norm == pytest.approx(HOVER, rel=1e-3)


def test_gap_in_telemetry_changes_nothing() -> None:
    for pauses in (False, True):
        found = fed(observer(), flown(push_enu_m_s2=(1.0, 0.0, 0.0)))
        before = (found.hover_thrust_norm, found.disturbance_enu_m_s2)
        if pauses:
            found.pause()
        after_s = 5.0 + (0.0 if pauses else LONGEST_GAP_S + 0.01)
        found.update(FlightSample(after_s, (9.0, 0.0, 5.0), ZERO3, 0.9))
        assert (found.hover_thrust_norm, found.disturbance_enu_m_s2) == before


def test_sample_that_is_not_newer_changes_nothing() -> None:
    found = fed(observer(0.4), flown(seconds=1.0))
    before = found.hover_thrust_norm
    for time_s in (0.98, 0.5):
        found.update(FlightSample(time_s, (9.0, 0.0, 5.0), ZERO3, 0.9))
    assert found.hover_thrust_norm == before


# ---------------------------------------------------------------- where it begins


def test_hover_thrust_starts_from_the_parameter() -> None:
    found = observer(0.4)
    for refused in (nan, inf, 0.0, 0.95):
        assert not found.start_from(refused)
    assert found.start_from(0.45)
    assert found.hover_thrust_norm == 0.45
    fed(found, flown(seconds=1.0))
    assert not found.start_from(0.45)


def test_landing_resets_the_wind_and_keeps_the_hover_thrust() -> None:
    found = fed(observer(0.4), flown(push_enu_m_s2=(1.0, 0.0, 0.0)))
    found.landed()
    assert found.disturbance_enu_m_s2 == ZERO3
    assert found.hover_thrust_norm == pytest.approx(HOVER, rel=0.01)
