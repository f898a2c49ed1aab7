"""Who is left closes up: into which slots, when, and when not."""

from __future__ import annotations

import dataclasses
from math import dist
from pathlib import Path

import pytest
from msgspec.structs import replace
from test_joining import NOW_S, peer

from companion.config.fleet import check_fleet
from companion.config_file import ConfigError
from companion.core.closing_up import GONE_FOR_S, ClosingUp, closed_up
from companion.core.formation_limits import FormationLimits
from companion.core.peers import PeerState
from companion.core.slot_plan import SlotPlan
from companion.geometry.shapes import SHAPES, slots_of
from companion.types import FlightPhase, FormationChange, Vector3
from sitl.scenario import load_scenario

COLUMN: dict[int, Vector3] = {i: (-2.0 * (i - 1), 0.0, 0.0) for i in range(1, 6)}
LIMITS = FormationLimits(1.0, 1.0, ((-100.0, -100.0, -5.0), (100.0, 100.0, 50.0)))
SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"


@pytest.mark.parametrize(
    ("gone_id", "who_is_where"),
    [(3, [1, 2, 4, 5, 3]), (5, [1, 2, 3, 4, 5]), (2, [1, 3, 4, 5, 2]), (1, [2, 3, 4, 5, 1])],
)
def test_a_column_moves_up_and_the_gap_is_its_last_slot(gone_id: int, who_is_where: list[int]) -> None:
    slots = closed_up(COLUMN, gone_id, sorted(COLUMN.keys() - {gone_id}))
    assert [next(i for i, slot in slots.items() if slot == COLUMN[place]) for place in range(1, 6)] == who_is_where


@pytest.mark.parametrize("shape", SHAPES)
def test_in_every_shape_nobody_is_left_outside_of_the_gap(shape: str) -> None:
    slots = dict(enumerate(slots_of(SHAPES[shape], 9, 3.0, 0.3)))
    for gone_id in slots:
        after = closed_up(slots, gone_id, sorted(slots.keys() - {gone_id}))
        assert sorted(after.values()) == sorted(slots.values())
        assert (
            max(dist((0.0, 0.0, 0.0), slot) for slot in after.values()) <= dist((0.0, 0.0, 0.0), after[gone_id]) + 0.01
        )


def test_who_is_away_already_moves_nowhere_and_nobody_into_its_place() -> None:
    assert closed_up(COLUMN, 3, [1, 2, 5]) == COLUMN | {5: COLUMN[3], 3: COLUMN[5]}


def fleet(**of_3: object) -> dict[int, PeerState]:
    return {2: peer(2), 3: peer(3, **{"phase": FlightPhase.HOLD} | of_3)}


def left(phase: FlightPhase = FlightPhase.HOLD, limits: FormationLimits = LIMITS) -> ClosingUp:
    """Vehicle 3 was in formation, and left at NOW_S."""
    plan = ClosingUp(1, limits)
    plan.hear(NOW_S - 1.0, [peer(2).packet, peer(3).packet])
    plan.hear(NOW_S, [peer(2).packet, replace(peer(3).packet, phase=phase)])
    return plan


SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 3: (-2.0, 0.0, 0.0), 2: (-4.0, 0.0, 0.0)}
AT = (10.0, 0.0, 5.0)


def proposed(plan: ClosingUp, newest: dict[int, PeerState], now_s: float) -> FormationChange | None:
    found = plan.proposal(now_s, SLOTS, 4, newest, 50.0, lambda _s: AT)
    return found[1] if found else None


def test_it_is_closed_up_where_the_one_that_left_is_on_the_ground_or_away() -> None:
    for of_3 in ({"armed": False, "position_enu_m": (8.0, 0.0, 0.0)}, {"position_enu_m": (8.0, 4.0, 5.0)}):
        change = proposed(left(), fleet(**of_3), NOW_S + GONE_FOR_S)
        assert change is not None
        assert (change.number, change.absent) == (5, (3,))
        assert dict(change.slots_enu_m) == {1: SLOTS[1], 2: SLOTS[3], 3: SLOTS[2]}
        slots = SlotPlan(2, SLOTS, LIMITS)
        assert slots.obey(change, 50.0, (), [AT])[0]


def test_whoever_was_away_for_a_moment_only_has_its_place() -> None:
    plan = left()
    assert proposed(plan, fleet(armed=False), NOW_S + GONE_FOR_S - 0.1) is None
    plan.hear(NOW_S + 2.9, [peer(2).packet, peer(3).packet])
    assert proposed(plan, fleet(armed=False), NOW_S + 10.0) is None


