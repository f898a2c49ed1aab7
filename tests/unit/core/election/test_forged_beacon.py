"""One beacon of a term without a leader: every vehicle returns to the leader that is alive, and stays in formation."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from common import with_fields
from companion.types.flight import FlightPhase, Role
from companion.types.formation import LeaderBeacon
from stage_fleets import CHAIN, RING, TICK_S, CooperatingFleet, leaders_in

TEN_HOPS = tuple((i, i + 1) for i in range(1, 11))
GRAPHS = {"ring": RING, "chain of 6": CHAIN, "10 hops": TEN_HOPS}


def assert_recovers(
    fleet: CooperatingFleet, sender: int, leader: int, to: Collection[int], epoch: int = 5, claim: int = 0
) -> None:
    """One packet under the id of `sender`, with a beacon of `leader`, reaches `to`."""
    honest = fleet.packets[sender]
    beacon = LeaderBeacon(leader, epoch, int(fleet.now_s * 1000) + 20, honest.leader.beacon.reference_s, claim)  # type: ignore[union-attr]
    leads = {"role": Role.LEADER, "prc": 1} if leader == sender else {"role": Role.FOLLOWER, "prc": 3}
    forged = with_fields(honest, beacon=beacon, **leads)
    fleet.forged = {i: forged for i in to if i != sender}
    around = fleet.tick()
    assert all(around[i].lead.term[0] == epoch for i in to if i != sender)
    for tick in range(round(2.0 / TICK_S)):
        around = fleet.tick()
        assert set(leaders_in(around)) <= {1}
        assert set(fleet.phases.values()) == {FlightPhase.FORMATION}
        if tick * TICK_S >= 1.0:
            assert leaders_in(around) == [1]
            assert all(what.lead.term[0] == 0 and what.lead.beacon is not None for what in around.values())


@pytest.mark.parametrize("successors", [(), (2, 3)])
@pytest.mark.parametrize(
    "max_age_s", [0.25, *(pytest.param(age_s, marks=pytest.mark.long) for age_s in (0.3, 0.5)), 1.0]
)
@pytest.mark.parametrize("graph", GRAPHS)
def test_one_beacon_deposes_no_leader_for_long(graph: str, max_age_s: float, successors: tuple[int, ...]) -> None:
    fleet = CooperatingFleet(GRAPHS[graph], (1, 2, 3), successors, max_age_s)
    fleet.fly(50)
    last = fleet.ids[-1]
    attacks = ((1, 1, fleet.ids), (2, 2, [3]), (4, 1, fleet.ids), (last - 1, 2, [last]))
    for epoch, (sender, leader, to) in enumerate(attacks, start=5):
        assert_recovers(fleet, sender, leader, to, epoch)


@pytest.mark.parametrize("successors", [(), (2, 3)])
@pytest.mark.parametrize("max_age_s", [0.25, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("at", [1, 11])
def test_one_beacon_at_an_end_of_ten_hops_of_short_range(
    at: int, max_age_s: float, successors: tuple[int, ...]
) -> None:
    """Each vehicle receives its neighbours only: all enter and leave the term one after another."""
    fleet = CooperatingFleet(TEN_HOPS, (1, 2, 3), successors, max_age_s)
    fleet.receives = lambda receiver, sender: abs(receiver - sender) == 1
    fleet.fly(50)
    assert_recovers(fleet, 10 if at == 11 else 2, 2, [at])


def test_one_claimed_beacon_of_the_next_term_deposes_no_leader_for_long() -> None:
    fleet = CooperatingFleet(CHAIN, (1, 2, 3), (2, 3))
    fleet.fly(50)
    assert_recovers(fleet, 2, 2, fleet.ids, epoch=1, claim=1)
    fleet.dead = {1}
    assert leaders_in(fleet.fly(60)) == [2]  # the same term, and now with a leader
    assert {what.lead.term for what in fleet.tick().values()} == {(1, -1)}
