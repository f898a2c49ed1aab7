"""Figures of a fleet, against hand-worked values and against the analysis of the paper's law."""

from __future__ import annotations

from math import dist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.analysis.interaction import interaction_matrix
from companion.config.law import LawSection, law_of
from companion.monitor.api import BatteryView, NearestView, VehicleView
from companion.monitor.fleet_figures import FleetFigures, convergence, smallest_separation, weakest_link
from companion.types.values import Vector3
from live_site import monitored_vehicle

WEIGHTED = LawSection(name="weighted")
coordinates = st.floats(-100.0, 100.0)
positions = st.dictionaries(st.integers(1, 30), st.tuples(coordinates, coordinates, coordinates), max_size=8)


def test_a_metre_of_height_counts_half() -> None:
    found = smallest_separation({1: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 4.0), 7: (3.0, 0.0, 0.0)})
    assert found == (2.0, (1, 2))
    assert smallest_separation({1: (0.0, 0.0, 0.0)}) is None


def test_a_silent_vehicle_counts_where_another_one_sees_it() -> None:
    """It hovers in the way; from here nothing is received of it."""
    one = monitored_vehicle(1, nearest=NearestView("3", 1.75, 1.35, 0.2), position_enu_m=(0.0, 0.0, 2.0))
    other = monitored_vehicle(2, nearest=NearestView("1", 1.97, 1.3, 0.0), position_enu_m=(1.97, 0.0, 2.0))
    view = FleetFigures("platoon", None).view(10.0, [one, other])
    assert (view.smallest_separation_m, view.smallest_separation_pair) == (1.75, (1, 3))
    assert view.smallest_separation_unheard
    away = replace(one, nearest=NearestView("airliner", 1.0, 1.0, 0.0))  # traffic is no vehicle of the fleet
    view = FleetFigures("platoon", None).view(10.0, [away, other])
    assert (view.smallest_separation_m, view.smallest_separation_pair) == (1.97, (1, 2))
    assert not view.smallest_separation_unheard


def charged(percent: float | None, other: float | None = 80.0) -> list[VehicleView]:
    return [monitored_vehicle(1, battery_percent=other), monitored_vehicle(2, battery_percent=percent)]


def test_the_time_left_is_by_the_charge_lost_in_the_last_minute() -> None:
    figures = FleetFigures("platoon", None)
    lowest = None
    for second in range(120):  # whole percents; 2 % a minute, then 6 %
        percent = 50.0 - (second // 30 if second < 60 else 2 + (second - 60) // 10)
        lowest = figures.view(1000.0 + second, charged(percent)).battery_lowest
        assert second >= 30 or (lowest and lowest.left_min is None)
        assert second != 60 or lowest == BatteryView(2, 48.0, pytest.approx(24.0, rel=0.25))
    assert lowest == BatteryView(2, 43.0, pytest.approx(43.0 / 6.0, rel=0.15))
    assert figures.view(1121.0, charged(90.0)).battery_lowest == BatteryView(1, 80.0, None)  # it has another one
    assert figures.view(1122.0, charged(None, None)).battery_lowest is None


def test_the_wind_is_that_of_vehicles_in_formation() -> None:
    pushed = monitored_vehicle(1, phase="formation", wind_acceleration_enu_m_s2=(0.4, -0.2, 0.0))
    calm = monitored_vehicle(2, phase="formation", wind_acceleration_enu_m_s2=(0.2, 0.0, 0.0))
    landed = monitored_vehicle(3, phase="observe", wind_acceleration_enu_m_s2=(9.0, 9.0, 9.0))
    figures = FleetFigures("platoon", None)
    assert figures.view(10.0, [pushed, calm, landed]).wind_acceleration_enu_m_s2 == (0.3, -0.1, 0.0)
    assert figures.view(11.0, [landed]).wind_acceleration_enu_m_s2 is None


def test_lambda_min_and_settling_of_a_chain_of_three() -> None:
    """G of leader - follower - follower by eq. 6 with the weights of Algorithm 2, worked with numpy's general solver."""
    edges = frozenset({(1, 2), (2, 3)})
    lambda_min, settling_s = convergence(frozenset({1, 2, 3}), edges, frozenset({1}), WEIGHTED)
    law = law_of(WEIGHTED)
    matrix = interaction_matrix({1: [2], 2: [1, 3], 3: [2]}, {1}, law)
    smallest = float(np.linalg.eigvals(matrix).real.min())
    assert lambda_min == pytest.approx(smallest, abs=1e-4)
    # Below critical damping errors shrink with k2 lambda / 2 (Corollary 1).
    assert settling_s == pytest.approx(np.log(10.0) / (law.velocity_gain_1_s * smallest / 2.0), abs=0.01)


def test_without_a_path_to_a_leader_nothing_converges() -> None:
    assert convergence(frozenset({1, 2, 3}), frozenset({(1, 2)}), frozenset({1}), WEIGHTED) == (0.0, None)
    assert convergence(frozenset({1, 2}), frozenset({(1, 2)}), frozenset(), WEIGHTED) == (0.0, None)
    assert convergence(frozenset(), frozenset(), frozenset(), WEIGHTED) == (None, None)


def test_the_weakest_link_is_the_longest_that_the_fleet_cannot_spare() -> None:
    """1 - 2 - 3 in a line; the link 1 - 3 of 5 m is the longest, but 1 and 3 are connected through 2."""
    line: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (2.0, 0.0, 0.0), 3: (5.0, 0.0, 0.0)}
    edges = frozenset({(1, 2), (2, 3), (1, 3)})
    assert weakest_link(line, edges, 6.0) == (3.0, (2, 3))
    assert weakest_link(line, frozenset(), 6.0) is None


@given(positions, st.data())
def test_without_the_weakest_link_and_longer_ones_a_part_is_cut_off(
    fleet: dict[int, Vector3], data: st.DataObject
) -> None:
    pairs = [(i, j) for i in fleet for j in fleet if i < j]
    edges = frozenset(data.draw(st.lists(st.sampled_from(pairs)))) if pairs else frozenset()
    found = weakest_link(fleet, edges, 0.0)
    if found is None:
        assert not edges
        return
    length_m, (i, j) = -found[0], found[1]
    assert length_m == dist(fleet[i], fleet[j])
    shorter = [(a, b) for a, b in edges if dist(fleet[a], fleet[b]) < length_m]
    reached = {i}
    while more := {b for a, b in shorter + [(b, a) for a, b in shorter] if a in reached} - reached:
        reached |= more
    assert j not in reached
