"""Gap filling: into which slots the others move, when, and when the gap is kept."""

from __future__ import annotations

import dataclasses
from math import dist
from pathlib import Path

import pytest
from msgspec.structs import replace

from common import NOW_S, ROOT, codes_of, peer, with_fields
from companion.config.file import ConfigError, refuse
from companion.config.fleet_check import fleet_problems
from companion.core.consensus.peers import PeerState
from companion.core.formation.gaps import GONE_FOR_S, GapFilling, Proposal, closed_up
from companion.core.formation.limits import FormationLimits
from companion.core.formation.slots import SlotPlan
from companion.geometry.formations import SHAPES, slots_of
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Code, Notice
from companion.types.values import Vector3
from sitl.flight.scenario import load_scenario

COLUMN: dict[int, Vector3] = {i: (-2.0 * (i - 1), 0.0, 0.0) for i in range(1, 6)}
LIMITS = FormationLimits(1.0, 1.0, ((-100.0, -100.0, -5.0), (100.0, 100.0, 50.0)))
SCENARIOS = ROOT / "config" / "scenarios"


@pytest.mark.parametrize(
    ("gone_id", "ids_by_slot"),
    [(3, [1, 2, 4, 5, 3]), (5, [1, 2, 3, 4, 5]), (2, [1, 3, 4, 5, 2]), (1, [2, 3, 4, 5, 1])],
)
def test_a_column_moves_up_when_a_vehicle_left(gone_id: int, ids_by_slot: list[int]) -> None:
    slots = closed_up(COLUMN, gone_id, sorted(COLUMN.keys() - {gone_id}))
    assert [next(i for i, slot in slots.items() if slot == COLUMN[index]) for index in range(1, 6)] == ids_by_slot


@pytest.mark.parametrize("shape", SHAPES)
def test_no_vehicle_stays_outside_the_gap_in_any_shape(shape: str) -> None:
    slots = dict(enumerate(slots_of(SHAPES[shape], 9, 3.0, 0.3)))
    for gone_id in slots:
        after = closed_up(slots, gone_id, sorted(slots.keys() - {gone_id}))
        assert sorted(after.values()) == sorted(slots.values())
        assert (
            max(dist((0.0, 0.0, 0.0), slot) for slot in after.values()) <= dist((0.0, 0.0, 0.0), after[gone_id]) + 0.01
        )


def test_another_absent_vehicle_keeps_its_slot() -> None:
    assert closed_up(COLUMN, 3, [1, 2, 5]) == COLUMN | {5: COLUMN[3], 3: COLUMN[5]}


def fleet(**of_3: object) -> dict[int, PeerState]:
    return {2: peer(2), 3: peer(3, **{"phase": FlightPhase.HOLD} | of_3)}


def left(phase: FlightPhase = FlightPhase.HOLD, limits: FormationLimits = LIMITS) -> GapFilling:
    """Vehicle 3 was in formation, and left at NOW_S."""
    plan = GapFilling(1, limits)
    plan.update(NOW_S - 1.0, [peer(2).packet, peer(3).packet])
    plan.update(NOW_S, [peer(2).packet, replace(peer(3).packet, phase=phase)])
    return plan


SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 3: (-2.0, 0.0, 0.0), 2: (-4.0, 0.0, 0.0)}
AT = (10.0, 0.0, 5.0)


def checked(plan: GapFilling, newest: dict[int, PeerState], now_s: float) -> Proposal:
    return plan.propose(now_s, SLOTS, 4, newest, 50.0, lambda _s: AT)


def proposed(plan: GapFilling, newest: dict[int, PeerState], now_s: float) -> FormationChange | None:
    return checked(plan, newest, now_s).change


def test_the_gap_is_closed_when_the_vehicle_has_landed_or_is_clear_of_the_paths() -> None:
    for of_3 in ({"armed": False, "position_enu_m": (8.0, 0.0, 0.0)}, {"position_enu_m": (8.0, 4.0, 5.0)}):
        change = proposed(left(), fleet(**of_3), NOW_S + GONE_FOR_S)
        assert change is not None
        assert (change.number, change.absent) == (5, (3,))
        assert dict(change.slots_enu_m) == {1: SLOTS[1], 2: SLOTS[3], 3: SLOTS[2]}
        slots = SlotPlan(2, SLOTS, LIMITS)
        assert slots.judge(change, 50.0, (), [AT]).carried_out()[0]


@pytest.mark.parametrize(("waiting", "number"), [(6, 7), (20, 21), (21, 5), (2**62, 5)])
def test_a_wrong_number_of_a_peer_stops_no_gap_from_being_closed(waiting: int, number: int) -> None:
    """A vehicle may have missed a few changes; a number far ahead would be refused by all, for as long as it is known."""
    newest = fleet(armed=False)
    newest[2] = peer(2, slot=FlownSlot(SLOTS[2], formation=4, waiting=waiting))
    change = proposed(left(), newest, NOW_S + GONE_FOR_S)
    assert change is not None
    assert change.number == number


