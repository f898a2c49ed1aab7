"""Neighbours: vehicles that form or fly in formation, and a leader that the fleet waits with."""

from __future__ import annotations

from companion.core.consensus.stage import FORMING_S
from companion.types.commands import Lead
from companion.types.flight import FlightPhase
from stage_fleets import RING, TICK_S, CooperatingFleet

FORMED = round(FORMING_S / TICK_S) + 5


def test_vehicles_that_form_are_neighbours_while_a_formation_assembles() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1,))
    fleet.phases[3] = FlightPhase.ENGAGE
    assert fleet.fly(10)[2].neighbours.ids == (1, 3)


def test_vehicle_in_hold_is_no_neighbour_while_a_formation_assembles() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1,))
    fleet.phases[3] = FlightPhase.HOLD  # it was not commanded to form
    around = fleet.fly(10)
    assert [around[i].neighbours.ids for i in (1, 2, 4)] == [(2, 4), (1,), (1,)]


def test_vehicle_in_hold_passes_the_leader_beacon_on_while_a_formation_assembles() -> None:
    fleet = CooperatingFleet(((1, 2), (2, 3)), may_lead=(1,))
    fleet.phases[2] = FlightPhase.HOLD
    around = fleet.fly(25)
    assert around[3].neighbours.ids == ()
    assert around[3].lead.beacon is not None


def test_leaving_vehicle_is_no_neighbour_until_it_returns() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1,))
    assert fleet.fly(FORMED)[2].neighbours.ids == (1, 3)
    fleet.phases[3] = FlightPhase.HOLD
    around = fleet.fly(5)
    assert [around[i].neighbours.ids for i in (1, 2, 4)] == [(2, 4), (1,), (1,)]
    assert {packet.sender.vehicle_id for packet in around[2].peers.flying} == {
        1,
        3,
        4,
    }  # its packets are still received
    assert around[3].neighbours.ids == (2, 4)  # and it still has a leader beacon
    assert around[3].lead.beacon is not None
    fleet.phases[3] = FlightPhase.FORMATION
    assert fleet.fly(5)[2].neighbours.ids == (1, 3)


def test_leader_that_left_is_a_neighbour_until_another_leads() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 3))
    fleet.fly(FORMED)
    fleet.phases[1] = FlightPhase.HOLD
    assert fleet.fly(5)[2].neighbours.ids == (1, 3)
    fleet.give(Lead((1, 3), 1))
    assert fleet.fly(5)[2].neighbours.ids == (3,)
