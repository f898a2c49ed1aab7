"""Whose formations are taken over, and which of several leaders counts."""

from __future__ import annotations

from msgspec.structs import replace
from test_joining import peer

from companion.core.passed_on import first_leader, passed_on
from companion.types import FlightPhase, FlownSlot, FormationChange, LeaderWord, PeerPacket, Role

CHANGE = FormationChange(1, ((1, (0.0, 0.0, 0.0)), (2, (-2.0, 0.0, 0.0)), (3, (-4.0, 0.0, 0.0))), 10.0, 5.0)


def leader(vehicle_id: int, epoch: int = 4, flies: int = 0) -> PeerPacket:
    word, slot = LeaderWord(vehicle_id, epoch, 1), FlownSlot((0.0, 0.0, 0.0), formation=flies, waiting=1)
    return replace(peer(vehicle_id).packet, role=Role.LEADER, prc=1, leader_word=word, slot=slot, change=CHANGE)


def test_those_that_lead_in_formation_pass_on_in_the_order_of_their_ids() -> None:
    assert passed_on([leader(2), leader(1)], (4, 0), stands=False) == [(1, CHANGE), (2, CHANGE)]
    assert passed_on([replace(leader(1), change=None)], (4, 0), stands=False) == []


def test_nobody_else_does() -> None:
    follower = replace(leader(1), role=Role.FOLLOWER)
    holds = replace(leader(1), phase=FlightPhase.HOLD)
    of_an_older_lead, wordless = leader(1, epoch=3), replace(leader(1), leader_word=None)
    assert passed_on([follower, holds, of_an_older_lead, wordless], (4, 0), stands=False) == []


def test_who_stands_is_told_what_is_flown_and_not_what_waits() -> None:
    assert passed_on([leader(1)], (4, 0), stands=True) == []
    assert passed_on([leader(1, flies=1)], (4, 0), stands=True) == [(1, CHANGE)]


def test_of_several_leaders_the_smallest_id_counts() -> None:
    assert first_leader([leader(3), leader(2)], None) == 2
    assert first_leader([leader(3), leader(2)], 1) == 1
    assert first_leader([replace(leader(2), phase=FlightPhase.HOLD)], 5) == 5
    assert first_leader([], None) is None
