"""Formation changes that leaders pass on, and which of several leaders comes first."""

from __future__ import annotations

from msgspec.structs import replace

from common import peer, with_fields
from companion.core.formation.changes import first_leader, passed_on
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, LeaderBeacon
from companion.types.peers import PeerPacket

CHANGE = FormationChange(1, ((1, (0.0, 0.0, 0.0)), (2, (-2.0, 0.0, 0.0)), (3, (-4.0, 0.0, 0.0))), 10.0, 5.0)


def leader(vehicle_id: int, epoch: int = 4, flies: int = 0) -> PeerPacket:
    beacon, slot = LeaderBeacon(vehicle_id, epoch, 1), FlownSlot((0.0, 0.0, 0.0), formation=flies, waiting=1)
    return with_fields(peer(vehicle_id).packet, role=Role.LEADER, prc=1, beacon=beacon, slot=slot, change=CHANGE)


def test_changes_of_leaders_are_in_order_of_their_ids() -> None:
    assert passed_on([leader(2), leader(1)], (4, 0), on_ground=False) == [(1, CHANGE), (2, CHANGE)]
    assert passed_on([replace(leader(1), change=None)], (4, 0), on_ground=False) == []


def test_only_leaders_of_this_term_in_formation_count() -> None:
    follower = replace(leader(1), role=Role.FOLLOWER)
    holds = replace(leader(1), phase=FlightPhase.HOLD)
    older_term, without_beacon = leader(1, epoch=3), with_fields(leader(1), beacon=None)
    assert passed_on([follower, holds, older_term, without_beacon], (4, 0), on_ground=False) == []


def test_a_vehicle_on_the_ground_adopts_only_the_formation_flown() -> None:
    assert passed_on([leader(1)], (4, 0), on_ground=True) == []
    assert passed_on([leader(1, flies=1)], (4, 0), on_ground=True) == [(1, CHANGE)]


def test_the_smallest_leader_id_comes_first() -> None:
    assert first_leader([leader(3), leader(2)], None) == 2
    assert first_leader([leader(3), leader(2)], 1) == 1
    assert first_leader([replace(leader(2), phase=FlightPhase.HOLD)], 5) == 5
    assert first_leader([], None) is None
