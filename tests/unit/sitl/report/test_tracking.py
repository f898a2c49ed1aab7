"""Tracking errors to the RFT and to the leaders, from known tracks."""

import numpy as np
import pytest

from companion.core.reference.blend import point
from sitl.report.metrics import Formation, Track, stand_at, tracking

SLOTS = stand_at({1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)})
ORIGIN = point((0.0, 0.0, 0.0))
FORMATION = Formation(0.0, 100.0, 0.0)


def at(x_m: float) -> Track:
    return Track(np.array([0.0, 100.0]), np.array([[x_m, 0.0, 0.0]] * 2))


def test_the_error_of_a_follower_is_about_its_leader() -> None:
    tracks = {1: at(0.1), 2: at(-2.0), 3: at(-4.0)}
    leads = {1: [(0.0, True)], 2: [(0.0, False)], 3: [(0.0, False)]}
    found = tracking(tracks, SLOTS, ORIGIN, FORMATION, leads)
    assert found.to_reference_m == pytest.approx({1: 0.1, 2: 0.0, 3: 0.0})
    assert found.to_leader_m == {1: None, 2: pytest.approx(0.1), 3: pytest.approx(0.1)}


def test_the_leader_used_for_the_error_changes_with_leadership() -> None:
    """Vehicle 2 is leader from 75 s on, for half of the evaluated interval."""
    tracks = {1: at(0.0), 2: at(-2.2), 3: at(-4.0)}
    leads = {1: [(0.0, True), (75.0, False)], 2: [(0.0, False), (75.0, True)], 3: [(0.0, False)]}
    found = tracking(tracks, SLOTS, ORIGIN, FORMATION, leads).to_leader_m
    assert found[1] == pytest.approx(0.2)
    assert found[2] == pytest.approx(0.2)
    assert found[3] == pytest.approx(0.2 / np.sqrt(2.0), rel=1e-2)


def test_the_mean_of_several_leaders_is_used() -> None:
    tracks = {1: at(0.1), 2: at(-1.7), 3: at(-4.0)}
    leads = {1: [(0.0, True)], 2: [(0.0, True)], 3: [(0.0, False)]}
    assert tracking(tracks, SLOTS, ORIGIN, FORMATION, leads).to_leader_m[3] == pytest.approx(0.2)


def test_only_the_second_half_of_the_formation_is_used() -> None:
    moved = Track(np.array([0.0, 49.0, 49.5, 100.0]), np.array([[9.0, 0.0, 0.0]] * 2 + [[0.0, 0.0, 0.0]] * 2))
    leads = {i: [(0.0, i == 1)] for i in (1, 2, 3)}
    found = tracking({1: moved, 2: at(-2.0), 3: at(-4.0)}, SLOTS, ORIGIN, FORMATION, leads)
    assert found.to_reference_m[1] == 0.0


def test_there_is_no_error_about_a_leader_without_leaders() -> None:
    leads = {i: [(0.0, False)] for i in (1, 2, 3)}
    found = tracking({1: at(0.0), 2: at(-2.0), 3: at(-4.0)}, SLOTS, ORIGIN, FORMATION, leads)
    assert found.to_leader_m == {1: None, 2: None, 3: None}
