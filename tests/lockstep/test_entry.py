"""Vehicles that enter formation from far away, and references that begin away from the fleet: true speeds and distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.ground.changes import change_to, reference_change
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.values import Vector3
from lockstep_fleet import EnteringFleet, scenario_of

SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-3.0, 0.0, 0.0), 3: (-6.0, 0.0, 0.0), 4: (-9.0, 0.0, 0.0)}
JOINING_M_S = 1.0  # slot_speed_m_s


def point(x: float, y: float = 0.0) -> dict[str, object]:
    return {"kind": "point", "point_enu_m": [x, y, 5.0]}


def shuffled_starts(seed: int) -> dict[int, Vector3]:
    """Starts up to 3 m beside the slots."""
    rng = np.random.default_rng(seed)
    return {
        i: (x + float(rng.uniform(-0.8, 0.8)), y + float(rng.uniform(-3.0, 3.0)), 0.0) for i, (x, y, _) in SLOTS.items()
    }


@pytest.mark.parametrize(
    "overrides",
    [
        pytest.param((), marks=pytest.mark.long),
        ("stand_in.sensors=default", "links.peer_delay_s=0.1", "links.peer_loss=0.1"),
    ],
)
def test_a_fleet_30_m_from_its_reference_enters_at_the_joining_speed(
    tmp_path: Path, overrides: tuple[str, ...]
) -> None:
    fleet = EnteringFleet(scenario_of(tmp_path, SLOTS, SLOTS, point(30.0), *overrides))
    assert fleet.accepted(CommandName.FORM)
    fleet.go_on(75.0)
    assert fleet.phases() == {FlightPhase.FORMATION}
    assert max(fleet.errors_m().values()) < 0.3
    assert fleet.largest_speed_m_s() < JOINING_M_S + 0.3
    assert fleet.smallest_m() > 2.5
    assert fleet.largest_tilt_deg() < 8.0


def test_a_circle_10_m_away_is_entered_at_the_joining_speed_and_its_own(tmp_path: Path) -> None:
    circle = {"kind": "circle", "centre_enu_m": [6.0, 0.0, 5.0], "radius_m": 4.0, "period_s": 25.0, "ramp_s": 8.0}
    fleet = EnteringFleet(scenario_of(tmp_path, SLOTS, SLOTS, circle))
    assert fleet.accepted(CommandName.FORM)
    fleet.go_on(40.0)
    assert fleet.phases() == {FlightPhase.FORMATION}
    assert fleet.largest_speed_m_s() < JOINING_M_S + 1.05 + 0.2  # the circle is flown at 1.005 m/s
    assert fleet.largest_tilt_deg() < 10.0
    assert fleet.smallest_m() > 2.7


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_vehicles_beside_their_slots_keep_their_distance_with_a_reference_away(tmp_path: Path, seed: int) -> None:
    fleet = EnteringFleet(scenario_of(tmp_path, SLOTS, shuffled_starts(seed), point(4.0, 4.0)))
    assert fleet.accepted(CommandName.FORM)
    fleet.go_on(25.0)
    assert fleet.phases() == {FlightPhase.FORMATION}
    assert max(fleet.errors_m().values()) < 0.1
    assert fleet.largest_speed_m_s() < JOINING_M_S + 0.2
    assert fleet.smallest_m() > 1.6  # as on straight paths: the starts are at least 1.7 m apart


def test_vehicles_in_hold_attract_none_that_form(tmp_path: Path) -> None:
    starts = SLOTS | {4: (-14.0, 2.0, 0.0)}
    fleet = EnteringFleet(scenario_of(tmp_path, SLOTS, starts, point(0.0)))
    assert fleet.accepted(CommandName.FORM, 1, 2, 3)
    worst_m = 0.0
    for _ in range(20):
        fleet.go_on(0.2)
        errors = fleet.errors_m()
        worst_m = max(worst_m, errors[1], errors[2], errors[3])
    assert worst_m < 0.1
    assert fleet.newest[4].phase is FlightPhase.HOLD


def test_changes_past_a_vehicle_in_hold_are_refused(tmp_path: Path) -> None:
    starts = SLOTS | {4: (-9.0, 6.0, 0.0)}  # beside the column
    fleet = EnteringFleet(scenario_of(tmp_path, SLOTS, starts, point(0.0)))
    assert fleet.accepted(CommandName.FORM, 1, 2, 3)
    fleet.go_on(2.0)
    past = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 5.0], [-3.0, 6.0, 5.0]]}
    aside = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 5.0], [0.0, -5.0, 5.0]]}
    replies = fleet.give(CommandName.REFERENCE, 1, 2, 3, content=reference_change(past, list(fleet.newest.values())))
    assert {reply and reply.code for reply in replies.values()} == {Code.VEHICLE_IN_THE_WAY}
    beside = {1: (0.0, 0.0, 0.0), 2: (-3.0, 0.0, 0.0), 3: (-9.0, 7.0, 0.0), 4: (-9.0, 0.0, 0.0)}
    replies = fleet.give(CommandName.FORMATION, content=change_to(beside, list(fleet.newest.values()), 1.0))
    assert replies[1] is not None
    assert replies[1].code is Code.VEHICLE_IN_THE_WAY
    assert fleet.accepted(CommandName.REFERENCE, 1, 2, 3, content=reference_change(aside, list(fleet.newest.values())))


def test_a_leader_that_returns_from_hold_leads_in_from_where_the_fleet_waits(tmp_path: Path) -> None:
    """The pilot of the leader takes it 6 m away; the fleet waits with it, and its reference is where it was."""
    line = {
        "kind": "waypoints",
        "points_enu_m": [[0.0, 0.0, 5.0], [30.0, 0.0, 5.0]],
        "max_speed_m_s": 3.0,
        "max_acceleration_m_s2": 1.0,
    }
    fleet = EnteringFleet(scenario_of(tmp_path, SLOTS, SLOTS, line))
    assert fleet.accepted(CommandName.FORM)
    fleet.go_on(6.0)
    assert fleet.accepted(CommandName.HOLD, 1)
    fleet.go_on(5.0)
    fleet.began_s = fleet.lockstep.now_s()
    assert fleet.accepted(CommandName.FORM, 1), fleet.events[-3:]
    fleet.go_on(30.0)
    assert fleet.phases() == {FlightPhase.FORMATION}
    assert max(fleet.errors_m().values()) < 0.1
    assert fleet.smallest_m() > 2.5
