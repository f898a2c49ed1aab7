"""Loss of the leader: formation continues for a while, one successor leads, and two lead for at most one packet."""

from __future__ import annotations

from itertools import permutations
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common import outcome
from companion.analysis.response import settled_prcs
from companion.core.consensus.stage import Consensus
from companion.core.election.beacon import BeaconMonitor
from companion.core.election.leadership import TURN_S, UNCONFIRMED_S, Leadership, Succession
from companion.types.commands import MAX_EPOCH, Lead
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code
from stage_fleets import BEACON_MAX_AGE_S, CHAIN, RING, TICK_S, CooperatingFleet, leaders_in

ALL_6 = tuple(range(1, 7))
STAR = ((1, 2), (1, 3), (1, 4))


def fleet_in_flight(
    edges: tuple[tuple[int, int], ...] = RING, successors: tuple[int, ...] = (2, 3), may_lead: tuple[int, ...] = ALL_6
) -> CooperatingFleet:
    fleet = CooperatingFleet(edges, may_lead, successors)
    fleet.fly(50)
    return fleet


def seconds_until_led(fleet: CooperatingFleet, by: int) -> float:
    """Time until all remaining vehicles receive this leader's beacon."""
    began_s = fleet.now_s
    while True:
        around = fleet.tick()
        if all(what.lead.beacon is not None and what.lead.beacon.leader_id == by for what in around.values()):
            return fleet.now_s - began_s
        assert fleet.now_s < began_s + 5.0


def flags(around: dict[int, Consensus]) -> set[HealthFlag | None]:
    return {what.lead.leaderless for what in around.values()}


# ---------------------------------------------------------------- the rule


@pytest.mark.parametrize(("edges", "diameter_left"), [(RING, 2), (CHAIN, 4)])
def test_the_first_successor_leads_and_prcs_settle(edges: tuple[tuple[int, int], ...], diameter_left: int) -> None:
    fleet = fleet_in_flight(edges)
    fleet.dead, died_s = {1}, fleet.now_s
    while not leaders_in(around := fleet.tick()):
        missed = fleet.now_s - died_s > BEACON_MAX_AGE_S + len(fleet.ids) * TICK_S
        assert flags(around) <= ({HealthFlag.LEADER_AWAITED} if missed else {None, HealthFlag.LEADER_AWAITED})
        assert set(fleet.phases.values()) == {FlightPhase.FORMATION}
    assert leaders_in(around) == [2]
    assert fleet.now_s - died_s < BEACON_MAX_AGE_S + TURN_S + 3 * TICK_S
    around = fleet.fly(diameter_left)
    left = {i: {a + b - i for a, b in edges if i in (a, b)} - {1} for i in fleet.ids if i != 1}
    assert {i: what.prc for i, what in around.items()} == settled_prcs(left, [2])
    assert flags(around) == {None}


def test_each_dead_successor_costs_one_turn() -> None:
    for dead, by in (({1}, 2), ({1, 2}, 3), ({1, 2, 3}, 4)):
        fleet = fleet_in_flight(tuple((i, i + 1) for i in range(1, 6)), successors=(2, 3, 4))
        fleet.dead = dead
        took_s = seconds_until_led(fleet, by)
        turns_s = BEACON_MAX_AGE_S + (by - 1) * TURN_S
        assert turns_s < took_s < turns_s + 7 * TICK_S
        assert took_s < 1.5


def test_mission_time_continues_when_a_successor_leads() -> None:
    fleet = fleet_in_flight()
    before_s, died_s = fleet.tick()[2].lead.reference_s, fleet.now_s
    fleet.dead = {1}
    seconds_until_led(fleet, by=2)
    assert fleet.tick()[2].lead.reference_s - before_s == pytest.approx(fleet.now_s - died_s)


def test_all_hold_after_one_turn_when_there_are_no_successors() -> None:
    fleet = fleet_in_flight(successors=())
    fleet.dead = {1}
    around = fleet.fly(round((BEACON_MAX_AGE_S + TURN_S) / TICK_S) - 1)
    assert flags(around) == {HealthFlag.LEADER_AWAITED}
    around = fleet.fly(5)
    assert flags(around) == {HealthFlag.LEADER_LOST}
    assert leaders_in(fleet.fly(200)) == []


