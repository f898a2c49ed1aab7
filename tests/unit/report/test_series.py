"""Intervals, distances and errors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.recording.records import DecisionRecord
from companion.report.distances import errors_to_slot_m, grid_of, pair_distances
from companion.report.findings import HELD_S, runs, stretches
from made_flights import Faults, fleet_of, flight_of, records_of

TIME_S = np.arange(0.0, 10.0, 0.02)


def test_a_run_ends_where_the_next_sample_is_not_in_it() -> None:
    (one,) = runs(TIME_S, (TIME_S >= 2.0) & (TIME_S < 3.0))
    assert one.interval == pytest.approx((2.0, 3.0))
    assert (TIME_S[one.first], TIME_S[one.last]) == pytest.approx((2.0, 2.98))


def test_runs_that_are_near_each_other_are_one() -> None:
    holds = ((TIME_S >= 2.0) & (TIME_S < 3.0)) | ((TIME_S >= 4.0) & (TIME_S < 5.0))
    assert [one.interval for one in runs(TIME_S, holds)] == [pytest.approx((2.0, 3.0)), pytest.approx((4.0, 5.0))]
    (one,) = runs(TIME_S, holds, apart_s=1.1)
    assert one.interval == pytest.approx((2.0, 5.0))
    assert (one.held_s, one.longest_s) == pytest.approx((2.0, 1.0))


def test_a_gap_of_the_recording_is_no_evidence() -> None:
    time_s = np.array([0.0, 0.02, 0.04, 5.0, 5.02])
    (one, other) = runs(time_s, np.ones(5, dtype=np.bool_))
    assert one.interval == pytest.approx((0.0, 0.04 + HELD_S))
    assert other.interval.begins_s == 5.0


@given(st.lists(st.booleans(), max_size=60))
def test_runs_cover_exactly_what_holds(holds: list[bool]) -> None:
    time_s = np.arange(len(holds)) * 0.02
    found = runs(time_s, np.array(holds, dtype=np.bool_))
    covered = {row for one in found for row in range(one.first, one.last + 1)}
    assert covered == {row for row, held in enumerate(holds) if held}


@given(st.lists(st.sampled_from(["a", "b"]), min_size=1, max_size=40))
def test_stretches_follow_each_other_without_gaps(values: list[str]) -> None:
    time_s = np.arange(len(values)) * 1.0
    found = stretches(time_s, np.array(values))
    assert found[0][0].begins_s == 0.0
    assert found[-1][0].ends_s == time_s[-1]
    assert all(a[0].ends_s == b[0].begins_s and a[1] != b[1] for a, b in itertools.pairwise(found))


def test_a_metre_of_height_counts_half() -> None:
    def above(_time_s: float, record: DecisionRecord) -> DecisionRecord:
        x, y, z = record.position_enu_m
        return replace(record, position_enu_m=(x + 3.05, y, z + 4.0))

    flight = flight_of(records_of(2, 30.0, {2: Faults(decision=above)}))
    (pair,) = pair_distances(flight, grid_of(flight))
    assert pair.smallest_m == pytest.approx(2.0, abs=1e-6)


def test_pairs_are_judged_in_the_air_only_and_the_nearest_is_first() -> None:
    flight = flight_of(records_of(3, 30.0))
    pairs = pair_distances(flight, grid_of(flight))
    assert pairs[-1].pair == (1, 3)
    assert [round(pair.smallest_m, 3) for pair in pairs] == [3.05, 3.05, 6.1]
    judged_s = pairs[0].time_s[pairs[0].judged]
    assert (judged_s[0], judged_s[-1]) == (pytest.approx(5.5, abs=0.15), pytest.approx(28.0, abs=0.15))


def test_no_distance_across_a_long_gap_of_a_recording() -> None:
    flight = flight_of(records_of(2, 30.0, {2: Faults(lost=(15.0, 17.0))}))
    (pair,) = pair_distances(flight, grid_of(flight))
    inside = (pair.time_s > 15.1) & (pair.time_s < 16.9)
    assert np.isnan(pair.distance_m[inside]).all()
    assert not pair.judged[inside].any()


def test_the_error_is_by_the_leaders_reference_at_that_time() -> None:
    flight = flight_of(records_of(3, 30.0))
    errors_m = errors_to_slot_m(flight)
    for vehicle in flight.vehicles:
        inside = (vehicle.ticks.time_s > 11.0) & (vehicle.ticks.time_s < 21.0)
        lag_m = 0.05 * (vehicle.vehicle_id - 1)
        assert errors_m[vehicle.vehicle_id][inside] == pytest.approx(lag_m, abs=1e-3)


def test_without_a_leader_there_is_no_error() -> None:
    starts = [start for start in records_of(2, 30.0, fleet=fleet_of(2)) if start.header.vehicle_id == 2]
    flight = flight_of(starts)
    assert np.isnan(errors_to_slot_m(flight)[2]).all()
