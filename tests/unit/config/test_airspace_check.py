"""Fence polygon, obstacles and speed limits of a fleet file, and references in this airspace."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from companion.config.fleet import FleetConfig
from companion.config.fleet_check import fleet_problems
from companion.config.reference import CircleReference, PointReference, Reference, WaypointsReference
from companion.config.reference_check import reference_problems

U_SHAPE = [[0, 0], [30, 0], [30, 20], [20, 20], [20, 10], [10, 10], [10, 20], [0, 20]]
MAST = {"kind": "cylinder", "centre_enu_m": [5.0, 5.0], "radius_m": 1.0, "top_m": 6.0}
PLAIN: dict[str, Any] = {
    "name": "pair",
    "origin": "indoor",
    "vehicles": [
        {"id": 1, "role": "leader", "slot_enu_m": [0.0, 0.0, 0.0]},
        {"id": 2, "role": "follower", "slot_enu_m": [0.0, -3.0, 0.0]},
    ],
    "neighbours": {"kind": "edges", "edges": [[1, 2]]},
}


def fleet_of(envelope: dict[str, Any] | None = None, *obstacles: dict[str, Any], **more: Any) -> FleetConfig:
    data = PLAIN | {"envelope": envelope or {}, "obstacles": list(obstacles)} | more
    return msgspec.convert(data, FleetConfig, strict=True)


@pytest.mark.parametrize(
    ("fleet", "field", "words"),
    [
        (fleet_of({"fence_corners_enu_m": [[0, 0], [1, 1]]}), "envelope.fence_corners_enu_m", "has 2 corners"),
        (
            fleet_of({"fence_corners_enu_m": [[0, 0], [9, 9], [9, 0], [0, 9]]}),
            "envelope.fence_corners_enu_m",
            "corners 0 and 2 touch or cross",
        ),
        (
            fleet_of({"fence_corners_enu_m": [[0, 0], [0.5, 0], [0, 0.5]]}),
            "envelope.fence_corners_enu_m",
            "area of 0.1",
        ),
        (fleet_of({"clearance_m": 60}), "envelope.clearance_m", "60 leaves no room along z"),
        (fleet_of({}, MAST | {"bottom_m": 7.0}), "obstacles[0].bottom_m", "7: expected less than top_m, 6"),
        (
            fleet_of({}, MAST, {"kind": "box", "min_enu_m": [0, 3, 0], "max_enu_m": [1, 2, 9]}),
            "obstacles[1].min_enu_m",
            "y is 3, expected less than max_enu_m's 2",
        ),
        (fleet_of(peers={"max_speed_m_s": 9}), "peers.max_speed_m_s", "9 is less than the 12.4 m/s"),
    ],
)
def test_an_unusable_airspace_is_refused_with_its_field(fleet: FleetConfig, field: str, words: str) -> None:
    (problem,) = fleet_problems(fleet)
    assert problem.field == field
    assert words in problem.text


def refused(reference: Reference, fleet: FleetConfig) -> list[str]:
    return [f"{problem.field}: {problem.text}" for problem in reference_problems(fleet, reference)]


def test_a_slot_in_an_obstacle_is_refused() -> None:
    (line,) = refused(PointReference((5.0, 8.5, 3.0)), fleet_of({}, MAST))
    assert line.startswith("reference.point_enu_m: brings vehicle 2 to (5.0, 5.5, 3.0), too near to obstacles[0];")
    assert not refused(PointReference((5.0, 8.5, 6.6)), fleet_of({}, MAST))  # above it


def test_a_leg_through_an_obstacle_or_a_notch_of_the_fence_is_refused() -> None:
    ways = WaypointsReference(((5.0, 18.0, 3.0), (5.0, 9.0, 3.0), (25.0, 9.0, 3.0), (25.0, 18.0, 3.0)))
    fleet = fleet_of({"fence_corners_enu_m": U_SHAPE})
    assert not refused(ways, fleet)
    straight = WaypointsReference(((5.0, 18.0, 3.0), (25.0, 18.0, 3.0)))
    assert "too near to the fence" in refused(straight, fleet)[0]
    assert "too near to obstacles[0]" in refused(ways, fleet_of({"fence_corners_enu_m": U_SHAPE}, MAST))[0]


def test_a_formation_that_turns_needs_room_on_its_whole_circle() -> None:
    circle = CircleReference(centre_enu_m=(5.0, 5.0, 3.0), radius_m=5.0, period_s=60.0)
    north = fleet_of({}, MAST, vehicles=[PLAIN["vehicles"][0], PLAIN["vehicles"][1] | {"slot_enu_m": [4.0, 0.0, 0.0]}])
    assert "brings vehicle 2" in refused(circle, msgspec.structs.replace(north, formation_heading="course"))[0]


def test_a_leg_that_descends_too_fast_is_refused_with_the_speed_that_would_do() -> None:
    down = WaypointsReference(((0.0, 0.0, 30.0), (0.0, 0.0, 5.0)), max_speed_m_s=4.0)
    (line,) = refused(down, fleet_of())
    assert line == (
        "reference.max_speed_m_s: 4 gives 3.9 m/s vertically, envelope.max_descent_m_s allows 2; expected at most 2"
    )
    assert not refused(msgspec.structs.replace(down, max_speed_m_s=2.0), fleet_of())
