"""A leader is heard no more: formation goes on for a while, one successor leads, and two never do for longer than a packet."""

from __future__ import annotations

from itertools import permutations
from random import Random

import pytest
from cooperating_fleet import CHAIN, RING, TICK_S, WORD_MAX_AGE_S, Fleet, leaders_in
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.cooperation import Neighbourhood
from companion.core.interaction import settled_prcs
from companion.core.leader_word import LeaderWatch
from companion.core.leadership import Leadership
from companion.core.succession import TURN_S, HeldForWantOfALeader, Succession
from companion.types import MAX_EPOCH, FlightPhase, HealthFlag, Lead, LeaderWord, Role

ALL_6 = tuple(range(1, 7))
STAR = ((1, 2), (1, 3), (1, 4))


def fleet_in_flight(
    edges: tuple[tuple[int, int], ...] = RING, successors: tuple[int, ...] = (2, 3), may_lead: tuple[int, ...] = ALL_6
) -> Fleet:
    fleet = Fleet(edges, may_lead, successors)
    fleet.fly(50)
    return fleet


def seconds_until_led(fleet: Fleet, by: int) -> float:
    """Until all that are left hear this leader."""
    began_s = fleet.now_s
    while True:
        around = fleet.tick()
        if all(what.leader_word is not None and what.leader_word.leader_id == by for what in around.values()):
            return fleet.now_s - began_s
        assert fleet.now_s < began_s + 5.0


def flags(around: dict[int, Neighbourhood]) -> set[HealthFlag | None]:
    return {what.leaderless for what in around.values()}


# ---------------------------------------------------------------- the rule


@pytest.mark.parametrize(("edges", "diameter_left"), [(RING, 2), (CHAIN, 4)])
def test_the_first_successor_leads_and_prcs_settle(edges: tuple[tuple[int, int], ...], diameter_left: int) -> None:
    fleet = fleet_in_flight(edges)
    fleet.dead, died_s = {1}, fleet.now_s
    while not leaders_in(around := fleet.tick()):
        missed = fleet.now_s - died_s > WORD_MAX_AGE_S + len(fleet.ids) * TICK_S
        assert flags(around) <= ({HealthFlag.LEADER_AWAITED} if missed else {None, HealthFlag.LEADER_AWAITED})
        assert set(fleet.phases.values()) == {FlightPhase.FORMATION}
    assert leaders_in(around) == [2]
    assert fleet.now_s - died_s < WORD_MAX_AGE_S + TURN_S + 3 * TICK_S
    around = fleet.fly(diameter_left)
    left = {i: {a + b - i for a, b in edges if i in (a, b)} - {1} for i in fleet.ids if i != 1}
    assert {i: what.prc for i, what in around.items()} == settled_prcs(left, [2])
    assert flags(around) == {None}


def test_each_that_is_dead_too_costs_one_turn() -> None:
    for dead, by in (({1}, 2), ({1, 2}, 3), ({1, 2, 3}, 4)):
        fleet = fleet_in_flight(tuple((i, i + 1) for i in range(1, 6)), successors=(2, 3, 4))
        fleet.dead = dead
        took_s = seconds_until_led(fleet, by)
        turns_s = WORD_MAX_AGE_S + (by - 1) * TURN_S
        assert turns_s < took_s < turns_s + 7 * TICK_S
        assert took_s < 1.5


def test_the_time_into_the_rft_goes_on_as_if_nothing_had_happened() -> None:
    fleet = fleet_in_flight()
    before_s, died_s = fleet.tick()[2].reference_s, fleet.now_s
    fleet.dead = {1}
    seconds_until_led(fleet, by=2)
    assert fleet.tick()[2].reference_s - before_s == pytest.approx(fleet.now_s - died_s)


def test_without_successors_all_wait_for_one_turn_and_hold() -> None:
    fleet = fleet_in_flight(successors=())
    fleet.dead = {1}
    around = fleet.fly(round((WORD_MAX_AGE_S + TURN_S) / TICK_S) - 1)
    assert flags(around) == {HealthFlag.LEADER_AWAITED}
    around = fleet.fly(5)
    assert flags(around) == {HealthFlag.LEADER_LOST}
    assert leaders_in(fleet.fly(200)) == []


def test_where_no_successor_is_left_all_hold_two_turns_after_the_last_one_s() -> None:
    fleet = fleet_in_flight()
    fleet.dead = {1, 2}
    fleet.phases[3] = FlightPhase.LAND
    assert leaders_in(fleet.fly(round((WORD_MAX_AGE_S + 4 * TURN_S) / TICK_S) + 5)) == []
    assert fleet.phases[4] is FlightPhase.HOLD


