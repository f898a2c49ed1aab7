"""The figure 8: r' and r'' are what r says, nothing jumps, and what cannot be flown is refused."""

from math import hypot, tau
from pathlib import Path

import numpy as np
import pytest

from companion.assembly import trajectory_of
from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig, FormationMember, PeerLimits
from companion.config.reference import Figure8Reference, PointReference, check_reference, largest_pace
from companion.config_file import ConfigError
from companion.types import Role

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


def sampled(reference: Figure8Reference, times_s: np.ndarray = TIMES_S) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """r, r' and r'' (n, 3)."""
    places = [trajectory_of(reference)(time_s) for time_s in times_s.tolist()]
    return (
        np.array([p.position_enu_m for p in places]),
        np.array([p.velocity_enu_m_s for p in places]),
        np.array([p.acceleration_enu_m_s2 for p in places]),
    )


def test_velocity_and_acceleration_are_the_derivatives_of_the_position() -> None:
    step_s = 1e-4
    (before, v_before, _), (after, v_after, _) = sampled(EIGHT, TIMES_S - step_s), sampled(EIGHT, TIMES_S + step_s)
    _, velocity, acceleration = sampled(EIGHT)
    assert np.abs((after - before) / (2 * step_s) - velocity).max() < 1e-6
    assert np.abs((v_after - v_before) / (2 * step_s) - acceleration).max() < 1e-4


def test_it_begins_at_its_centre_with_zero_speed_and_acceleration() -> None:
    for time_s in (-1.0, 0.0):
        start = trajectory_of(EIGHT)(time_s)
        assert start.position_enu_m == EIGHT.centre_enu_m
        assert start.velocity_enu_m_s == start.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)


def test_nothing_jumps_not_even_where_the_ramp_ends() -> None:
    _, velocity, acceleration = sampled(EIGHT)
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.01
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.005


def test_it_is_an_eight_of_its_size_and_pace() -> None:
    position, velocity, acceleration = sampled(EIGHT)
    assert np.ptp(position, axis=0) == pytest.approx([6.0, 3.0, 0.0], abs=1e-3)
    low, high = EIGHT.corners_enu_m()
    assert position.min(axis=0) == pytest.approx(low, abs=1e-3)
    assert position.max(axis=0) == pytest.approx(high, abs=1e-3)
    eight = trajectory_of(EIGHT)
    assert eight(10.0).position_enu_m == pytest.approx(eight(40.0).position_enu_m)  # a lap later
    assert eight(2.5 + 15.0).position_enu_m == pytest.approx(EIGHT.centre_enu_m)  # half a lap: it crosses itself
    speeds = np.linalg.norm(velocity, axis=1)
    assert speeds.max() == pytest.approx(largest_pace(EIGHT)[0], rel=1e-4)
    assert speeds.max() == pytest.approx(tau / 30.0 * hypot(3.0, 3.0), rel=1e-4)
    most = np.linalg.norm(acceleration, axis=1).max()
    assert most == pytest.approx(largest_pace(EIGHT)[1], rel=1e-3)


def test_a_point_stands_still() -> None:
    place = trajectory_of(PointReference(point_enu_m=(1.0, 2.0, 3.0)))(17.0)
    assert place.position_enu_m == (1.0, 2.0, 3.0)
    assert place.velocity_enu_m_s == place.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)


def refusal(reference: Figure8Reference, fleet: FleetConfig = FLEET) -> str:
    with pytest.raises(ConfigError) as caught:
        check_reference(Path("v.yaml"), fleet, reference)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def changed(**fields: object) -> Figure8Reference:
    return Figure8Reference(**({"centre_enu_m": (0.0, 0.0, 2.0), "width_m": 6.0, "height_m": 3.0} | fields))  # type: ignore[arg-type]


def test_an_eight_that_leaves_the_fence_at_its_far_end() -> None:
    check_reference(Path("v.yaml"), FLEET, changed(period_s=30.0))
    line = refusal(changed(width_m=197.0, period_s=300.0))  # the leader stays inside, vehicle 2 at -100.5 m does not
    assert line == "v.yaml: reference.centre_enu_m: puts vehicle 2 at x = -100.5 m, outside the fence (-100 to 100)"


@pytest.mark.parametrize("too_fast", [{"period_s": 4.0}, {"period_s": 8.0, "ramp_s": 0.2}])
def test_an_eight_that_no_allowed_tilt_can_follow_and_the_advice_helps(too_fast: dict[str, float]) -> None:
    line = refusal(changed(**too_fast))
    assert line.startswith(f"v.yaml: reference.period_s: {too_fast['period_s']:g} s with ramp_s ")
    assert "envelope.max_tilt_deg 25 gives 4.6" in line
    words = line.split()
    period_s, ramp_s = float(words[words.index("least") + 1]), float(words[-5].rstrip(","))
    check_reference(Path("v.yaml"), FLEET, changed(period_s=period_s, ramp_s=ramp_s))


def test_an_eight_so_fast_that_its_flyers_are_not_believed() -> None:
    fleet = FleetConfig(
        name="pair",
        origin="indoor",
        vehicles=FLEET.vehicles,
        neighbours=FLEET.neighbours,
        peers=PeerLimits(max_speed_m_s=1.0),
        envelope=Envelope(max_tilt_deg=45.0),
    )
    line = refusal(changed(period_s=20.0), fleet)
    assert "asks for 1.3 m/s, peers.max_speed_m_s believes 1; expected at least 26.7 s" in line
