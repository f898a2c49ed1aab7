"""Scenarios of the measurements: lines, grids, stars and complete graphs of any number of vehicles in hover."""

from __future__ import annotations

from itertools import combinations
from math import ceil, dist, sqrt
from pathlib import Path
from typing import Any

from sitl.flight.scenario import Scenario, load_scenario, scenario_from

SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"  # those that are shipped
SPACING_M = 2.0
HEIGHT_M = 2.0
TAKEOFF_S = 3.0

Position = tuple[float, float, float]
Edges = list[list[int]]
Content = dict[str, Any]


def line(count: int, form_s: float) -> Scenario:
    """Vehicles in a line, each a neighbour of the one ahead and the one behind."""
    slots = {i: (-SPACING_M * (i - 1), 0.0, 0.0) for i in range(1, count + 1)}
    return _scenario(_content(slots, _chain(count), form_s))


def laboratory(form_s: float, rate_hz: float) -> Scenario:
    """The platoon that is shipped, whose agents pass so many poses a second on; this long in formation."""
    form = f"{{command: takeoff, for_s: {TAKEOFF_S}}}, {{command: form, for_s: {form_s}}}"
    timeline = f"timeline=[{{command: prepare}}, {{command: arm}}, {form}, {{command: land}}]"
    return load_scenario(SCENARIOS / "lab_platoon.yaml", (f"fleet.external_vision.rate_hz={rate_hz}", timeline))


def grid(count: int, form_s: float) -> Scenario:
    """Vehicles on a square grid, each a neighbour of those beside it."""
    return _scenario(grid_content(count, form_s))


def grid_content(count: int, form_s: float) -> Content:
    """Of the scenario's file."""
    slots = _grid(count)
    edges = [[a, b] for a, b in combinations(slots, 2) if dist(slots[a], slots[b]) < 1.1 * SPACING_M]
    return _content(slots, edges, form_s)


def star(neighbours: int, form_s: float) -> Scenario:
    """Vehicle 2, a follower, has this many neighbours, vehicle 1, the leader, among them; they have no other."""
    return _scenario(star_content(neighbours, form_s))


def star_content(neighbours: int, form_s: float) -> Content:
    """Of the scenario's file."""
    slots = _grid(neighbours + 1)
    return _content(slots, [[2, i] for i in slots if i != 2], form_s)


def complete(count: int, form_s: float) -> Scenario:
    """Vehicles on a square grid, each a neighbour of all others."""
    slots = _grid(count)
    return _scenario(_content(slots, [[a, b] for a, b in combinations(slots, 2)], form_s))


def _grid(count: int) -> dict[int, Position]:
    columns = ceil(sqrt(count))
    places = range(count)
    return {n + 1: (-SPACING_M * (n // columns), SPACING_M * (n % columns), 0.0) for n in places}


def _chain(count: int) -> Edges:
    return [[i, i + 1] for i in range(1, count)]


def _scenario(content: Content) -> Scenario:
    return scenario_from(Path("bench"), content)


def _content(slots: dict[int, Position], edges: Edges, form_s: float) -> Content:
    """They stay in formation for `form_s`; sensors with their default noise."""
    members = [
        {"id": i, "role": "leader" if i == 1 else "follower", "slot_enu_m": list(slot)} for i, slot in slots.items()
    ]
    return {
        "fleet": {
            "name": "bench",
            "origin": {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_amsl_m": 488.0},
            "vehicles": members,
            "neighbours": {"kind": "edges", "edges": edges},
            "law": {"name": "cooperative"},
            "takeoff_height_m": HEIGHT_M,
        },
        "starts_enu_m": {i: list(slot) for i, slot in slots.items()},
        "reference": {"kind": "point", "point_enu_m": [1.0, 0.0, HEIGHT_M]},
        "stand_in": {"sensors": "default"},
        "timeline": [
            {"command": "prepare"},
            {"command": "arm"},
            {"command": "takeoff", "for_s": TAKEOFF_S},
            {"command": "form", "for_s": form_s},
            {"command": "land"},
        ],
    }
