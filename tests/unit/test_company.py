"""Who is heeded in formation: all that fly while it comes together, afterwards those that are in it."""

from __future__ import annotations

from cooperating_fleet import RING, TICK_S, Fleet

from companion.core.cooperation import FORMING_S
from companion.types import FlightPhase, Lead

FORMED = round(FORMING_S / TICK_S) + 5


def test_while_a_formation_comes_together_all_that_fly_are_heeded() -> None:
    fleet = Fleet(RING, may_lead=(1,))
    fleet.phases[3] = FlightPhase.HOLD
    assert fleet.fly(10)[2].neighbour_ids == (1, 3)


def test_who_leaves_is_nobody_s_neighbour_until_it_is_back() -> None:
    fleet = Fleet(RING, may_lead=(1,))
    assert fleet.fly(FORMED)[2].neighbour_ids == (1, 3)
    fleet.phases[3] = FlightPhase.HOLD
    around = fleet.fly(5)
    assert [around[i].neighbour_ids for i in (1, 2, 4)] == [(2, 4), (1,), (1,)]
    assert {packet.vehicle_id for packet in around[2].flying} == {1, 3, 4}  # it is still heard of
    assert around[3].neighbour_ids == (2, 4)  # and hears of its leader
    assert around[3].leader_word is not None
    fleet.phases[3] = FlightPhase.FORMATION
    assert fleet.fly(5)[2].neighbour_ids == (1, 3)


def test_a_leader_that_left_is_heeded_as_long_as_no_other_leads_in_formation() -> None:
    fleet = Fleet(RING, may_lead=(1, 3))
    fleet.fly(FORMED)
    fleet.phases[1] = FlightPhase.HOLD
    assert fleet.fly(5)[2].neighbour_ids == (1, 3)
    fleet.give(Lead((1, 3), 1))
    assert fleet.fly(5)[2].neighbour_ids == (3,)
