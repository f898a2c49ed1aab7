"""Previews from reports: paths, distances, tracks, and what would be refused."""

from __future__ import annotations

from typing import Any

import pytest

from common import with_fields
from companion.monitor.api import CommandRequest, Preview
from companion.monitor.command_requests import fleet_action, preview_of
from companion.types.formation import Heading
from companion.types.status import Status
from tests.bench.monitor_load import steady_fleet

LOAD = steady_fleet("load", 4)
STATUSES = {i: LOAD.report(i, 30.0).status for i in LOAD.vehicle_ids}


def preview(name: str, content: dict[str, Any], statuses: dict[int, Status] = STATUSES) -> Preview:
    return preview_of(fleet_action(CommandRequest("load", name, (), content), LOAD.fleet), LOAD.fleet, statuses)


def test_paths_lead_from_the_present_slots_to_the_new_ones_in_the_fleet_frame() -> None:
    found = preview("formation", {"shape": "line", "spacing_m": 5.0})
    reference_enu_m = STATUSES[1].formation.reference_enu_m
    assert reference_enu_m is not None
    for path in found.paths:
        offset = STATUSES[path.vehicle_id].formation.slot.position_enu_m
        assert path.from_enu_m == pytest.approx([a + b for a, b in zip(reference_enu_m, offset, strict=True)], abs=2e-3)
    assert sorted(round(p.to_enu_m[1] - reference_enu_m[1], 2) for p in found.paths) == [-7.5, -2.5, 2.5, 7.5]
    assert found.refused == ""
    assert found.lasts_s is not None
    assert found.lasts_s > 1.0
    assert found.smallest_separation_m is not None
    assert found.smallest_separation_m >= 5.0 / 2**0.5 - 1e-3


def test_slots_that_are_too_close_are_refused_and_shown() -> None:
    found = preview("formation", {"shape": "line", "spacing_m": 0.2})
    assert "expected at least separation_m" in found.refused
    assert len(found.paths) == 4
    assert preview("formation", {"shape": "line"} | found.instead).refused == ""
    assert preview("formation", {"shape": "line", "spacing_m": found.instead["spacing_m"] - 0.02}).refused
    scaled = preview("formation", {"scale": 0.1, "heading_deg": 30.0})
    assert preview("formation", {"heading_deg": 30.0} | scaled.instead).refused == ""


def test_slots_of_a_preview_are_a_formation_one_by_one() -> None:
    turned = {i: with_fields(status, heading=Heading(0.5)) for i, status in STATUSES.items()}
    found = preview("formation", {"shape": "line", "spacing_m": 5.0, "heading_deg": 20.0}, turned)
    same = preview("formation", {"slots_enu_m": {str(i): slot for i, slot in found.slots_enu_m.items()}}, turned)
    assert (found.heading_rad, same.slots_enu_m) == (0.5, found.slots_enu_m)
    for path, other in zip(found.paths, same.paths, strict=True):
        assert path.to_enu_m == pytest.approx(other.to_enu_m, abs=2e-3)
    close = {str(i): (0.1 * i, 0.0, 0.0) for i in LOAD.vehicle_ids}
    assert preview("formation", {"slots_enu_m": close}).instead == {}


def test_a_formation_of_those_that_report_has_a_slot_left_over() -> None:
    some = {i: status for i, status in STATUSES.items() if i != 3}
    found = preview("formation", {"shape": "line", "spacing_m": 5.0}, some)
    assert found.refused == ""
    assert [path.vehicle_id for path in found.paths] == [1, 2, 4]
    assert preview("formation", {"shape": "line", "spacing_m": 5.0}, {}).refused == "no report of any vehicle"


def test_before_a_flight_slots_are_about_the_vehicles() -> None:
    on_ground = {i: with_fields(status, reference_enu_m=None) for i, status in STATUSES.items()}
    found = preview("formation", {"shape": "line", "spacing_m": 5.0}, on_ground)
    middle = [sum(p.to_enu_m[axis] for p in found.paths) / 4 for axis in range(3)]
    present = [sum(s.motion.position_enu_m[axis] for s in on_ground.values()) / 4 for axis in range(3)]
    assert middle == pytest.approx(present, abs=0.01)


def test_the_track_of_a_reference_is_its_curve() -> None:
    content = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 10.0], [8.0, 0.0, 10.0]]}
    found = preview("reference", content)
    assert (found.track_enu_m[0], found.track_enu_m[-1]) == ((0.0, 0.0, 10.0), (8.0, 0.0, 10.0))
    assert found.lasts_s is not None
    assert found.refused == ""


def test_a_reference_outside_the_fence_is_refused_and_shown() -> None:
    found = preview("reference", {"kind": "point", "point_enu_m": [9000.0, 0.0, 10.0]})
    assert "outside the fence" in found.refused
    assert found.track_enu_m == ((9000.0, 0.0, 10.0),)