@pytest.mark.parametrize("place", [(8.0, 0.0, 5.0), (7.0, 0.9, 5.0), (8.0, 0.0, 0.1), (6.0, 0.0, 9.0)])
def test_while_its_place_may_not_be_free_the_gap_is_kept_and_that_is_told_once(place: Vector3) -> None:
    plan = left()
    for second in range(9):
        assert proposed(plan, fleet(position_enu_m=place), NOW_S + GONE_FOR_S + second) is None
    assert len(plan.events) == 1
    assert plan.events[0].startswith("vehicle 3 left, and its gap is kept for now: it may still be in the air, ")
    assert plan.events[0].endswith("m beside the way of vehicle 2")
    assert proposed(plan, fleet(position_enu_m=place, armed=False), NOW_S + 30.0) is not None


def test_about_a_formation_that_turns_the_place_must_be_free_whichever_way_it_points() -> None:
    turning = dataclasses.replace(LIMITS, slots_turn=True)
    beside = fleet(position_enu_m=(10.0, 3.0, 5.0))  # as far from the RFT as the way leads, on another side
    assert proposed(left(), beside, NOW_S + GONE_FOR_S) is not None
    assert proposed(left(limits=turning), beside, NOW_S + GONE_FOR_S) is None
    assert proposed(left(limits=turning), fleet(position_enu_m=(10.0, 5.1, 5.0)), NOW_S + GONE_FOR_S) is not None


def test_who_fell_silent_in_formation_may_fly_on_in_its_slot() -> None:
    plan = left()
    plan.hear(NOW_S + 1.0, [peer(2).packet])
    silent = {"phase": FlightPhase.FORMATION, "position_enu_m": (8.0, -50.0, 5.0)}
    assert proposed(plan, fleet(**silent), NOW_S + 60.0) is None
    assert plan.events == [
        "vehicle 3 left, and its gap is kept for now: nothing is heard of it, and it may fly on in its slot"
    ]
    heard_again = fleet(**silent | {"phase": FlightPhase.OBSERVE})
    assert proposed(plan, heard_again, NOW_S + 61.0) is not None


def test_slots_of_others_that_are_away_count_as_flown_in() -> None:
    """Who says that they are empty? Only the one that left for sure takes no part."""
    plan = ClosingUp(1, LIMITS)
    plan.hear(NOW_S - 1.0, [peer(2).packet, peer(3).packet, replace(peer(2).packet, vehicle_id=4)])
    plan.hear(NOW_S, [peer(2).packet])
    four = SLOTS | {4: (-6.0, 0.0, 0.0)}
    found = plan.proposal(NOW_S + 4.0, four, 4, fleet(armed=False), 50.0, lambda _s: AT)
    assert found is not None
    assert found[1].absent == (3,)
    assert dict(found[1].slots_enu_m)[4] == four[4]


def test_it_does_not_begin_where_the_one_that_left_is_back() -> None:
    change = proposed(left(), fleet(armed=False), NOW_S + GONE_FOR_S)
    assert change is not None
    mover, back = SlotPlan(2, SLOTS, LIMITS), SlotPlan(3, SLOTS, LIMITS)
    for slots in (mover, back):
        assert slots.obey(change, 50.0, (), [])[0]
    slot = replace(peer(3).packet.slot, waiting=5)
    mover.update(change.begins_s, [replace(peer(3).packet, slot=slot, phase=FlightPhase.ENGAGE)], in_formation=True)
    back.update(change.begins_s, [], in_formation=True)
    for slots in (mover, back):
        assert slots.events == ["formation 5 does not begin: vehicle 3 is back in formation"]
        assert slots.flown.formation == 0


def test_ways_of_those_that_are_there_are_judged_all_the_same() -> None:
    swap = FormationChange(5, ((1, SLOTS[3]), (2, SLOTS[2]), (3, SLOTS[1])), 51.5, 10.0, absent=(2,))
    assert "slots of vehicles 1 and 3 come within 0.00 m" in SlotPlan(2, SLOTS, LIMITS).obey(swap, 50.0, (), [])[1]
    on_one_another = FormationChange(5, ((1, SLOTS[1]), (2, SLOTS[1]), (3, SLOTS[3])), 51.5, 10.0, absent=(2,))
    assert "come within 0.00 m" in SlotPlan(2, SLOTS, LIMITS).obey(on_one_another, 50.0, (), [])[1]


def test_edges_that_one_vehicle_holds_together_cannot_be_closed_up() -> None:
    fleet = replace(load_scenario(SCENARIOS / "platoon.yaml").fleet, when_one_leaves="close_up")
    with pytest.raises(ConfigError) as caught:
        check_fleet(Path("fleet.yaml"), fleet)
    assert "neighbours.edges: without vehicle 2, vehicle 3 is cut off from vehicle 1" in str(caught.value)
    good = load_scenario(SCENARIOS / "leaving.yaml")
    assert good.fleet.when_one_leaves == "close_up"
