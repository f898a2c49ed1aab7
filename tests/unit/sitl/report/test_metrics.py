"""Figures of synthetic tracks against results computed by hand."""

from itertools import pairwise
from math import exp, log, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.analysis.interaction import FloatArray
from companion.core.reference.blend import point
from companion.types.formation import FormationState
from companion.types.values import Vector3
from sitl.report.metrics import (
    Formation,
    Track,
    TrackError,
    errors_m,
    formation_figures,
    read_track,
    reference_positions_m,
    settle_time_s,
    smallest_distance_m,
    stand_at,
)

TIMES_S = np.linspace(0.0, 100.0, 5001)
SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-3.0, 0.0, 0.0)}
ORIGIN = point((0.0, 0.0, 0.0))


def track(x: FloatArray | float, y: FloatArray | float = 0.0, z: FloatArray | float = 0.0) -> Track:
    axes = [np.broadcast_to(np.asarray(axis, dtype=float), TIMES_S.shape) for axis in (x, y, z)]
    return Track(TIMES_S, np.stack(axes, axis=1))


def test_the_error_is_zero_in_the_slots() -> None:
    tracks = {i: track(slot[0]) for i, slot in SLOTS.items()}
    figures = formation_figures(tracks, stand_at(SLOTS), ORIGIN, Formation(10.0, 70.0, 10.0))
    assert figures.duration_s == 60.0
    assert figures.wanted_distance_m == figures.max_distance_m == {"1-2": 1.5, "1-3": 3.0, "2-3": 1.5}
    assert figures.settle_s == 0.0
    assert figures.final_error_m == 0.0


def test_distances_outside_the_interval_are_not_used() -> None:
    # Vehicle 2 moves away with 0.01 m/s: at 20 s it is 1.7 m behind the first, at 60 s 2.1 m.
    tracks = {1: track(0.0), 2: track(-1.5 - 0.01 * TIMES_S)}
    figures = formation_figures(tracks, stand_at({1: SLOTS[1], 2: SLOTS[2]}), ORIGIN, Formation(20.0, 60.0, 20.0))
    assert figures.min_distance_m["1-2"] == pytest.approx(1.7)
    assert figures.max_distance_m["1-2"] == pytest.approx(2.1)
    assert figures.final_distance_m["1-2"] == pytest.approx(2.09)  # the mean of 58 s and 60 s
    assert figures.settle_s is None
    assert figures.final_error_of_vehicle_m[1] == 0.0
    # RMS of a ramp from 0.58 m to 0.60 m: mean 0.59, spread 0.02/sqrt(12).
    assert figures.final_error_m == pytest.approx(sqrt(0.59**2 + 0.02**2 / 12), abs=1e-5)


def test_an_exponential_settles_at_the_computed_time() -> None:
    # 1 m e^(-t/5 s), t from 30 s on, is 0.1 m after 5 s ln 10 = 11.513 s; samples are 20 ms apart.
    error = np.where(TIMES_S < 30.0, 1.0, np.exp(-(TIMES_S - 30.0) / 5.0))
    figures = formation_figures({1: track(error)}, stand_at({1: SLOTS[1]}), ORIGIN, Formation(30.0, 90.0, 30.0))
    assert figures.settle_s == pytest.approx(5.0 * log(10.0), abs=0.021)
    assert figures.final_error_m == pytest.approx(exp(-59.0 / 5.0), rel=0.1)


def test_settling_is_of_the_farthest_vehicle_and_after_the_last_excursion() -> None:
    late = np.where((TIMES_S > 50.0) & (TIMES_S < 52.01), 0.2, 0.0)
    tracks = {1: track(0.0), 2: track(-1.5 + late)}
    figures = formation_figures(tracks, stand_at({1: SLOTS[1], 2: SLOTS[2]}), ORIGIN, Formation(40.0, 90.0, 40.0))
    assert figures.settle_s == pytest.approx(12.02, abs=0.021)


def test_settling_lasts_to_the_end_on_every_axis() -> None:
    assert settle_time_s(np.arange(3.0), np.array([0.0, 0.0, 0.2])) is None
    assert settle_time_s(np.arange(5.0), np.array([0.0, 0.2, 0.1, 0.1, 0.1])) == 2.0
    assert errors_m(
        track(0.0, 3.0, 4.0), stand_at({1: (0.0, 0.0, 0.0)})[1], np.zeros((1, 3)), np.array([5.0])
    ) == pytest.approx([5.0])


@pytest.mark.parametrize(("settles_after_s", "settle_s"), [(7.9, 7.9), (8.1, None), (9.6, None), (0.0, 0.0)])
def test_less_than_two_seconds_within_the_bound_is_not_settled(settles_after_s: float, settle_s: float | None) -> None:
    error = np.where(settles_after_s > TIMES_S - 20.0, 0.2, 0.0)
    figures = formation_figures({1: track(error)}, stand_at({1: SLOTS[1]}), ORIGIN, Formation(20.0, 30.0, 20.0))
    assert figures.settle_s == (None if settle_s is None else pytest.approx(settle_s, abs=0.021))


def circle(seconds: float) -> FormationState:
    """Radius 2 m, one turn in 20 s."""
    angle = 2 * pi * seconds / 20.0
    speed = 2 * pi / 20.0 * 2.0
    position = (2.0 * np.cos(angle), 2.0 * np.sin(angle), 1.0)
    return FormationState(position, (-speed * np.sin(angle), speed * np.cos(angle), 0.0))


