"""A formation that was commanded to some alone: the leader passes it on, to those that fly, that stand and that start anew."""

from __future__ import annotations

from pathlib import Path

import pytest
from commanded_flight import Flight

from companion.ground.formations import change_to
from companion.ground.references import reference_change
from companion.types import CommandName, FlightPhase, FormationChange, Vector3

SCENARIO = Path(__file__).parents[2] / "config" / "scenarios" / "formations.yaml"
WIDER: dict[int, Vector3] = {i: (0.0, 8.75 - 2.5 * (i - 1), 0.0) for i in range(1, 9)}


def wider(flight: Flight) -> FormationChange:
    return change_to(WIDER, list(flight.newest.values()), 1.0)


@pytest.mark.parametrize("overrides", [(), ("links.peer_loss=0.1", "links.peer_delay_s=0.05")])
def test_what_the_leader_alone_was_told_all_fly(overrides: tuple[str, ...]) -> None:
    flight = Flight(SCENARIO, *overrides)
    flight.give(CommandName.FORMATION, 1, content=wider(flight))
    flight.go_on(0.8)
    assert {status.slot.waiting for status in flight.newest.values()} == {1}
    flight.go_on(14.0)
    assert {i: status.slot.position_enu_m for i, status in flight.newest.items()} == WIDER
    flight.packets.clear()
    flight.go_on(1.0)
    assert flight.packets
    assert not any(packet.change for packet in flight.packets)  # nobody lacks it any more


def test_what_the_leader_was_not_told_nobody_flies() -> None:
    flight = Flight(SCENARIO)
    flight.give(CommandName.FORMATION, *range(2, 9), content=wider(flight))
    flight.go_on(2.0)
    assert {status.slot.formation for status in flight.newest.values()} == {0}
    assert (5, "formation 1 does not begin: vehicle 1 does not have it") in flight.events


def test_no_formation_begins_that_leaves_the_fence_about_the_reference_that_is_to_come() -> None:
    """Each alone keeps to the fence: the reference with the slots of today, the slots about the reference of today."""
    fence = ("fleet.envelope.fence_min_enu_m=[-20, -12, 0]", "fleet.envelope.fence_max_enu_m=[20, 12, 10]")
    flight = Flight(SCENARIO.with_name("leaving.yaml"), *fence)
    point = {"kind": "point", "point_enu_m": [0.0, 8.0, 2.0]}
    flight.give(CommandName.REFERENCE, 1, 2, content=reference_change(point, list(flight.newest.values())))
    flight.go_on(0.3)
    aslant = {i: (-2.0 * (i - 1), 2.0 * (i - 1), 0.0) for i in range(1, 6)}
    change = change_to(aslant, list(flight.newest.values()), 1.0)
    replies = flight.answers(CommandName.FORMATION, content=change)
    for may_lead in (1, 2):
        reply = replies[may_lead]
        assert reply is not None
        assert reply.reason.startswith("formation: puts vehicle 4 at y = 14.0 m, outside the fence")
    flight.go_on(10.0)
    assert {(s.phase, s.slot.formation, s.flags) for s in flight.newest.values()} == {(FlightPhase.FORMATION, 0, ())}


def test_who_landed_meanwhile_and_whose_agent_started_anew_gets_it_on_the_ground() -> None:
    flight = Flight(SCENARIO)
    flight.give(CommandName.LAND, 8)
    flight.go_on(15.0)
    assert not flight.newest[8].armed
    change = wider(flight)
    flight.give(CommandName.FORMATION, *range(1, 8), content=change)
    flight.go_on(14.0)
    assert {status.slot.formation for status in flight.newest.values()} == {1}
    assert flight.newest[8].slot.position_enu_m == WIDER[8]
    assert (8, "passed on by vehicle 1: formation 1, which the others fly") in flight.events

    in_order = flight.lockstep._in_order
    flight.lockstep._in_order = in_order[:7]
    flight.go_on(1.0)
    flight.restart(8)
    flight.lockstep._in_order = in_order
    flight.newest.clear()
    flight.go_on(1.0)
    assert flight.newest[8].slot.position_enu_m == WIDER[8]


def test_a_leader_whose_agent_started_anew_in_the_air_forms_with_nobody_that_has_another_formation() -> None:
    """All are told to form at once, and over a slow network nobody hears in time that the others do."""
    flight = Flight(SCENARIO, "links.peer_delay_s=0.05")
    flight.give(CommandName.FORMATION, content=wider(flight))
    flight.go_on(14.0)
    flight.give(CommandName.HOLD)
    flight.go_on(2.0)
    in_order = flight.lockstep._in_order
    flight.lockstep._in_order = in_order[1:]
    flight.go_on(1.0)
    flight.restart(1)
    flight.lockstep._in_order, flight.lockstep._vehicles[1].session = in_order, 2
    flight.go_on(1.0)
    flight.give(CommandName.HOLD, 1)
    flight.go_on(1.0)
    assert {i: status.slot.formation for i, status in flight.newest.items()} == {1: 0} | dict.fromkeys(range(2, 9), 1)
    replies = flight.answers(CommandName.FORM)
    assert {i for i, reply in replies.items() if reply and reply.accepted} == {1}
    flight.go_on(1.0)
    assert {status.slot.formation for status in flight.newest.values()} == {0}