def test_all_hold_two_turns_after_the_last_successor_when_none_is_left() -> None:
    fleet = fleet_in_flight()
    fleet.dead = {1, 2}
    fleet.phases[3] = FlightPhase.LAND
    assert leaders_in(fleet.fly(round((BEACON_MAX_AGE_S + 4 * TURN_S) / TICK_S) + 5)) == []
    assert fleet.phases[4] is FlightPhase.HOLD


def test_a_beacon_that_returns_within_a_turn_changes_no_leader() -> None:
    fleet = fleet_in_flight()
    for lost_s in (0.1, 0.3, 0.5):
        fleet.receives = lambda _receiver, sender: sender != 1
        for _ in range(round(lost_s / TICK_S)):
            assert leaders_in(fleet.tick()) == [1]
        fleet.receives = lambda _receiver, _sender: True
        assert flags(fleet.fly(3)) == {None}
        assert {what.lead.term[0] for what in fleet.fly(50).values()} == {0}


def test_the_old_leader_returns_as_a_follower() -> None:
    fleet = fleet_in_flight()
    fleet.dead = {1}
    fleet.packets.pop(1)
    fleet.fly(100)
    fleet.dead, fleet.vehicles[1], fleet.sessions[1] = set(), fleet.started(1), 2
    fleet.phases[1] = FlightPhase.OBSERVE
    fleet.tick()
    for _ in range(100):
        assert leaders_in(fleet.tick()) == [2]


@pytest.mark.parametrize(("leads_s", "term"), [(0.0, (1, -2)), (0.4, (2, -2))])
def test_the_next_successor_leads_when_the_first_dies(leads_s: float, term: tuple[int, int]) -> None:
    """In a newer epoch, where all vehicles knew that the first was alive."""
    fleet = fleet_in_flight(tuple((i, i + 1) for i in range(1, 6)), successors=(2, 3))
    fleet.dead = {1}
    seconds_until_led(fleet, by=2)
    assert {what.lead.term for what in fleet.fly(1 + round(leads_s / TICK_S)).values()} == {(1, -1)}
    fleet.dead = {1, 2}
    assert seconds_until_led(fleet, by=3) < UNCONFIRMED_S + 2 * TURN_S + 7 * TICK_S
    assert {what.lead.term for what in fleet.tick().values()} == {term}


@pytest.mark.parametrize("phase", [FlightPhase.HOLD, FlightPhase.RELEASE, FlightPhase.LAND, FlightPhase.OBSERVE])
def test_a_successor_out_of_formation_claims_no_leadership(phase: FlightPhase) -> None:
    fleet = fleet_in_flight()
    fleet.dead, fleet.phases[2] = {1}, phase
    led = [leader for _ in range(150) for leader in leaders_in(fleet.tick())]
    assert 2 not in led
    assert 3 in led


def test_a_successor_without_reception_claims_no_leadership() -> None:
    """Its own radio may have failed; the leader continues with the others."""
    fleet = fleet_in_flight(successors=(2,))
    fleet.receives = lambda receiver, sender: 2 not in (receiver, sender)
    around = fleet.fly(100)
    assert leaders_in(around) == [1]
    assert fleet.phases[2] is FlightPhase.HOLD
    assert {fleet.phases[i] for i in (1, 3, 4)} == {FlightPhase.FORMATION}


def test_a_leader_received_directly_is_not_replaced_when_no_neighbour_passes_it_on() -> None:
    """PrC counted up to n is no path to a leader: vehicles that are cut off hold, the others fly on."""
    fleet = fleet_in_flight(CHAIN, successors=(4, 5))
    fleet.dead = {3}
    around = fleet.fly(100)
    assert leaders_in(around) == [1]
    assert {what.lead.term[0] for what in around.values()} == {0}
    assert [fleet.phases[i] for i in (1, 2, 4, 5, 6)] == [FlightPhase.FORMATION] * 2 + [FlightPhase.HOLD] * 3
    assert {around[i].lead.beacon for i in (4, 5, 6)} == {None}


def test_a_successor_that_does_not_know_mission_time_claims_no_leadership() -> None:
    fleet = CooperatingFleet(RING, ALL_6, (2, 3))
    fleet.phases[1] = FlightPhase.HOLD  # not in the RFT yet
    fleet.fly(20)
    fleet.dead = {1}
    led = [leader for _ in range(100) for leader in leaders_in(fleet.tick())]
    assert led == []
    assert {fleet.phases[i] for i in (2, 3, 4)} == {FlightPhase.HOLD}