def test_errors_are_about_a_moving_reference_at_its_own_time() -> None:
    # The leader entered at 9.5 s, the last vehicle at 10 s; a vehicle that keeps to the circle has no error.
    angle = 2 * pi * np.maximum(0.0, TIMES_S - 9.5) / 20.0
    slot = (-1.0, 0.5, 0.0)
    flown = track(2.0 * np.cos(angle) + slot[0], 2.0 * np.sin(angle) + slot[1], 1.0)
    figures = formation_figures({4: flown}, stand_at({4: slot}), circle, Formation(10.0, 50.0, 9.5))
    assert figures.final_error_m < 1e-3
    assert figures.settle_s == 0.0
    wrong = formation_figures({4: flown}, stand_at({4: slot}), circle, Formation(10.0, 50.0, 4.5))  # a quarter turn off
    assert wrong.final_error_m == pytest.approx(2.0 * sqrt(2.0), rel=1e-3)


def test_a_reference_is_constant_before_its_start() -> None:
    positions = reference_positions_m(circle, 10.0, np.array([0.0, 10.0, 15.0]))
    assert positions == pytest.approx(np.array([[2, 0, 1], [2, 0, 1], [0, 2, 1]]), abs=1e-9)


def test_the_smallest_distance_is_of_the_whole_flight() -> None:
    passing = np.abs(TIMES_S - 80.0) * 0.1 + 0.7
    assert smallest_distance_m({1: track(0.0), 2: track(passing), 3: track(50.0)}) == pytest.approx(0.7, abs=2e-3)
    assert smallest_distance_m({1: track(0.0)}) is None
    later = Track(TIMES_S + 1000.0, track(0.0).position_enu_m)
    assert smallest_distance_m({1: track(0.0), 2: later}) is None


@given(
    offset=st.tuples(*[st.floats(-50, 50)] * 3),
    late_s=st.floats(-0.02, 0.02),
    speed_m_s=st.floats(-5, 5),
)
def test_distances_are_independent_of_fleet_position_and_sample_times(
    offset: Vector3, late_s: float, speed_m_s: float
) -> None:
    """Two vehicles in straight flight 1.5 m apart, sampled at different times."""
    tracks = {}
    for vehicle_id, ahead_m in ((1, 0.0), (2, -1.5)):
        times_s = TIMES_S + (late_s if vehicle_id == 2 else 0.0)
        x = offset[0] + speed_m_s * times_s + ahead_m
        axes = [x, np.full_like(x, offset[1]), np.full_like(x, offset[2])]
        tracks[vehicle_id] = Track(times_s, np.stack(axes, axis=1))
    figures = formation_figures(
        tracks, stand_at({1: SLOTS[1], 2: SLOTS[2]}), point(offset), Formation(10.0, 20.0, 10.0)
    )
    assert figures.max_distance_m["1-2"] == pytest.approx(1.5, abs=1e-6)
    assert figures.min_distance_m["1-2"] == pytest.approx(1.5, abs=1e-6)


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=50))
def test_errors_are_within_the_bound_from_the_settling_time(values: list[float]) -> None:
    error_m = np.array(values)
    times_s = np.arange(error_m.size, dtype=float)
    settled_s = settle_time_s(times_s, error_m, 0.5)
    if settled_s is None:
        assert max(error_m[-3:]) > 0.5 or error_m.size < 3  # of the last 2 s
        return
    assert times_s[-1] - settled_s >= 2.0
    index = int(settled_s)
    assert np.all(error_m[index:] <= 0.5)
    assert index == 0 or error_m[index - 1] > 0.5


@given(st.floats(0.1, 100.0))
def test_sample_times_end_at_the_end_of_the_interval(duration_s: float) -> None:
    times_s = Formation(5.0, 5.0 + duration_s, 5.0).times_s()
    assert times_s[0] == 5.0
    assert times_s[-1] == 5.0 + duration_s
    assert all(later > sooner for sooner, later in pairwise(times_s.tolist()))


HEADER = "monotonic_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,roll_rad,pitch_rad,yaw_rad,thrust_norm,armed,mode"


def write_csv(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join([HEADER, *lines]), encoding="utf-8")
    return path


ROW = "{t},1.0,2.0,{z},0,0,0,0,0,0,0.49,1,OFFBOARD"


def test_an_incomplete_last_line_of_a_track_is_left_out(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "t.csv", [ROW.format(t=5.0, z=1.0), ROW.format(t=5.02, z=2.0), "5.04,1.0,2."])
    found = read_track(path)
    assert found.time_s.tolist() == [5.0, 5.02]
    assert found.at(np.array([5.01])).tolist() == [[1.0, 2.0, pytest.approx(1.5)]]


def test_an_empty_or_foreign_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrackError, match="holds no positions"):
        read_track(write_csv(tmp_path / "a.csv", []))
    other = tmp_path / "b.csv"
    other.write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(TrackError, match="has no column monotonic_s, x_m, y_m, z_m"):
        read_track(other)
    with pytest.raises(TrackError, match="cannot be read: No such file"):
        read_track(tmp_path / "c.csv")
