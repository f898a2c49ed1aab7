"""The lead changes: newer epochs win, nobody takes it from what it hears, PrCs settle, the RFT's time goes on."""

from __future__ import annotations

from itertools import combinations

import pytest
from cooperating_fleet import CHAIN, RING, TICK_S, Fleet, leaders_in
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.formation import weighted
from companion.core.interaction import interaction_matrix, settled_prcs
from companion.core.leadership import Leadership
from companion.core.reference_clock import WAITED_S, ReferenceClock
from companion.types import (
    MAX_EPOCH,
    MAX_EPOCHS_AHEAD,
    ZERO3,
    FlightPhase,
    Lead,
    LeaderWord,
    ReceivedPeerPacket,
    Role,
)


def leadership(own_id: int = 1) -> Leadership:
    return Leadership(own_id, leaders=[1], may_lead=[1, 2])


# ---------------------------------------------------------------- one vehicle


def test_a_newer_epoch_gives_the_role_that_it_names() -> None:
    first, second, third = (leadership(i) for i in (1, 2, 3))
    for vehicle in (first, second, third):
        assert vehicle.obey(Lead((2,), 1))[0]
        assert vehicle.epoch == 1
    assert [v.role for v in (first, second, third)] == [Role.FOLLOWER, Role.LEADER, Role.FOLLOWER]
    assert first.events == ["leader -> follower in epoch 1 (told so)"]
    assert second.events == ["follower -> leader in epoch 1 (told so)"]
    assert third.events == []


@pytest.mark.parametrize(
    ("lead", "reason"),
    [
        (Lead((3,), 6), "lead: vehicle 3 is not one that may lead; expected some of 1, 2"),
        (Lead((1, 99), 6), "lead: vehicle 99 is not one that may lead; expected some of 1, 2"),
        (Lead((), 6), "lead: names nobody; expected some of 1, 2"),
        (Lead((1,), 5), "lead: epoch 5 is not newer than 5"),
        (Lead((1,), 4), "lead: epoch 4 is not newer than 5"),
        (Lead((1,), 2**31), f"lead: epoch {2**31} is too large; expected 6"),
        (Lead((1,), 6 + MAX_EPOCHS_AHEAD), "lead: epoch 1006 is too large; expected 6"),
    ],
)
def test_what_is_refused_changes_nothing(lead: Lead, reason: str) -> None:
    vehicle = leadership(2)
    vehicle.obey(Lead((2,), 5))
    assert vehicle.obey(lead) == (False, reason)
    assert (vehicle.role, vehicle.epoch) == (Role.LEADER, 5)


def test_the_file_s_epoch_cannot_be_commanded() -> None:
    assert leadership(2).obey(Lead((2,), 0)) == (False, "lead: epoch 0 is not newer than 0")


def test_the_same_command_again_is_accepted_and_changes_nothing() -> None:
    vehicle = leadership(2)
    vehicle.obey(Lead((2,), 1))
    vehicle.events.clear()
    assert vehicle.obey(Lead((2,), 1)) == (True, "already leader in epoch 1")
    assert vehicle.events == []


def test_who_missed_the_command_follows_once_it_hears_of_the_epoch_and_can_be_told_after() -> None:
    missed = leadership(1)
    missed.hear([None, LeaderWord(2, 1, 5), LeaderWord(2, 0, 9)])
    assert (missed.role, missed.epoch) == (Role.FOLLOWER, 1)
    named = leadership(2)
    named.hear([LeaderWord(1, 1, 5)])
    assert named.role is Role.FOLLOWER
    assert named.obey(Lead((1, 2), 1))[0]  # repeated to the one that did not answer
    assert named.role is Role.LEADER


@given(st.lists(st.integers(0, 5)))
def test_nothing_that_is_heard_makes_a_leader(epochs: list[int]) -> None:
    vehicle = leadership(2)
    vehicle.hear([LeaderWord(2, epoch, 1) for epoch in epochs])
    assert vehicle.role is Role.FOLLOWER
    assert vehicle.epoch == max(epochs, default=0)


