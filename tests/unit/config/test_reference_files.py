"""References of files: derivatives, continuity, and checks of feasibility."""

from math import hypot, tau
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.assembly import trajectory_of
from companion.config.file import ConfigError
from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig, FormationMember
from companion.config.reference import (
    CircleReference,
    Figure8Reference,
    PointReference,
    Reference,
    TargetReference,
    WaypointsReference,
)
from companion.config.reference_check import check_reference
from companion.types.flight import Role

EIGHT = Figure8Reference(centre_enu_m=(1.0, -2.0, 3.0), width_m=6.0, height_m=3.0, period_s=30.0, ramp_s=5.0)
TIMES_S = np.arange(0.0, 60.0, 0.01)
FLEET = FleetConfig(
    name="pair",
    origin="indoor",
    vehicles=(
        FormationMember(id=1, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),
        FormationMember(id=2, role=Role.FOLLOWER, slot_enu_m=(-2.0, 0.0, 0.0)),
    ),
    neighbours=EdgeNeighbours(edges=((1, 2),)),
)


def sampled(reference: Reference, times_s: np.ndarray = TIMES_S) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """r, r' and r'' (n, 3)."""
    places = [trajectory_of(reference)(time_s) for time_s in times_s.tolist()]
    return (
        np.array([p.position_enu_m for p in places]),
        np.array([p.velocity_enu_m_s for p in places]),
        np.array([p.acceleration_enu_m_s2 for p in places]),
    )


def test_velocity_and_acceleration_are_derivatives_of_the_position() -> None:
    step_s = 1e-4
    (before, v_before, _), (after, v_after, _) = sampled(EIGHT, TIMES_S - step_s), sampled(EIGHT, TIMES_S + step_s)
    _, velocity, acceleration = sampled(EIGHT)
    assert np.abs((after - before) / (2 * step_s) - velocity).max() < 1e-6
    assert np.abs((v_after - v_before) / (2 * step_s) - acceleration).max() < 1e-4


def test_figure_8_begins_at_rest_at_its_centre() -> None:
    for time_s in (-1.0, 0.0):
        start = trajectory_of(EIGHT)(time_s)
        assert start.position_enu_m == EIGHT.centre_enu_m
        assert start.velocity_enu_m_s == start.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)


def test_figure_8_is_continuous_at_the_end_of_the_ramp() -> None:
    _, velocity, acceleration = sampled(EIGHT)
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.01
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.005


def test_figure_8_has_its_size_and_period() -> None:
    position, velocity, acceleration = sampled(EIGHT)
    assert np.ptp(position, axis=0) == pytest.approx([6.0, 3.0, 0.0], abs=1e-3)
    low, high = EIGHT.corners_enu_m()
    assert position.min(axis=0) == pytest.approx(low, abs=1e-3)
    assert position.max(axis=0) == pytest.approx(high, abs=1e-3)
    eight = trajectory_of(EIGHT)
    assert eight(10.0).position_enu_m == pytest.approx(eight(40.0).position_enu_m)  # a lap later
    assert eight(2.5 + 15.0).position_enu_m == pytest.approx(EIGHT.centre_enu_m)  # half a lap: it crosses itself
    speeds = np.linalg.norm(velocity, axis=1)
    assert speeds.max() == pytest.approx(EIGHT.largest_pace()[0], rel=1e-4)
    assert speeds.max() == pytest.approx(tau / 30.0 * hypot(3.0, 3.0), rel=1e-4)
    most = np.linalg.norm(acceleration, axis=1).max()
    assert most == pytest.approx(EIGHT.largest_pace()[1], rel=1e-3)


def test_point_reference_is_at_rest() -> None:
    place = trajectory_of(PointReference(point_enu_m=(1.0, 2.0, 3.0)))(17.0)
    assert place.position_enu_m == (1.0, 2.0, 3.0)
    assert place.velocity_enu_m_s == place.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)


def refusal(reference: Reference, fleet: FleetConfig = FLEET) -> str:
    with pytest.raises(ConfigError) as caught:
        check_reference(Path("v.yaml"), fleet, reference)
    assert all(line.startswith("v.yaml: reference.") for line in caught.value.lines)
    return str(caught.value)


def changed(**fields: object) -> Figure8Reference:
    return Figure8Reference(**({"centre_enu_m": (0.0, 0.0, 2.0), "width_m": 6.0, "height_m": 3.0} | fields))  # type: ignore[arg-type]


def test_figure_8_outside_the_fence_is_refused() -> None:
    check_reference(Path("v.yaml"), FLEET, changed(period_s=30.0))
    line = refusal(changed(width_m=197.0, period_s=300.0))  # the leader stays inside, vehicle 2 at -100.5 m does not
    assert line.startswith("v.yaml: reference.centre_enu_m: puts vehicle 2 at x = -100.5 m, outside the fence less")


@pytest.mark.parametrize("too_fast", [{"period_s": 4.0}, {"period_s": 8.0, "ramp_s": 0.2}])
def test_figure_8_beyond_the_tilt_limit_is_refused_with_a_remedy(too_fast: dict[str, float]) -> None:
    line = refusal(changed(**too_fast))
    assert line.startswith(f"v.yaml: reference.period_s: {too_fast['period_s']:g} s with ramp_s ")
    assert "envelope.max_tilt_deg 25 gives 4.6" in line
    words = line.split()
    period_s, ramp_s = float(words[words.index("least") + 1]), float(words[-5].rstrip(","))
    check_reference(Path("v.yaml"), FLEET, changed(period_s=period_s, ramp_s=ramp_s))