def test_a_word_that_comes_back_before_its_turn_is_over_changes_nothing() -> None:
    fleet = fleet_in_flight()
    for lost_s in (0.1, 0.3, 0.5):
        fleet.hears = lambda _receiver, sender: sender != 1
        for _ in range(round(lost_s / TICK_S)):
            assert leaders_in(fleet.tick()) == [1]
        fleet.hears = lambda _receiver, _sender: True
        assert flags(fleet.fly(3)) == {None}
        assert {what.epoch for what in fleet.fly(50).values()} == {0}


def test_the_old_leader_comes_back_as_a_follower() -> None:
    fleet = fleet_in_flight()
    fleet.dead = {1}
    fleet.packets.pop(1)
    fleet.fly(100)
    fleet.dead, fleet.vehicles[1], fleet.sessions[1] = set(), fleet.started(1), 2
    fleet.phases[1] = FlightPhase.OBSERVE
    fleet.tick()
    for _ in range(100):
        assert leaders_in(fleet.tick()) == [2]


def test_a_successor_that_dies_is_followed_by_the_next_in_a_newer_epoch() -> None:
    fleet = fleet_in_flight(tuple((i, i + 1) for i in range(1, 6)), successors=(2, 3))
    for dead, by, epoch in (({1}, 2, 1), ({1, 2}, 3, 2)):
        fleet.dead = dead
        seconds_until_led(fleet, by)
        assert {what.epoch for what in fleet.tick().values()} == {epoch}


@pytest.mark.parametrize("phase", [FlightPhase.HOLD, FlightPhase.RELEASE, FlightPhase.LAND, FlightPhase.OBSERVE])
def test_who_does_not_fly_in_formation_does_not_take_the_lead(phase: FlightPhase) -> None:
    fleet = fleet_in_flight()
    fleet.dead, fleet.phases[2] = {1}, phase
    led = [leader for _ in range(150) for leader in leaders_in(fleet.tick())]
    assert 2 not in led
    assert 3 in led


def test_who_hears_nobody_leads_nobody() -> None:
    """Its own radio may be what is broken; the others are led on without it."""
    fleet = fleet_in_flight(successors=(2,))
    fleet.hears = lambda receiver, sender: 2 not in (receiver, sender)
    around = fleet.fly(100)
    assert leaders_in(around) == [1]
    assert fleet.phases[2] is FlightPhase.HOLD
    assert {fleet.phases[i] for i in (1, 3, 4)} == {FlightPhase.FORMATION}


def test_a_leader_that_is_heard_but_reached_by_no_neighbour_is_not_deposed() -> None:
    """Counting PrC up to n is no path to a leader: who is cut off holds, and the rest flies on."""
    fleet = fleet_in_flight(CHAIN, successors=(4, 5))
    fleet.dead = {3}
    around = fleet.fly(100)
    assert leaders_in(around) == [1]
    assert {what.epoch for what in around.values()} == {0}
    assert [fleet.phases[i] for i in (1, 2, 4, 5, 6)] == [FlightPhase.FORMATION] * 2 + [FlightPhase.HOLD] * 3
    assert {around[i].leader_word for i in (4, 5, 6)} == {None}


def test_who_does_not_know_how_far_into_the_rft_the_fleet_is_takes_no_lead() -> None:
    fleet = Fleet(RING, ALL_6, (2, 3))
    fleet.phases[1] = FlightPhase.HOLD  # it has not begun to fly the RFT
    fleet.fly(20)
    fleet.dead = {1}
    led = [leader for _ in range(100) for leader in leaders_in(fleet.tick())]
    assert led == []
    assert {fleet.phases[i] for i in (2, 3, 4)} == {FlightPhase.HOLD}


def test_a_star_without_its_middle_has_nobody_to_lead() -> None:
    fleet = fleet_in_flight(STAR, successors=(2, 3))
    fleet.dead = {1}
    around = fleet.fly(
        round((WORD_MAX_AGE_S + TURN_S) / TICK_S) + 3
    )  # one turn: who has no neighbours does not wait for more
    assert leaders_in(around) == []
    assert {fleet.phases[i] for i in (2, 3, 4)} == {FlightPhase.HOLD}


def test_who_hears_of_a_new_lead_waits_anew_for_its_word() -> None:
    succession = Succession(4, (2,))
    assert succession.awaits(10.0, (0, 0), led=True, in_company=True)
    assert succession.awaits(10.8, (1, -1), led=False, in_company=True)
    assert succession.awaits(11.6, (1, -1), led=False, in_company=True)
    assert not succession.awaits(11.8, (1, -1), led=False, in_company=True)