def test_who_missed_many_changes_can_be_told_at_once_and_who_missed_more_in_steps() -> None:
    vehicle = leadership(2)
    assert vehicle.obey(Lead((1,), MAX_EPOCHS_AHEAD))[0]
    assert not vehicle.obey(Lead((2,), 2 * MAX_EPOCHS_AHEAD + 1))[0]
    assert vehicle.obey(Lead((1,), 2 * MAX_EPOCHS_AHEAD))[0]
    assert vehicle.obey(Lead((2,), 2 * MAX_EPOCHS_AHEAD + 1))[0]
    assert (vehicle.role, vehicle.epoch) == (Role.LEADER, 2 * MAX_EPOCHS_AHEAD + 1)


# ---------------------------------------------------------------- the RFT's time


def test_a_follower_counts_with_its_leader_and_on_when_it_hears_nobody() -> None:
    clock = ReferenceClock()
    assert clock.update(100.0, True, LeaderWord(1, 0, 1, 30.0), 0.0) == pytest.approx(30.0 + WAITED_S)
    assert clock.update(100.2, True, LeaderWord(1, 0, 1, 30.0), 0.2) == pytest.approx(30.2 + WAITED_S)
    assert clock.update(101.0, True, None, 9.0) == pytest.approx(31.0 + WAITED_S)
    assert clock.lead(101.5, True, None, 9.0) == pytest.approx(31.5 + WAITED_S)


def test_time_stands_until_a_leader_is_in_formation() -> None:
    clock = ReferenceClock()
    for now_s in (100.0, 107.0):
        assert clock.lead(now_s, False, None, 9.0) == 0.0
    assert clock.lead(107.02, True, None, 9.0) == pytest.approx(0.02)
    follower = ReferenceClock()
    assert follower.update(200.0, True, LeaderWord(1, 0, 1, 0.0), 0.3) == 0.0
    assert follower.update(201.0, False, None, 9.0) == 0.0


def test_a_second_leader_enters_formation_where_the_first_one_is() -> None:
    clock = ReferenceClock()
    assert clock.lead(100.0, False, LeaderWord(2, 0, 1, 12.0), 0.0) == pytest.approx(12.0 + WAITED_S)
    assert clock.lead(100.1, True, None, 9.0) == pytest.approx(12.1 + WAITED_S)


def test_of_two_leaders_in_formation_the_one_that_comes_after_counts_as_the_first_where_they_are_far_apart() -> None:
    clock = ReferenceClock()
    clock.lead(100.0, False, LeaderWord(1, 0, 1, 60.0), 0.0)
    for told_s in (0.0, 59.9, 60.4):  # it stands, or differs by what networks do: nothing is put right
        assert clock.lead(100.1, True, LeaderWord(1, 0, 2, told_s), 0.0) == pytest.approx(60.1 + WAITED_S)
    assert clock.lead(100.2, True, LeaderWord(1, 0, 3, 0.5), 0.1) == pytest.approx(0.6 + WAITED_S)
    assert clock.lead(100.3, True, None, 9.0) == pytest.approx(0.7 + WAITED_S)


@pytest.mark.parametrize("in_formation", [True, False])
def test_a_follower_that_has_counted_stands_where_its_leader_s_time_stops(in_formation: bool) -> None:
    clock = ReferenceClock()
    stopped_s = clock.update(100.0, in_formation, LeaderWord(1, 0, 1, 60.0), 0.0)
    for now_s in (100.02, 101.0, 107.0):
        assert clock.update(now_s, in_formation, LeaderWord(1, 0, int(now_s * 1000), 0.0), 0.0) == stopped_s
    assert clock.update(108.0, in_formation, None, 9.0) == stopped_s  # nor does a silence make it run
    assert clock.lead(108.02, True, None, 9.0) == pytest.approx(stopped_s + 0.02)


def test_a_leader_that_leaves_formation_and_comes_back_goes_on_where_it_stopped() -> None:
    clock = ReferenceClock()
    clock.lead(100.0, False, None, 9.0)
    stopped_s = clock.lead(160.0, True, None, 9.0)
    assert clock.lead(170.0, False, None, 9.0) == clock.lead(180.0, False, None, 9.0) == stopped_s
    assert clock.lead(180.02, True, None, 9.0) == pytest.approx(stopped_s + 0.02)
    clock.begin_anew()  # it has landed
    assert clock.lead(300.0, False, None, 9.0) == 0.0


# ---------------------------------------------------------------- a fleet, tick by tick