def test_a_short_absence_closes_no_gap() -> None:
    plan = left()
    assert proposed(plan, fleet(armed=False), NOW_S + GONE_FOR_S - 0.1) is None
    plan.update(NOW_S + 2.9, [peer(2).packet, peer(3).packet])
    assert proposed(plan, fleet(armed=False), NOW_S + 10.0) is None


@pytest.mark.parametrize("position_enu_m", [(8.0, 0.0, 5.0), (7.0, 0.9, 5.0), (8.0, 0.0, 0.1), (6.0, 0.0, 9.0)])
def test_the_gap_is_kept_and_reported_once_while_the_slot_may_not_be_free(position_enu_m: Vector3) -> None:
    plan = left()
    events: list[Notice] = []
    for second in range(9):
        proposal = checked(plan, fleet(position_enu_m=position_enu_m), NOW_S + GONE_FOR_S + second)
        assert proposal.change is None
        events += proposal.events
    assert codes_of(events) == [Code.GAP_KEPT]
    assert "it may still be in the air, " in events[0].text
    assert events[0].text.endswith("m beside the path of vehicle 2")
    assert proposed(plan, fleet(position_enu_m=position_enu_m, armed=False), NOW_S + 30.0) is not None


def test_the_slot_must_be_free_at_every_heading_when_the_formation_turns() -> None:
    turning = dataclasses.replace(LIMITS, slots_turn=True)
    beside = fleet(position_enu_m=(10.0, 3.0, 5.0))  # as far from the RFT as the path, on another side
    assert proposed(left(), beside, NOW_S + GONE_FOR_S) is not None
    assert proposed(left(limits=turning), beside, NOW_S + GONE_FOR_S) is None
    assert proposed(left(limits=turning), fleet(position_enu_m=(10.0, 5.1, 5.0)), NOW_S + GONE_FOR_S) is not None


def test_the_gap_of_a_silent_vehicle_is_kept() -> None:
    plan = left()
    plan.update(NOW_S + 1.0, [peer(2).packet])
    silent = {"phase": FlightPhase.FORMATION, "position_enu_m": (8.0, -50.0, 5.0)}
    proposal = checked(plan, fleet(**silent), NOW_S + 60.0)
    assert proposal.change is None
    assert codes_of(proposal.events) == [Code.GAP_KEPT]
    assert "no packets come from it" in proposal.events[0].text
    received_again = fleet(**silent | {"phase": FlightPhase.OBSERVE})
    assert proposed(plan, received_again, NOW_S + 61.0) is not None


def test_slots_of_other_absent_vehicles_count_as_occupied() -> None:
    """They may still fly there: only the vehicle that has certainly left is absent."""
    plan = GapFilling(1, LIMITS)
    plan.update(NOW_S - 1.0, [peer(2).packet, peer(3).packet, with_fields(peer(2).packet, vehicle_id=4)])
    plan.update(NOW_S, [peer(2).packet])
    four = SLOTS | {4: (-6.0, 0.0, 0.0)}
    change = plan.propose(NOW_S + 4.0, four, 4, fleet(armed=False), 50.0, lambda _s: AT).change
    assert change is not None
    assert change.absent == (3,)
    assert dict(change.slots_enu_m)[4] == four[4]


def test_the_change_is_cancelled_when_the_vehicle_is_back() -> None:
    change = proposed(left(), fleet(armed=False), NOW_S + GONE_FOR_S)
    assert change is not None
    mover, back = SlotPlan(2, SLOTS, LIMITS), SlotPlan(3, SLOTS, LIMITS)
    for slots in (mover, back):
        assert slots.judge(change, 50.0, (), []).carried_out()[0]
    slot = replace(peer(3).packet.slot, waiting=5)
    returning = replace(peer(3).packet, slot=slot, phase=FlightPhase.ENGAGE)
    text = "formation 5 does not begin: vehicle 3 is back in formation"
    for slots, peers in ((mover, [returning]), (back, [])):
        assert slots.update(0.0, change.begins_s, peers, in_formation=True) == (Notice(Code.FORMATION_CANCELLED, text),)
        assert slots.flown.formation == 0


def test_slots_of_absent_vehicles_are_still_checked() -> None:
    on_one_another = FormationChange(5, ((1, SLOTS[1]), (2, SLOTS[1]), (3, SLOTS[3])), 51.5, 10.0, absent=(2,))
    assert (
        SlotPlan(2, SLOTS, LIMITS).judge(on_one_another, 50.0, (), []).carried_out().notice.code is Code.SLOT_TOO_CLOSE
    )


def test_close_up_is_refused_when_edges_depend_on_one_vehicle() -> None:
    fleet = replace(load_scenario(SCENARIOS / "platoon.yaml").fleet, when_one_leaves="close_up")
    with pytest.raises(ConfigError) as caught:
        refuse(Path("fleet.yaml"), fleet_problems(fleet))
    assert "neighbours.edges: without vehicle 2, vehicle 3 is cut off from vehicle 1" in str(caught.value)
    good = load_scenario(SCENARIOS / "leaving.yaml")
    assert good.fleet.when_one_leaves == "close_up"
