"""The defaults of a scenario: slots of a shape, neighbours by range, starts below the slots."""

from itertools import combinations
from math import dist
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from companion.analysis.response import reached_from
from companion.config.file import ConfigError
from companion.config.fleet import RangeNeighbours
from companion.config.planned_flight import DEFAULT_ORIGIN, ShapeName, default_neighbours, neighbour_graph
from companion.geometry.formations import SHAPES
from companion.tools.subject import load_subject
from sitl.flight.scenario import STANDARD_TIMELINE, Scenario, load_scenario

POINT = {"kind": "point", "point_enu_m": [5.0, 1.0, 3.0]}


def scenario_of(tmp_path: Path, fleet: dict[str, Any], **more: Any) -> Scenario:
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump({"fleet": fleet, "reference": POINT} | more), encoding="utf-8")
    subject, scenario = load_subject(path), load_scenario(path)
    assert (subject.fleet, subject.starts_enu_m) == (scenario.fleet, scenario.starts_enu_m)
    return scenario


def test_a_minimal_scenario_is_a_number_a_shape_and_a_reference(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, {"vehicles": 3, "formation": {"shape": "column", "spacing_m": 2.0}})
    assert [m.slot_enu_m for m in scenario.fleet.vehicles] == [(0.0, 0.0, 0.0), (-2.0, 0.0, 0.0), (-4.0, 0.0, 0.0)]
    assert [m.can_lead for m in scenario.fleet.vehicles] == [True, False, False]
    assert scenario.fleet.origin == DEFAULT_ORIGIN
    assert scenario.fleet.neighbours == RangeNeighbours(range_m=3.0, hysteresis_m=0.5)
    assert scenario.starts_enu_m == {1: (5.0, 1.0, 0.0), 2: (3.0, 1.0, 0.0), 3: (1.0, 1.0, 0.0)}
    assert scenario.timeline == STANDARD_TIMELINE


def test_the_names_of_shapes_are_those_of_the_geometry() -> None:
    assert set(get_args(ShapeName)) == set(SHAPES)


@pytest.mark.parametrize("shape", sorted(SHAPES))
@pytest.mark.parametrize("count", range(1, 13))
def test_default_neighbours_connect_and_default_starts_allow_a_takeoff(shape: str, count: int, tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, {"vehicles": count, "formation": {"shape": shape, "spacing_m": 1.2}})
    slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    graph = neighbour_graph(scenario.fleet.neighbours, slots)
    assert reached_from(graph, [1]) == set(slots)
    for a, b in combinations(scenario.starts_enu_m.values(), 2):
        assert dist(a, b) >= scenario.fleet.separation_m


def test_the_default_range_connects_scattered_slots() -> None:
    neighbours = default_neighbours([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (1.0, 0.0, 0.0), (12.0, 0.0, 0.0)])
    assert neighbours == RangeNeighbours(range_m=13.5, hysteresis_m=2.25)


def test_slots_above_each_other_need_starts_in_the_file(tmp_path: Path) -> None:
    members = [
        {"id": 1, "role": "leader", "slot_enu_m": [0.0, 0.0, 0.0]},
        {"id": 2, "role": "follower", "slot_enu_m": [0.0, 0.0, 2.0]},
    ]
    with pytest.raises(ConfigError, match=r"starts_enu_m\.2: .* expected at least 0.3 m"):
        scenario_of(tmp_path, {"vehicles": members})


@pytest.mark.parametrize(
    ("fleet", "text"),
    [
        ({"vehicles": 3}, "fleet.formation: missing; vehicles: 3 needs a shape and its spacing_m"),
        (
            {
                "vehicles": [{"id": 1, "role": "leader", "slot_enu_m": [0, 0, 0]}],
                "formation": {"shape": "v", "spacing_m": 2},
            },
            "fleet.formation: goes with a number of vehicles",
        ),
        (
            {"vehicles": 0, "formation": {"shape": "v", "spacing_m": 2}},
            "fleet.vehicles: 0: expected a whole number >= 1",
        ),
        ({"vehicles": "three"}, "fleet.vehicles: 'three': expected a whole number or a list"),
        ({"vehicles": 3, "formation": {"shape": "w", "spacing_m": 2}}, "fleet.formation.shape: 'w': expected one of"),
    ],
)
def test_a_number_of_vehicles_goes_with_a_shape(fleet: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        scenario_of(tmp_path, fleet)
    (line,) = caught.value.lines
    assert text in line