def graph_of(edges: tuple[tuple[int, int], ...]) -> dict[int, set[int]]:
    ids = {i for edge in edges for i in edge}
    return {i: {a + b - i for a, b in edges if i in (a, b)} for i in ids}


@pytest.mark.parametrize(("edges", "diameter"), [(RING, 2), (CHAIN, 5)])
@pytest.mark.parametrize("leaders", [(2,), (4,), (1, 4), (3,)])
def test_prcs_settle_within_the_diameter_and_one_tick(
    edges: tuple[tuple[int, int], ...], diameter: int, leaders: tuple[int, ...]
) -> None:
    fleet = Fleet(edges, may_lead=(1, 2, 3, 4))
    fleet.fly(20)
    fleet.give(Lead(leaders, 1))
    settled = settled_prcs(graph_of(edges), leaders)
    before = fleet.tick()
    assert {i: what.prc for i, what in before.items()} != settled
    after = fleet.fly(diameter)
    assert {i: what.prc for i, what in after.items()} == settled
    words = {what.leader_word.epoch for what in after.values() if what.leader_word}
    assert words == {1}


def test_the_ring_has_the_paper_s_matrices_before_and_after() -> None:
    fleet = Fleet(RING, may_lead=(1, 2))
    before = fleet.fly(20)
    fleet.give(Lead((2,), 1))
    after = fleet.fly(3)
    for around, leader in ((before, 1), (after, 2)):
        assert {i: what.prc for i, what in around.items()} == settled_prcs(graph_of(RING), [leader])
        graph = {i: what.neighbour_ids for i, what in around.items()}
        assert interaction_matrix(graph, [leader], weighted()).tolist() == PAPER_MATRICES[leader]


PAPER_MATRICES = {
    1: [[2.0, -0.5, 0.0, -0.5], [-0.75, 1.0, -0.25, 0.0], [0.0, -0.5, 1.0, -0.5], [-0.75, 0.0, -0.25, 1.0]],
    2: [[1.0, -0.75, 0.0, -0.25], [-0.5, 2.0, -0.5, 0.0], [0.0, -0.75, 1.0, -0.25], [-0.5, 0.0, -0.5, 1.0]],
}


@pytest.mark.parametrize("missed", [missed for n in (0, 1, 2) for missed in combinations((1, 3, 4), n)])
def test_two_epochs_never_both_command_for_longer_than_one_packet(missed: tuple[int, ...]) -> None:
    fleet = Fleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.give(Lead((2,), 1), *(set(fleet.ids) - set(missed)))
    assert leaders_in(fleet.tick()) == ([1, 2] if 1 in missed else [2])
    for _ in range(50):
        around = fleet.tick()
        assert leaders_in(around) == [2]
        assert all(what.leader_word is not None for what in around.values())  # nobody ever thought the leader lost
    assert {what.epoch for what in around.values()} == {1}


def test_an_old_leader_that_hears_nobody_is_heeded_by_nobody() -> None:
    fleet = Fleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.deaf = {1}
    fleet.give(Lead((2,), 1), 2, 3, 4)
    around = fleet.fly(20)
    assert leaders_in(around) == [1, 2]
    # 4 counts its hops to 2 by way of 3: 1 beside it claims PrC 1, but in an epoch that is over.
    assert {i: around[i].prc for i in (2, 3, 4)} == {2: 1, 3: 2, 4: 3}
    assert all(around[i].leader_word.leader_id == 2 for i in (3, 4))  # type: ignore[union-attr]
    fleet.deaf = set()
    assert leaders_in(fleet.tick()) == [2]


@pytest.mark.parametrize("restarted", [1, 2])
def test_a_restarted_agent_takes_no_lead_back(restarted: int) -> None:
    """1 leads by the file, 2 led in epoch 1 when it was restarted: in the new epoch nobody leads until somebody is told."""
    fleet = Fleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.give(Lead((2,), 1))
    fleet.fly(20)
    fleet.vehicles[restarted], fleet.sessions[restarted] = fleet.started(restarted), 2
    fleet.phases[restarted] = FlightPhase.OBSERVE
    del fleet.packets[restarted]
    for i, vehicle in fleet.vehicles.items():  # it was away for long enough that its peers believe it anew
        if i != restarted:
            vehicle.peers = fleet.started(i).peers
    for _ in range(100):
        around = fleet.tick()
        assert around[restarted].role is Role.FOLLOWER
        assert around[restarted].epoch == 1
    expected = [2] if restarted == 1 else []
    assert leaders_in(around) == expected
    assert (around[3].leader_word is not None) is bool(expected)


