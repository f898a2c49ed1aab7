"""Whole batches: allowed mixtures, random numbers, neighbours. tests/lockstep compares the model itself."""

import numpy as np
import pytest

from lockstep_fleet import platoon
from sitl.batch.autopilots import BatchGusts, EstimatorErrors
from sitl.batch.columns import columns_of
from sitl.batch.flight import fly_batch
from sitl.vehicle.config import SENSORS

NOISY = ("stand_in.sensors=default", "stand_in.wind.gust_sd_m_s=0.5", "links.peer_loss=0.2", "links.peer_jitter_s=0.05")
RANGE = "fleet.neighbours={kind: range, range_m: 2.0, hysteresis_m: 0.5}"
THREE = (
    "fleet.vehicles=[{id: 1, role: leader, slot_enu_m: [0, 0, 0]}, {id: 2, role: follower, slot_enu_m: [-1, 0, 0]},"
    " {id: 3, role: follower, slot_enu_m: [-2, 0, 0]}]",
    "fleet.neighbours.edges=[[1, 2], [2, 3]]",
    "starts_enu_m={1: [0, 0, 0], 2: [-1, 0, 0], 3: [-2, 0, 0]}",
)


# ---------------------------------------------------------------- flights


def test_a_flight_starts_at_rest_over_its_starts_and_ends_in_its_slots() -> None:
    flight = fly_batch([platoon("fleet.law={name: cooperative}")] * 2, 12.0)
    assert flight.times_s.size == 601
    assert flight.times_s[[0, -1]] == pytest.approx([0.0, 12.0])
    assert flight.positions_enu_m.shape == (601, 2, 4, 3)
    assert flight.positions_enu_m[0, 1, 3] == pytest.approx([-4.5, 0.0, 1.0])
    assert flight.errors_m()[0] == pytest.approx(np.ones((2, 4)))
    assert flight.errors_m()[-1].max() < 0.1
    assert flight.neighbours is None
    assert flight.reference_enu_m.shape == (601, 3)


def test_vehicles_are_sorted_by_id_for_any_order_in_the_file() -> None:
    turned = platoon(
        "fleet.vehicles=[{id: 4, role: follower, slot_enu_m: [-4.5, 0, 0]}, {id: 2, role: follower, slot_enu_m: [-1.5, 0, 0]},"
        " {id: 3, role: follower, slot_enu_m: [-3, 0, 0]}, {id: 1, role: leader, slot_enu_m: [0, 0, 0]}]"
    )
    one, other = (fly_batch([scenario], 3.0).positions_enu_m for scenario in (platoon(), turned))
    np.testing.assert_array_equal(one, other)


def test_different_formations_in_one_batch_do_not_affect_each_other() -> None:
    scenarios = [
        platoon(),
        platoon("fleet.law.name=average_26", "reference.point_enu_m=[0.0, 2.0, 1.0]"),
        platoon(*NOISY, RANGE),
        platoon(*NOISY, "stand_in.seed=5", "links.peer_delay_s=0.07", "stand_in.airframe.mass_kg=2.0"),
        platoon("stand_in.airframe.motor_lag_s=0", "fleet.law.altitude=hold", "links.setpoint_delay_s=0.03"),
    ]
    together = fly_batch(scenarios, 4.0)
    assert together.reference_enu_m.shape == (201, 5, 3)
    for b, scenario in enumerate(scenarios):
        alone = fly_batch([scenario], 4.0)
        np.testing.assert_allclose(together.positions_enu_m[:, b], alone.positions_enu_m[:, 0], atol=1e-6)
        np.testing.assert_allclose(together.errors_m()[:, b], alone.errors_m()[:, 0], atol=1e-6)


def test_the_sample_period_does_not_change_the_flight() -> None:
    fine, coarse = fly_batch([platoon()], 2.0, sample_s=0.004), fly_batch([platoon()], 2.0, sample_s=0.1)
    assert (fine.times_s.size, coarse.times_s.size) == (501, 21)
    np.testing.assert_array_equal(fine.positions_enu_m[::25], coarse.positions_enu_m)


def test_progress_is_reported_once_per_virtual_second() -> None:
    reported: list[float] = []
    fly_batch([platoon()], 3.0, reported.append)
    assert reported == pytest.approx([1.0, 2.0, 3.0])


def test_scenarios_that_cannot_share_a_batch_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one scenario"):
        fly_batch([], 1.0)
    with pytest.raises(ValueError, match=r"same number of vehicles; these have \[3, 4\]"):
        fly_batch([platoon(), platoon(*THREE)], 1.0)
    with pytest.raises(ValueError, match="same kind of attitude control"):
        fly_batch([platoon(), platoon("stand_in.airframe.attitude=instant")], 1.0)
    with pytest.raises(ValueError, match=r"sample_s is 0.01; it must be a multiple of 0.004 s"):
        fly_batch([platoon()], 1.0, sample_s=0.01)