def test_figure_8_beyond_the_speed_limit_is_refused() -> None:
    fleet = FleetConfig(
        name="pair",
        origin="indoor",
        vehicles=FLEET.vehicles,
        neighbours=FLEET.neighbours,
        envelope=Envelope(max_speed_m_s=1.0, max_tilt_deg=45.0),
    )
    line = refusal(changed(period_s=20.0), fleet)
    assert "asks for 1.3 m/s, envelope.max_speed_m_s allows 1; expected at least 26.7 s" in line


CIRCLE = CircleReference(centre_enu_m=(1.0, -2.0, 3.0), radius_m=5.0, period_s=20.0)
WAY = WaypointsReference(points_enu_m=((0.0, 0.0, 2.0), (8.0, 0.0, 3.0), (8.0, -6.0, 2.0)), wait_s=1.0)
TARGET = TargetReference(start_enu_m=(1.0, 2.0, 3.0))


@pytest.mark.parametrize("reference", [CIRCLE, replace(CIRCLE, ramp_s=3.0, clockwise=True), WAY])
def test_every_kind_begins_at_rest_and_keeps_its_box_and_limits(reference: Reference) -> None:
    position, velocity, acceleration = sampled(reference)
    low, high = reference.corners_enu_m()
    assert position.min(axis=0) == pytest.approx(low, abs=1e-2)
    assert position.max(axis=0) == pytest.approx(high, abs=1e-2)
    speed_m_s, acceleration_m_s2 = reference.largest_pace()
    assert np.linalg.norm(velocity, axis=1).max() == pytest.approx(speed_m_s, rel=1e-3)
    assert np.linalg.norm(acceleration, axis=1).max() == pytest.approx(acceleration_m_s2, rel=1e-3)
    start = trajectory_of(reference)(0.0)
    assert start.position_enu_m == pytest.approx(reference.start_enu_m)
    assert start.velocity_enu_m_s == start.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)


def test_circle_is_counterclockwise_from_the_east_by_default() -> None:
    for clockwise, side in ((False, 1.0), (True, -1.0)):
        circle = trajectory_of(CircleReference((0.0, 0.0, 3.0), 5.0, clockwise, period_s=20.0, ramp_s=2.0))
        assert circle(0.0).position_enu_m == (5.0, 0.0, 3.0)
        assert circle(1.0 + 5.0).position_enu_m == pytest.approx((0.0, side * 5.0, 3.0))


def test_waypoints_keep_their_limits_on_long_and_short_legs() -> None:
    for leg_m in (0.3, 200.0):
        way = WaypointsReference(((0.0, 0.0, 2.0), (leg_m, 0.0, 2.0)), max_speed_m_s=3.0, max_acceleration_m_s2=0.5)
        speed_m_s, acceleration_m_s2 = way.largest_pace()
        assert max(speed_m_s / 3.0, acceleration_m_s2 / 0.5) == pytest.approx(1.0)
    twice = WaypointsReference(((1.0, 0.0, 2.0), (1.0, 0.0, 2.0)))
    assert twice.largest_pace() == (0.0, 0.0)
    assert trajectory_of(twice)(3.0).position_enu_m == (1.0, 0.0, 2.0)


def test_target_reference_is_at_rest_before_the_first_sample() -> None:
    assert trajectory_of(TARGET)(100.0).position_enu_m == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        (replace(CIRCLE, radius_m=100.0), "reference.centre_enu_m: puts vehicle 1 at x = 101 m, outside"),
        (replace(CIRCLE, period_s=5.0), "reference.period_s: 5 s with ramp_s 5 asks for"),
        (replace(WAY, points_enu_m=((0.0, 0.0, 2.0), (0.0, 0.0, 51.0))), "points_enu_m: puts vehicle 1 at z = 51 m"),
        (
            replace(WAY, max_acceleration_m_s2=20.0, max_speed_m_s=30.0),
            "max_acceleration_m_s2: 20 asks for 20.0 m/s^2, envelope.max_tilt_deg 25 gives 4.6; expected at most 4.57",
        ),
        (replace(TARGET, start_enu_m=(0.0, -101.0, 3.0)), "start_enu_m: puts vehicle 1 at y = -101 m, outside the fence"),
        (
            replace(TARGET, max_speed_m_s=13.0),
            "reference.max_speed_m_s: 13 asks for 13.0 m/s, envelope.max_speed_m_s allows 12; expected at most 12",
        ),
        (replace(TARGET, max_acceleration_m_s2=5.0), "reference.max_acceleration_m_s2: 5 asks for 5.0 m/s^2"),
    ],
)  # fmt: skip
def test_infeasible_reference_is_refused_with_a_remedy(reference: Reference, words: str) -> None:
    assert words in refusal(reference)
    assert words in refusal(reference)


@pytest.mark.parametrize("period_s", [3.0, 6.0])
def test_advice_for_a_circle_makes_it_feasible(period_s: float) -> None:
    words = refusal(replace(CIRCLE, period_s=period_s, ramp_s=1.0)).split()
    slower_s, ramp_s = float(words[words.index("least") + 1]), float(words[-5].rstrip(","))
    check_reference(Path("v.yaml"), FLEET, replace(CIRCLE, period_s=slower_s, ramp_s=ramp_s))
