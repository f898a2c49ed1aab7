"""A formation commanded to some vehicles only: the leader passes it on to flying, landed and restarted vehicles."""

from __future__ import annotations

import pytest

from common import ROOT
from companion.ground.changes import change_to, reference_change
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.formation import FormationChange
from companion.types.notices import Code
from companion.types.values import Vector3
from lockstep_fleet import CommandedFlight

SCENARIO = ROOT / "config" / "scenarios" / "formations.yaml"
WIDER: dict[int, Vector3] = {i: (0.0, 8.75 - 2.5 * (i - 1), 0.0) for i in range(1, 9)}


def wider(flight: CommandedFlight) -> FormationChange:
    return change_to(WIDER, list(flight.newest.values()), 1.0)


@pytest.mark.parametrize(
    "overrides", [pytest.param((), marks=pytest.mark.long), ("links.peer_loss=0.1", "links.peer_delay_s=0.05")]
)
def test_all_vehicles_fly_a_formation_commanded_to_the_leader_only(overrides: tuple[str, ...]) -> None:
    flight = CommandedFlight(SCENARIO, *overrides)
    flight.give(CommandName.FORMATION, 1, content=wider(flight))
    flight.go_on(0.8)
    assert {status.formation.slot.waiting for status in flight.newest.values()} == {1}
    flight.go_on(14.0)
    assert {i: status.formation.slot.position_enu_m for i, status in flight.newest.items()} == WIDER
    flight.packets.clear()
    flight.go_on(1.0)
    assert flight.packets
    assert not any(packet.change for packet in flight.packets)  # no vehicle lacks it any more


def test_a_formation_that_the_leader_lacks_does_not_begin() -> None:
    flight = CommandedFlight(SCENARIO)
    flight.give(CommandName.FORMATION, *range(2, 9), content=wider(flight))
    flight.go_on(2.0)
    assert {status.formation.slot.formation for status in flight.newest.values()} == {0}
    assert (5, "formation 1 does not begin: vehicle 1 does not have it") in flight.events


def test_a_formation_outside_the_fence_with_the_next_reference_is_refused() -> None:
    """Both are inside the fence separately: the reference with the present slots, the slots with the present reference."""
    fence = ("fleet.envelope.fence_min_enu_m=[-20, -13, 0]", "fleet.envelope.fence_max_enu_m=[20, 13, 10]")
    flight = CommandedFlight(SCENARIO.with_name("leaving.yaml"), *fence)
    point = {"kind": "point", "point_enu_m": [0.0, 8.0, 2.0]}
    flight.give(CommandName.REFERENCE, 1, 2, content=reference_change(point, list(flight.newest.values())))
    flight.go_on(0.3)
    aslant = {i: (-2.0 * (i - 1), 2.0 * (i - 1), 0.0) for i in range(1, 6)}
    change = change_to(aslant, list(flight.newest.values()), 1.0)
    replies = flight.answers(CommandName.FORMATION, content=change)
    for may_lead in (1, 2):
        reply = replies[may_lead]
        assert reply is not None
        assert reply.code is Code.SLOT_OUTSIDE_FENCE
        assert "puts vehicle 4 at y = 14.0 m" in reply.reason
    flight.go_on(10.0)
    assert {(s.phase, s.formation.slot.formation, s.safety.flags) for s in flight.newest.values()} == {
        (FlightPhase.FORMATION, 0, ())
    }


def test_a_landed_and_a_restarted_vehicle_get_the_formation_on_the_ground() -> None:
    flight = CommandedFlight(SCENARIO)
    flight.give(CommandName.LAND, 8)
    flight.go_on(15.0)
    assert not flight.newest[8].autopilot.armed
    change = wider(flight)
    flight.give(CommandName.FORMATION, *range(1, 8), content=change)
    flight.go_on(14.0)
    assert {status.formation.slot.formation for status in flight.newest.values()} == {1}
    assert flight.newest[8].formation.slot.position_enu_m == WIDER[8]
    assert (8, "passed on by vehicle 1: formation 1, which the others fly") in flight.events

    in_order = flight.lockstep.in_order
    flight.lockstep.in_order = in_order[:7]
    flight.go_on(1.0)
    flight.restart(8)
    flight.lockstep.in_order = in_order
    flight.newest.clear()
    flight.go_on(1.0)
    assert flight.newest[8].formation.slot.position_enu_m == WIDER[8]


def test_a_restarted_leader_does_not_form_with_vehicles_of_another_formation() -> None:
    """All get the command form at once; over a slow network they do not know in time that the others form too."""
    flight = CommandedFlight(SCENARIO, "links.peer_delay_s=0.05")
    flight.give(CommandName.FORMATION, content=wider(flight))
    flight.go_on(14.0)
    flight.give(CommandName.HOLD)
    flight.go_on(2.0)
    in_order = flight.lockstep.in_order
    flight.lockstep.in_order = in_order[1:]
    flight.go_on(1.0)
    flight.restart(1)
    flight.lockstep.in_order, flight.lockstep.vehicles[1].session = in_order, 2
    flight.go_on(1.0)
    flight.give(CommandName.HOLD, 1)
    flight.go_on(1.0)
    assert {i: status.formation.slot.formation for i, status in flight.newest.items()} == {1: 0} | dict.fromkeys(
        range(2, 9), 1
    )
    replies = flight.answers(CommandName.FORM)
    assert {i for i, reply in replies.items() if reply and reply.accepted} == {1}
    flight.go_on(1.0)
    assert {status.formation.slot.formation for status in flight.newest.values()} == {0}