def test_the_time_into_the_rft_is_passed_on_and_goes_on_at_a_change() -> None:
    fleet = Fleet(RING, may_lead=(1, 2))
    around = fleet.fly(500)
    leader_s = around[1].reference_s
    assert all(abs(what.reference_s - leader_s) < 2 * (TICK_S - WAITED_S) + 1e-6 for what in around.values())
    for epoch in range(1, 41):
        fleet.give(Lead((1 + epoch % 2,), epoch))
        before_s = around[1 + epoch % 2].reference_s
        around = fleet.tick()
        assert around[1 + epoch % 2].reference_s - before_s == pytest.approx(TICK_S)
        around = fleet.fly(9)


@pytest.mark.parametrize("edges", [RING, CHAIN])
def test_the_rft_goes_on_after_its_leader_stood_in_hold(edges: tuple[tuple[int, int], ...]) -> None:
    fleet = Fleet(edges, may_lead=(1, 2))
    stopped_s = fleet.fly(500)[1].reference_s
    fleet.phases[1] = FlightPhase.HOLD
    around = fleet.fly(500)
    assert all(what.reference_s == pytest.approx(stopped_s, abs=0.1) for what in around.values())
    assert all(what.leader_word is not None and what.leader_word.reference_s == 0.0 for what in around.values())
    stood_s = around[2].reference_s
    fleet.give(Lead((2,), 1))
    assert fleet.tick()[2].reference_s == pytest.approx(stood_s + TICK_S)
    goes_on_s = fleet.fly(100)[2].reference_s
    assert goes_on_s == pytest.approx(stood_s + 101 * TICK_S)
    fleet.give(Lead((1,), 2))  # back to the one in hold: there it is, and there it stands
    assert fleet.fly(100)[1].reference_s == pytest.approx(goes_on_s, abs=0.1)
    fleet.phases[1] = FlightPhase.FORMATION
    around = fleet.fly(10)
    assert all(what.reference_s == pytest.approx(goes_on_s + 10 * TICK_S, abs=0.1) for what in around.values())


@pytest.mark.parametrize("holds", [1, 3])
def test_of_two_leaders_one_in_hold_does_not_stop_the_other_s_time(holds: int) -> None:
    fleet = Fleet(RING, may_lead=(1, 3))
    fleet.give(Lead((1, 3), 1))
    leads = 4 - holds
    fleet.phases[holds] = FlightPhase.HOLD
    began_s = fleet.fly(20)[leads].reference_s
    for tick in range(1, 200):
        around = fleet.tick()
        assert around[leads].reference_s == pytest.approx(began_s + tick * TICK_S)
        # also of the one that holds: it enters formation where the other is
        assert all(abs(what.reference_s - around[leads].reference_s) < 0.03 for what in around.values())


def test_one_word_of_a_huge_epoch_ends_nothing() -> None:
    fleet = Fleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    honest = fleet.packets[4]
    lie = replace(
        honest, sequence=honest.sequence + 1, sent_s=fleet.now_s, leader_word=LeaderWord(1, MAX_EPOCH, 1, 1.0)
    )
    around = fleet.vehicles[1].update(fleet.now_s, ZERO3, [ReceivedPeerPacket(fleet.now_s, lie)], True, True)
    assert (around.role, around.epoch) == (Role.LEADER, 0)
    assert dict(fleet.vehicles[1].peers.rejected) == {"peer 4: its leader's epoch is too far ahead": 1}
    fleet.vehicles[1].peers.rejected.clear()
    fleet.give(Lead((2,), 1))
    assert leaders_in(fleet.fly(5)) == [2]


def test_a_restarted_agent_catches_up_with_as_many_changes_as_are_believed() -> None:
    fleet = Fleet(RING, may_lead=(1, 2))
    fleet.give(Lead((2,), MAX_EPOCHS_AHEAD))
    fleet.vehicles[1] = fleet.started(1)
    around = fleet.fly(5)
    assert leaders_in(around) == [2]
    assert {what.epoch for what in around.values()} == {MAX_EPOCHS_AHEAD}