# ---------------------------------------------------------------- neighbours


def test_neighbours_are_those_of_the_edges() -> None:
    relation = fly_batch([platoon()], 0.1, keep_neighbours=True).neighbours
    assert relation is not None
    line = np.abs(np.subtract.outer(np.arange(4), np.arange(4))) == 1
    assert (relation == line).all()


def test_neighbours_by_range_have_hysteresis() -> None:
    """Vehicle 2 is 1.5 m from 1 and 3. A neighbour that drifts past 2.0 m stays one until 2.5 m."""
    relation = fly_batch([platoon(RANGE)], 0.1, keep_neighbours=True).neighbours
    assert relation is not None
    assert relation[0, 0].sum() == 6
    apart = platoon(
        RANGE,
        "starts_enu_m={1: [0, 0, 0], 2: [-2.2, 0, 0], 3: [-4.4, 0, 0], 4: [-6.6, 0, 0]}",
        "fleet.law.altitude=hold",
    )
    alone = fly_batch([apart], 6.0, keep_neighbours=True)
    assert alone.neighbours is not None
    assert not alone.neighbours[0].any()  # between joining and leaving distance, and none was a neighbour
    flying = fly_batch([platoon(RANGE, "reference.point_enu_m=[6.0, 0.0, 1.0]")], 6.0, keep_neighbours=True)
    assert flying.neighbours is not None
    distance_m = np.linalg.norm(np.diff(flying.positions_enu_m[:, 0, :2], axis=1)[:, 0], axis=1)
    related = flying.neighbours[:, 0, 0, 1]
    assert related[distance_m < 1.95].all()
    between = related[(distance_m > 2.05) & (distance_m < 2.45)]
    assert between.any()
    assert not related[distance_m > 2.55].any()


def test_a_stale_peer_is_no_neighbour() -> None:
    without_packets = fly_batch([platoon("links.peer_loss=1", "fleet.peers.max_age_s=0.1")], 1.0, keep_neighbours=True)
    assert without_packets.neighbours is not None
    assert without_packets.neighbours[without_packets.times_s < 0.06].any(axis=(1, 2, 3)).all()
    assert not without_packets.neighbours[without_packets.times_s > 0.14].any()
    still = without_packets.positions_enu_m[:, 0, 3]
    assert np.abs(still - still[0]).max() < 0.01  # a follower without neighbours does not accelerate


# ---------------------------------------------------------------- random numbers


def test_a_seed_determines_the_flight() -> None:
    one, same, other = (
        fly_batch([platoon(*NOISY, f"stand_in.seed={seed}")], 2.0).positions_enu_m for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.01


def test_estimator_errors_have_the_configured_spread() -> None:
    scenarios = [platoon("stand_in.sensors=default", f"stand_in.seed={seed}") for seed in range(200)]
    errors = EstimatorErrors(scenarios, columns_of(scenarios))
    sensors = SENSORS["default"]
    for _ in range(60):
        errors.step()
    velocity_sd = np.hypot(sensors.velocity_sd_m_s, sensors.velocity_white_sd_m_s)
    assert errors.position_m.std(axis=1) == pytest.approx(sensors.position_sd_m, rel=0.1)
    assert errors.velocity_m_s.std(axis=1) == pytest.approx([velocity_sd] * 3, rel=0.1)
    assert errors.attitude_rad.std(axis=1) == pytest.approx([np.radians(sensors.attitude_sd_deg)] * 3, rel=0.1)
    before = errors.position_m.copy()
    for _ in range(50):
        errors.step()
    correlation = np.mean(before * errors.position_m) / np.mean(before**2)
    assert correlation == pytest.approx(np.exp(-1.0 / sensors.position_time_s), abs=0.05)


def test_gusts_have_the_configured_mean_and_spread() -> None:
    wind = ("stand_in.wind={mean_enu_m_s: [3, 0, -1], gust_sd_m_s: 0.5, gust_time_s: 1.0}",)
    scenarios = [platoon(*wind, f"stand_in.seed={seed}") for seed in range(200)] + [platoon()]
    columns = columns_of(scenarios)
    gusts = BatchGusts(scenarios, columns)
    for _ in range(300):
        blowing = gusts.step()
    by_vehicle = columns.by_vehicle(blowing)
    assert by_vehicle[:200].mean(axis=(0, 1)) == pytest.approx([3.0, 0.0, -1.0], abs=0.1)
    assert by_vehicle[:200].std(axis=(0, 1)) == pytest.approx([0.5] * 3, rel=0.1)
    assert not by_vehicle[200].any()


def test_gusts_do_not_change_the_sensor_noise() -> None:
    quiet, gusty = ([platoon("stand_in.sensors=default", *more)] for more in ((), ("stand_in.wind.gust_sd_m_s=0.5",)))
    one, other = (EstimatorErrors(s, columns_of(s)) for s in (quiet, gusty))
    np.testing.assert_array_equal(one.position_m, other.position_m)