def test_all_hold_when_a_star_loses_its_centre() -> None:
    fleet = fleet_in_flight(STAR, successors=(2, 3))
    fleet.dead = {1}
    around = fleet.fly(
        round((BEACON_MAX_AGE_S + TURN_S) / TICK_S) + 3
    )  # one turn: vehicles without neighbours wait no longer
    assert leaders_in(around) == []
    assert {fleet.phases[i] for i in (2, 3, 4)} == {FlightPhase.HOLD}


def test_waiting_starts_again_when_a_new_term_is_received() -> None:
    succession = Succession(4, (2,))
    assert succession.awaits(10.0, (0, 0), led=True, with_neighbours=True)
    assert succession.awaits(10.8, (1, -1), led=False, with_neighbours=True)
    assert succession.awaits(11.6, (1, -1), led=False, with_neighbours=True)
    assert not succession.awaits(11.8, (1, -1), led=False, with_neighbours=True)


@given(st.permutations((2, 3, 4)), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_a_vehicle_without_neighbours_never_has_its_turn(successors: list[int], led_s: float, later_s: float) -> None:
    succession = Succession(3, successors)
    succession.awaits(led_s, (0, 0), led=True, with_neighbours=True)
    now_s = led_s + later_s
    assert not (succession.awaits(now_s, (0, 0), led=False, with_neighbours=False) and succession.rank_in_turn(now_s))


# ---------------------------------------------------------------- two leaders


def apart(*parts: set[int]) -> dict[int, int]:
    return {i: number for number, part in enumerate(parts) for i in part}


@pytest.mark.parametrize("successors", list(permutations((2, 3, 5))))
def test_each_half_has_a_leader_and_one_remains_when_they_meet(successors: tuple[int, ...]) -> None:
    ring = tuple((i, i % 6 + 1) for i in ALL_6)
    fleet = fleet_in_flight(ring, successors)
    fleet.dead = {1}
    side = apart({2, 3}, {4, 5, 6}, {1})
    fleet.receives = lambda receiver, sender: side[receiver] == side[sender]
    around = fleet.fly(100)
    first = min((2, 3), key=successors.index)
    assert leaders_in(around) == [first, 5]
    assert {what.lead.term[0] for what in around.values()} == {1}
    assert around[first].lead.reference_s == pytest.approx(around[5].lead.reference_s, abs=0.05)
    fleet.receives = lambda _receiver, _sender: True
    best = min((first, 5), key=successors.index)
    assert leaders_in(fleet.tick()) == [best]
    around = fleet.fly(10)
    assert leaders_in(around) == [best]
    assert flags(around) == {None}


def test_the_newer_epoch_wins_when_an_old_leader_and_a_successor_meet() -> None:
    ring = tuple((i, i % 6 + 1) for i in ALL_6)
    fleet = fleet_in_flight(ring, successors=(4,))
    side = apart({1, 2, 3}, {4, 5, 6})
    fleet.receives = lambda receiver, sender: side[receiver] == side[sender]
    assert leaders_in(fleet.fly(100)) == [1, 4]
    fleet.receives = lambda _receiver, _sender: True
    assert leaders_in(fleet.tick()) == [4]
    assert flags(fleet.fly(10)) == {None}


@pytest.mark.parametrize("claimed_first", [True, False])
def test_a_command_beats_a_claim_of_its_epoch(claimed_first: bool) -> None:
    vehicle = Leadership(3, [1], ALL_6)
    claimed, commanded = LeaderBeacon(2, 1, 10, claim=1), Lead((3,), 1)
    if claimed_first:
        vehicle.receive(0.0, [claimed])
        assert vehicle.command(commanded)[0].accepted
    else:
        assert vehicle.command(commanded)[0].accepted
        vehicle.receive(0.0, [claimed])
    assert (vehicle.role, vehicle.term) == (Role.LEADER, (1, 0))
    claimant = Leadership(2, [1], ALL_6)
    claimant.claim(1)
    claimant.receive(0.0, [LeaderBeacon(3, 1, 10)])
    assert (claimant.role, claimant.term) == (Role.FOLLOWER, (1, 0))


def test_a_command_of_an_old_epoch_is_refused() -> None:
    vehicle = Leadership(3, [1], ALL_6)
    assert vehicle.command(Lead((3,), 1))[0].accepted
    vehicle.receive(0.0, [LeaderBeacon(2, 2, 10, claim=1)])
    assert outcome(vehicle.command(Lead((3,), 1))[0]) == (False, Code.EPOCH_TOO_OLD)
    assert vehicle.role is Role.FOLLOWER


def test_no_epoch_is_claimed_after_the_last() -> None:
    vehicle = Leadership(2, [1], ALL_6)
    vehicle.receive(0.0, [LeaderBeacon(1, MAX_EPOCH, 1)])
    vehicle.claim(1)
    assert (vehicle.role, vehicle.epoch) == (Role.FOLLOWER, MAX_EPOCH)


commanded = st.builds(LeaderBeacon, leader_id=st.integers(1, 4), epoch=st.integers(0, 3), stamp=st.just(1))
claims = st.builds(
    lambda rank, epoch: LeaderBeacon(rank + 1, epoch, 1, claim=rank), rank=st.integers(1, 3), epoch=st.integers(1, 3)
)


@given(st.lists(st.one_of(commanded, claims)), st.randoms(use_true_random=False))
def test_all_end_in_the_same_term_in_any_order_of_beacons(beacons: list[LeaderBeacon], random: Random) -> None:
    terms = set()
    for _ in range(3):
        vehicle = Leadership(4, [1], ALL_6)
        random.shuffle(beacons)
        for beacon in beacons:
            vehicle.receive(0.0, [beacon])
        terms.add(vehicle.term)
    assert terms == {max([beacon.term for beacon in beacons], default=(0, 0))}


faults = st.lists(
    st.tuples(st.sampled_from(["kill", "part", "lossy", "heal"]), st.sets(st.integers(1, 5)), st.floats(0.02, 1.5)),
    max_size=6,
)


@settings(max_examples=60, deadline=None)
@given(faults, st.permutations((2, 3, 4)), st.integers(0, 2**32))
def test_one_leader_remains_or_no_vehicle_is_in_formation_after_any_faults(
    faults: list[tuple[str, set[int], float]], successors: list[int], seed: int
) -> None:
    fleet = fleet_in_flight(((1, 2), (2, 3), (3, 4), (4, 5), (5, 1), (1, 3)), tuple(successors))
    random = Random(seed)
    for kind, ids, lasts_s in faults:
        if kind == "kill":
            fleet.dead = fleet.dead | {i for i in ids if len(ids) < 4}
        share = {"lossy": 0.5}.get(kind, 0.0)
        part = ids if kind == "part" else set()
        fleet.receives = lambda to, of, part=part, share=share: (  # type: ignore[misc]
            (to in part) is (of in part) and random.random() >= share
        )
        for _ in range(round(lasts_s / TICK_S)):
            around = fleet.tick()
            assert all(around[i].lead.beacon is not None for i in leaders_in(around))
            times_s = [around[i].lead.reference_s for i in leaders_in(around)]
            assert (
                max(times_s, default=0.0) - min(times_s, default=0.0) < 0.3
            )  # two leaders have about the same mission time
    fleet.receives = lambda _receiver, _sender: True
    for tick in range(150):
        around = fleet.tick()
        assert len(leaders_in(around)) <= 1 or tick == 0
    forms = [i for i in around if fleet.phases[i] is FlightPhase.FORMATION]
    assert {around[i].lead.leaderless for i in forms} <= {None}
    if forms:
        (leader,) = leaders_in(around)
        assert all(around[i].lead.beacon.leader_id == leader for i in forms)  # type: ignore[union-attr]


# ---------------------------------------------------------------- no false alarm


def test_delay_and_loss_make_no_beacon_of_a_living_leader_stale() -> None:
    """Fifteen hops of 100 ms, a tenth of all packets lost, for twenty minutes. Delay ages no beacon, only loss does."""
    random, hops, delay = Random(5), 15, 5
    watches = [BeaconMonitor(BEACON_MAX_AGE_S) for _ in range(hops)]
    delayed: list[list[LeaderBeacon | None]] = [[None] * delay for _ in range(hops)]
    for tick in range(60_000):
        now_s = tick * TICK_S
        passed: list[LeaderBeacon | None] = [LeaderBeacon(1, 0, tick)]
        for watch, queue in zip(watches, delayed, strict=True):
            watch.receive(now_s, [queue.pop(0)], (0, 0))
            queue.append(passed[-1] if random.random() >= 0.1 else None)
            passed.append(watch.youngest(now_s)[0])
        assert tick < 500 or None not in passed