@given(st.permutations((2, 3, 4)), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_it_is_never_the_turn_of_one_without_company(successors: list[int], led_s: float, later_s: float) -> None:
    succession = Succession(3, successors)
    succession.awaits(led_s, (0, 0), led=True, in_company=True)
    now_s = led_s + later_s
    assert not (succession.awaits(now_s, (0, 0), led=False, in_company=False) and succession.rank_in_turn(now_s))


# ---------------------------------------------------------------- two that lead


def apart(*parts: set[int]) -> dict[int, int]:
    return {i: number for number, part in enumerate(parts) for i in part}


@pytest.mark.parametrize("successors", list(permutations((2, 3, 5))))
def test_two_halves_are_led_and_together_again_by_one(successors: tuple[int, ...]) -> None:
    ring = tuple((i, i % 6 + 1) for i in ALL_6)
    fleet = fleet_in_flight(ring, successors)
    fleet.dead = {1}
    side = apart({2, 3}, {4, 5, 6}, {1})
    fleet.hears = lambda receiver, sender: side[receiver] == side[sender]
    around = fleet.fly(100)
    first = min((2, 3), key=successors.index)
    assert leaders_in(around) == [first, 5]
    assert {what.epoch for what in around.values()} == {1}
    assert around[first].reference_s == pytest.approx(around[5].reference_s, abs=0.05)
    fleet.hears = lambda _receiver, _sender: True
    best = min((first, 5), key=successors.index)
    assert leaders_in(fleet.tick()) == [best]
    around = fleet.fly(10)
    assert leaders_in(around) == [best]
    assert flags(around) == {None}


def test_of_an_old_leader_and_a_successor_the_newer_epoch_wins() -> None:
    ring = tuple((i, i % 6 + 1) for i in ALL_6)
    fleet = fleet_in_flight(ring, successors=(4,))
    side = apart({1, 2, 3}, {4, 5, 6})
    fleet.hears = lambda receiver, sender: side[receiver] == side[sender]
    assert leaders_in(fleet.fly(100)) == [1, 4]
    fleet.hears = lambda _receiver, _sender: True
    assert leaders_in(fleet.tick()) == [4]
    assert flags(fleet.fly(10)) == {None}


@pytest.mark.parametrize("claimed_first", [True, False])
def test_a_commanded_lead_beats_a_claimed_one_of_its_epoch(claimed_first: bool) -> None:
    vehicle = Leadership(3, [1], ALL_6)
    claimed, commanded = LeaderWord(2, 1, 10, claim=1), Lead((3,), 1)
    if claimed_first:
        vehicle.hear([claimed])
        assert vehicle.obey(commanded)[0]
    else:
        assert vehicle.obey(commanded)[0]
        vehicle.hear([claimed])
    assert (vehicle.role, vehicle.term) == (Role.LEADER, (1, 0))
    claimant = Leadership(2, [1], ALL_6)
    claimant.take(1)
    claimant.hear([LeaderWord(3, 1, 10)])
    assert (claimant.role, claimant.term) == (Role.FOLLOWER, (1, 0))


def test_a_command_of_an_epoch_that_is_over_is_not_taken_for_done() -> None:
    vehicle = Leadership(3, [1], ALL_6)
    assert vehicle.obey(Lead((3,), 1))[0]
    vehicle.hear([LeaderWord(2, 2, 10, claim=1)])
    assert vehicle.obey(Lead((3,), 1)) == (False, "lead: epoch 1 is not newer than 2")
    assert vehicle.role is Role.FOLLOWER


def test_the_last_epoch_is_not_claimed_past() -> None:
    vehicle = Leadership(2, [1], ALL_6)
    vehicle.hear([LeaderWord(1, MAX_EPOCH, 1)])
    vehicle.take(1)
    assert (vehicle.role, vehicle.epoch) == (Role.FOLLOWER, MAX_EPOCH)


words = st.builds(LeaderWord, leader_id=st.integers(1, 4), epoch=st.integers(0, 3), stamp=st.just(1))
claims = st.builds(
    lambda rank, epoch: LeaderWord(rank + 1, epoch, 1, claim=rank), rank=st.integers(1, 3), epoch=st.integers(1, 3)
)


@given(st.lists(st.one_of(words, claims)), st.randoms(use_true_random=False))
def test_whatever_the_order_all_end_in_the_same_lead(heard: list[LeaderWord], random: Random) -> None:
    terms = set()
    for _ in range(3):
        vehicle = Leadership(4, [1], ALL_6)
        random.shuffle(heard)
        for word in heard:
            vehicle.hear([word])
        terms.add(vehicle.term)
    assert terms == {max([word.term for word in heard], default=(0, 0))}


faults = st.lists(
    st.tuples(st.sampled_from(["kill", "part", "lossy", "heal"]), st.sets(st.integers(1, 5)), st.floats(0.02, 1.5)),
    max_size=6,
)


@settings(max_examples=60, deadline=None)
@given(faults, st.permutations((2, 3, 4)), st.integers(0, 2**32))
def test_whatever_is_lost_one_leads_in_the_end_or_nobody_is_in_formation(
    faults: list[tuple[str, set[int], float]], successors: list[int], seed: int
) -> None:
    fleet = fleet_in_flight(((1, 2), (2, 3), (3, 4), (4, 5), (5, 1), (1, 3)), tuple(successors))
    random = Random(seed)
    for kind, ids, lasts_s in faults:
        if kind == "kill":
            fleet.dead = fleet.dead | {i for i in ids if len(ids) < 4}
        share = {"lossy": 0.5}.get(kind, 0.0)
        part = ids if kind == "part" else set()
        fleet.hears = lambda to, of, part=part, share=share: (  # type: ignore[misc]
            (to in part) is (of in part) and random.random() >= share
        )
        for _ in range(round(lasts_s / TICK_S)):
            around = fleet.tick()
            assert all(around[i].leader_word is not None for i in leaders_in(around))
            times_s = [around[i].reference_s for i in leaders_in(around)]
            assert (
                max(times_s, default=0.0) - min(times_s, default=0.0) < 0.3
            )  # wherever two lead, they are at one place of it
    fleet.hears = lambda _receiver, _sender: True
    for tick in range(150):
        around = fleet.tick()
        assert len(leaders_in(around)) <= 1 or tick == 0
    forms = [i for i in around if fleet.phases[i] is FlightPhase.FORMATION]
    assert {around[i].leaderless for i in forms} <= {None}
    if forms:
        (leader,) = leaders_in(around)
        assert all(around[i].leader_word.leader_id == leader for i in forms)  # type: ignore[union-attr]


# ---------------------------------------------------------------- no false alarm


def test_neither_delay_nor_loss_makes_a_living_leader_s_word_too_old() -> None:
    """Fifteen hops of 100 ms, a tenth of all packets lost, for twenty minutes. A delay ages no word, only what is missing."""
    random, hops, delay = Random(5), 15, 5
    watches = [LeaderWatch(WORD_MAX_AGE_S) for _ in range(hops)]
    on_the_way: list[list[LeaderWord | None]] = [[None] * delay for _ in range(hops)]
    for tick in range(60_000):
        now_s = tick * TICK_S
        told: list[LeaderWord | None] = [LeaderWord(1, 0, tick)]
        for watch, way in zip(watches, on_the_way, strict=True):
            watch.hear(now_s, [way.pop(0)], (0, 0))
            way.append(told[-1] if random.random() >= 0.1 else None)
            told.append(watch.youngest(now_s)[0])
        assert tick < 500 or None not in told


# ---------------------------------------------------------------- in hold


def test_who_holds_for_want_of_a_leader_lands_after_a_while() -> None:
    held = HeldForWantOfALeader(10.0)
    assert not any(held.must_land(now_s, FlightPhase.HOLD, led=False) for now_s in (0.0, 1000.0))  # held by a command
    held.begin(1000.0)
    landed = [held.must_land(1000.0 + s, FlightPhase.HOLD, led=False) for s in (0.0, 5.0, 10.0, 10.02)]
    assert landed == [False, False, False, True]


def test_a_leader_that_is_heard_again_puts_the_landing_off() -> None:
    held = HeldForWantOfALeader(10.0)
    held.begin(0.0)
    assert not held.must_land(9.0, FlightPhase.HOLD, led=True)
    assert not held.must_land(19.0, FlightPhase.HOLD, led=False)
    assert held.must_land(19.02, FlightPhase.HOLD, led=False)


@pytest.mark.parametrize("phase", sorted(set(FlightPhase) - {FlightPhase.HOLD, FlightPhase.RELEASE}))
def test_who_left_that_hold_lands_no_more(phase: FlightPhase) -> None:
    held = HeldForWantOfALeader(10.0)
    held.begin(0.0)
    assert not held.must_land(5.0, phase, led=False)
    assert not held.must_land(50.0, FlightPhase.HOLD, led=False)
    held.begin(60.0)
    held.end()  # a command came
    assert not held.must_land(90.0, FlightPhase.HOLD, led=False)


def test_where_no_time_is_given_it_stays_in_hold() -> None:
    held = HeldForWantOfALeader(None)
    held.begin(0.0)
    assert not any(held.must_land(float(now_s), FlightPhase.HOLD, led=False) for now_s in range(0, 100_000, 100))
