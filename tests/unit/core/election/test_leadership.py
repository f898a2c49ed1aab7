"""Change of leader: newer epochs win, packets make no leader, PrCs settle, mission time continues."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import outcome, with_fields
from companion.analysis.interaction import interaction_matrix
from companion.analysis.response import settled_prcs
from companion.core.election.beacon import WAITED_S, MissionClock
from companion.core.election.leadership import Leadership
from companion.types.autopilot import VehicleState
from companion.types.commands import MAX_EPOCH, NUMBERS_AHEAD, Command, CommandName, Lead, next_epoch
from companion.types.flight import Flight, FlightPhase, Role
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.peers import ReceivedPeerPacket
from stage_fleets import CHAIN, RING, TICK_S, CooperatingFleet, leaders_in
from tests.helpers.laws import weighted


def leadership(own_id: int = 1) -> Leadership:
    return Leadership(own_id, leaders=[1], may_lead=[1, 2])


# ---------------------------------------------------------------- one vehicle


def test_a_command_of_a_newer_epoch_sets_the_role() -> None:
    first, second, third = (leadership(i) for i in (1, 2, 3))
    events = []
    for vehicle in (first, second, third):
        answer, changes = vehicle.command(Lead((2,), 1))
        assert answer.accepted
        assert vehicle.epoch == 1
        events.append(changes)
    assert [v.role for v in (first, second, third)] == [Role.FOLLOWER, Role.LEADER, Role.FOLLOWER]
    assert events == [
        (Notice(Code.ROLE_CHANGED, "leader -> follower in epoch 1 (commanded)"),),
        (Notice(Code.ROLE_CHANGED, "follower -> leader in epoch 1 (commanded)"),),
        (),
    ]


@pytest.mark.parametrize(
    ("lead", "code"),
    [
        (Lead((3,), 6), Code.NOT_A_LEADER),
        (Lead((1, 99), 6), Code.NOT_A_LEADER),
        (Lead((), 6), Code.NO_LEADER_NAMED),
        (Lead((1,), 5), Code.EPOCH_TOO_OLD),
        (Lead((1,), 4), Code.EPOCH_TOO_OLD),
        (Lead((1,), 2**31), Code.EPOCH_TOO_LARGE),
        (Lead((1,), 6 + NUMBERS_AHEAD), Code.EPOCH_TOO_LARGE),
    ],
)
def test_a_refused_command_changes_nothing(lead: Lead, code: Code) -> None:
    vehicle = leadership(2)
    vehicle.command(Lead((2,), 5))
    assert outcome(vehicle.command(lead)[0]) == (False, code)
    assert (vehicle.role, vehicle.epoch) == (Role.LEADER, 5)


def test_epoch_0_cannot_be_commanded() -> None:
    assert leadership(2).command(Lead((2,), 0))[0].notice.code is Code.EPOCH_TOO_OLD


def test_the_same_command_again_is_accepted_and_changes_nothing() -> None:
    vehicle = leadership(2)
    vehicle.command(Lead((2,), 1))
    answer, events = vehicle.command(Lead((2,), 1))
    assert outcome(answer) == (True, Code.ALREADY_DONE)
    assert events == ()


def test_a_vehicle_that_missed_a_command_follows_the_peers_and_accepts_it_later() -> None:
    missed = leadership(1)
    missed.receive(0.0, [None, LeaderBeacon(2, 1, 5), LeaderBeacon(2, 0, 9)])
    assert (missed.role, missed.epoch) == (Role.FOLLOWER, 1)
    named = leadership(2)
    named.receive(0.0, [LeaderBeacon(1, 1, 5)])
    assert named.role is Role.FOLLOWER
    assert named.command(Lead((1, 2), 1))[0].accepted  # repeated to the one that did not answer
    assert named.role is Role.LEADER


@given(st.lists(st.integers(0, 5)))
def test_no_beacon_makes_a_leader(epochs: list[int]) -> None:
    vehicle = leadership(2)
    vehicle.receive(0.0, [LeaderBeacon(2, epoch, 1) for epoch in epochs])
    assert vehicle.role is Role.FOLLOWER
    assert vehicle.epoch == max(epochs, default=0)


def test_more_than_numbers_ahead_are_commanded_in_steps() -> None:
    vehicle = leadership(2)
    assert vehicle.command(Lead((1,), NUMBERS_AHEAD))[0].accepted
    assert not vehicle.command(Lead((2,), 2 * NUMBERS_AHEAD + 1))[0].accepted
    assert vehicle.command(Lead((1,), 2 * NUMBERS_AHEAD))[0].accepted
    assert vehicle.command(Lead((2,), 2 * NUMBERS_AHEAD + 1))[0].accepted
    assert (vehicle.role, vehicle.epoch) == (Role.LEADER, 2 * NUMBERS_AHEAD + 1)


@pytest.mark.parametrize("steps", [(56,), (999,), (1000,), (1000, 2000, 5000)])
def test_one_command_leads_a_fleet_in_which_one_vehicle_has_a_wrong_epoch(steps: tuple[int, ...]) -> None:
    vehicles = {i: leadership(i) for i in (1, 2, 3)}
    for epoch in steps:
        vehicles[2].command(Lead((2,), min(epoch, vehicles[2].epoch + NUMBERS_AHEAD)))
    lead = Lead((1,), next_epoch(vehicle.epoch for vehicle in vehicles.values()))
    assert all(vehicle.command(lead)[0].accepted for vehicle in vehicles.values())
    assert {vehicle.term for vehicle in vehicles.values()} == {(lead.epoch, 0)}


@pytest.mark.parametrize(("own", "lead", "accepted"), [(20, 11, True), (20, 12, False), (20, 20, False), (9, 0, True)])
def test_an_epoch_is_lowered_only_to_where_that_of_its_peers_is_not_believed(
    own: int, lead: int, accepted: bool
) -> None:
    vehicle = leadership(2)
    vehicle.command(Lead((2,), own))
    assert vehicle.command(Lead((1,), lead))[0].accepted is accepted


def test_a_vehicle_whose_epoch_a_command_lowers_does_not_return_to_it_by_its_peers() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.give(Lead((2,), 900))
    fleet.fly(20)
    command = Command(CommandName.LEAD, 1, "anna@ground", 1, Lead((2,), 5))
    for tick in range(50):
        fleet.now_s += TICK_S
        packets = [
            with_fields(fleet.packets[i], sequence=fleet.packets[i].sender.sequence + tick + 1, sent_s=fleet.now_s)
            for i in (2, 4)
        ]
        around = fleet.vehicles[1].step(
            fleet.now_s,
            VehicleState(armed=True, position_time_s=fleet.now_s),
            Flight(FlightPhase.FORMATION, in_formation=True),
            [ReceivedPeerPacket(fleet.now_s, packet) for packet in packets],
            [] if tick else [command],
        )
        assert around.lead.term[0] == 5
    assert around.peers.fresh.keys() == {2, 4}


# ---------------------------------------------------------------- mission time


def clock_at(reference_s: float, now_s: float) -> MissionClock:
    """That has received this mission time from a leader for long enough."""
    clock = MissionClock()
    for ago_s in (0.51, 0.25, 0.0):
        counted_s = clock.update(now_s - ago_s, False, LeaderBeacon(1, 0, 1, reference_s - ago_s), 0.0)
    assert counted_s == pytest.approx(reference_s + WAITED_S)
    clock.on_ground = False
    return clock


def test_a_follower_counts_with_its_leader_and_continues_without_a_beacon() -> None:
    clock = clock_at(30.0, now_s=100.0)
    assert clock.update(100.2, True, LeaderBeacon(1, 0, 1, 30.0), 0.2) == pytest.approx(30.2 + WAITED_S)
    assert clock.update(101.0, True, None, 9.0) == pytest.approx(31.0 + WAITED_S)
    assert clock.lead(101.5, True, None, 9.0) == pytest.approx(31.5 + WAITED_S)


def test_mission_time_is_stopped_until_a_leader_is_in_formation() -> None:
    clock = MissionClock()
    for now_s in (100.0, 107.0):
        assert clock.lead(now_s, False, None, 9.0) == 0.0
    assert clock.lead(107.02, True, None, 9.0) == pytest.approx(0.02)
    follower = MissionClock()
    assert follower.update(200.0, True, LeaderBeacon(1, 0, 1, 0.0), 0.3) == 0.0
    assert follower.update(201.0, False, None, 9.0) == 0.0


def test_a_second_leader_enters_formation_at_the_time_of_the_first() -> None:
    clock = clock_at(12.0, now_s=100.0)
    assert clock.lead(100.1, True, None, 9.0) == pytest.approx(12.1 + WAITED_S)


def test_the_second_of_two_leaders_takes_the_time_of_the_first_when_they_differ_much() -> None:
    clock = clock_at(60.0, now_s=100.0)
    for reported_s in (0.0, 59.9, 60.4):  # stopped, or different by network delay: no correction
        assert clock.lead(100.1, True, LeaderBeacon(1, 0, 2, reported_s), 0.0) == pytest.approx(60.1 + WAITED_S)
    assert clock.lead(100.2, True, LeaderBeacon(1, 0, 3, 0.5), 0.1) == pytest.approx(60.2 + WAITED_S)  # it may be wrong
    assert clock.lead(100.8, True, LeaderBeacon(1, 0, 4, 1.1), 0.1) == pytest.approx(1.2 + WAITED_S)
    assert clock.lead(100.9, True, None, 9.0) == pytest.approx(1.3 + WAITED_S)


def test_one_wrong_mission_time_is_not_followed() -> None:
    clock, wrong = clock_at(60.0, now_s=100.0), LeaderBeacon(1, 0, 9, 9e5)
    for tick in range(100):
        now_s = 100.0 + 0.02 * tick
        beacon = wrong if tick % 20 == 19 else LeaderBeacon(1, 0, tick, 60.0 + 0.02 * tick)
        assert clock.update(now_s, True, beacon, 0.0) == pytest.approx(60.0 + 0.02 * tick + WAITED_S)


@pytest.mark.parametrize("step_s", [0.08, 0.95, -0.95])
@pytest.mark.parametrize("packets", [1, 2])
def test_wrong_mission_times_shift_a_clock_by_little_and_not_for_long(packets: int, step_s: float) -> None:
    """Each differs from the one before by as much. A fall of more than a second would restart the formation's time."""
    clock = clock_at(60.0, now_s=100.0)
    for tick in range(1, 60):
        true_s = 60.0 + 0.02 * tick
        wrong_s = step_s * tick if tick <= packets else 0.0
        counted_s = clock.update(100.0 + 0.02 * tick, True, LeaderBeacon(1, 0, tick, true_s + wrong_s), 0.0)
        assert counted_s - true_s == pytest.approx(WAITED_S, abs=0.17)
        if tick > packets + round(0.52 / TICK_S):
            assert counted_s - true_s == pytest.approx(WAITED_S)


def test_a_mission_time_that_differs_by_half_a_second_is_followed_when_it_lasts() -> None:
    clock = clock_at(60.0, now_s=100.0)
    for tick in range(1, 27):
        counted_s = clock.update(100.0 + 0.02 * tick, True, LeaderBeacon(1, 0, tick, 60.5 + 0.02 * tick), 0.0)
        assert counted_s - 0.02 * tick == pytest.approx((60.5 if tick == 26 else 60.0) + WAITED_S)


def test_one_wrong_mission_time_does_not_start_a_clock_that_is_stopped() -> None:
    """A leader in hold would lead from there; the operator's next change would begin too late for all others."""
    clock, wrong = clock_at(60.0, now_s=100.0), LeaderBeacon(2, 0, 9, 9e5)
    stopped_s = clock.lead(100.02, False, None, 9.0)
    for tick in range(20):  # so long a beacon is passed on
        assert clock.lead(101.0 + 0.02 * tick, False, wrong, 0.02 * tick) == stopped_s
    assert clock.lead(110.0, False, None, 9.0) == stopped_s
    for tick in range(50):  # two different ones do not confirm each other
        assert clock.lead(120.0 + 0.02 * tick, False, LeaderBeacon(2, 0, 9, 9e5 * (1 + tick % 2)), 0.0) == stopped_s


def test_a_vehicle_on_the_ground_follows_the_mission_time_of_the_others_until_it_stops() -> None:
    clock = clock_at(60.0, now_s=100.0)
    clock.on_ground = True
    assert clock.update(100.02, False, LeaderBeacon(1, 0, 2, 60.02), 0.0) == pytest.approx(60.02 + WAITED_S)
    assert clock.update(100.04, False, LeaderBeacon(1, 0, 3, 9e5), 0.0) == pytest.approx(60.04 + WAITED_S)
    assert clock.update(100.06, False, None, 9.0) == 0.0


def test_a_received_term_ends_without_a_leader_alive() -> None:
    vehicle = Leadership(1, [1], (1, 2))
    vehicle.receive(0.0, [LeaderBeacon(2, 1000, 5)])
    assert (vehicle.role, vehicle.epoch) == (Role.FOLLOWER, 1000)
    vehicle.settle(0.2, [LeaderBeacon(2, 1000, 5)])
    assert vehicle.epoch == 1000
    vehicle.settle(0.32, [LeaderBeacon(2, 1000, 5)])  # younger than UNCONFIRMED_S on its way, and no proof
    assert (vehicle.role, vehicle.epoch) == (Role.LEADER, 0)
    vehicle.receive(0.34, [LeaderBeacon(2, 1000, 5)])  # still passed on by others
    assert vehicle.epoch == 0


def test_a_received_term_with_a_leader_alive_stays() -> None:
    vehicle = Leadership(1, [1], (1, 2))
    vehicle.receive(0.0, [LeaderBeacon(2, 3, 5)])
    vehicle.settle(0.2, [LeaderBeacon(2, 3, 205)])
    vehicle.settle(5.0, [])
    assert (vehicle.role, vehicle.epoch) == (Role.FOLLOWER, 3)


def test_beacons_of_one_moment_confirm_no_term() -> None:
    vehicle = Leadership(1, [1], (1, 2))
    vehicle.receive(0.0, [LeaderBeacon(2, 3, 5)])
    vehicle.settle(0.02, [LeaderBeacon(2, 3, 5), LeaderBeacon(2, 3, 25)])
    vehicle.settle(0.2, [LeaderBeacon(2, 3, 25), LeaderBeacon(1, 3, 10**6)])  # the own id, and so no other leader
    vehicle.settle(0.32, [LeaderBeacon(2, 3, 25)])
    assert (vehicle.role, vehicle.epoch) == (Role.LEADER, 0)
    for stamp in (5, 25):
        vehicle.receive(0.34, [LeaderBeacon(2, 3, stamp)])
    assert vehicle.epoch == 0
    vehicle.receive(0.36, [LeaderBeacon(2, 3, 45)])
    assert vehicle.epoch == 3


@pytest.mark.parametrize("in_formation", [True, False])
def test_a_follower_stops_at_the_time_at_which_its_leader_stops(in_formation: bool) -> None:
    clock = clock_at(60.0, now_s=100.0)
    stopped_s = clock.update(100.0, in_formation, LeaderBeacon(1, 0, 1, 60.0), 0.0)
    for now_s in (100.02, 101.0, 107.0):
        assert clock.update(now_s, in_formation, LeaderBeacon(1, 0, int(now_s * 1000), 0.0), 0.0) == stopped_s
    assert clock.update(108.0, in_formation, None, 9.0) == stopped_s  # without a beacon it stays stopped
    assert clock.lead(108.02, True, None, 9.0) == pytest.approx(stopped_s + 0.02)


def test_a_leader_continues_where_it_stopped_when_it_is_back_in_formation() -> None:
    clock = MissionClock()
    clock.on_ground = False
    clock.lead(100.0, False, None, 9.0)
    stopped_s = clock.lead(160.0, True, None, 9.0)
    assert clock.lead(170.0, False, None, 9.0) == clock.lead(180.0, False, None, 9.0) == stopped_s
    assert clock.lead(180.02, True, None, 9.0) == pytest.approx(stopped_s + 0.02)
    clock.on_ground = True
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
    fleet = CooperatingFleet(edges, may_lead=(1, 2, 3, 4))
    fleet.fly(20)
    fleet.give(Lead(leaders, 1))
    settled = settled_prcs(graph_of(edges), leaders)
    before = fleet.tick()
    assert {i: what.prc for i, what in before.items()} != settled
    after = fleet.fly(diameter)
    assert {i: what.prc for i, what in after.items()} == settled
    epochs = {what.lead.beacon.epoch for what in after.values() if what.lead.beacon}
    assert epochs == {1}


def test_the_ring_has_the_paper_s_matrices_before_and_after_a_change_of_leader() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    before = fleet.fly(20)
    fleet.give(Lead((2,), 1))
    after = fleet.fly(3)
    for around, leader in ((before, 1), (after, 2)):
        assert {i: what.prc for i, what in around.items()} == settled_prcs(graph_of(RING), [leader])
        graph = {i: what.neighbours.ids for i, what in around.items()}
        assert interaction_matrix(graph, [leader], weighted()).tolist() == PAPER_MATRICES[leader]


PAPER_MATRICES = {
    1: [[2.0, -0.5, 0.0, -0.5], [-0.75, 1.0, -0.25, 0.0], [0.0, -0.5, 1.0, -0.5], [-0.75, 0.0, -0.25, 1.0]],
    2: [[1.0, -0.75, 0.0, -0.25], [-0.5, 2.0, -0.5, 0.0], [0.0, -0.75, 1.0, -0.25], [-0.5, 0.0, -0.5, 1.0]],
}


@pytest.mark.parametrize("missed", [missed for n in (0, 1, 2) for missed in combinations((1, 3, 4), n)])
def test_two_epochs_have_leaders_for_at_most_one_packet(missed: tuple[int, ...]) -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.give(Lead((2,), 1), *(set(fleet.ids) - set(missed)))
    assert leaders_in(fleet.tick()) == ([1, 2] if 1 in missed else [2])
    for _ in range(50):
        around = fleet.tick()
        assert leaders_in(around) == [2]
        assert all(
            what.lead.beacon is not None for what in around.values()
        )  # no vehicle ever considered the leader lost
    assert {what.lead.term[0] for what in around.values()} == {1}


def test_an_old_leader_without_reception_is_used_by_no_vehicle() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.deaf = {1}
    fleet.give(Lead((2,), 1), 2, 3, 4)
    around = fleet.fly(20)
    assert leaders_in(around) == [1, 2]
    # 4 counts its hops to 2 through 3: its neighbour 1 sends PrC 1, but of an old epoch.
    assert {i: around[i].prc for i in (2, 3, 4)} == {2: 1, 3: 2, 4: 3}
    assert all(around[i].lead.beacon.leader_id == 2 for i in (3, 4))  # type: ignore[union-attr]
    fleet.deaf = set()
    assert leaders_in(fleet.tick()) == [2]


@pytest.mark.parametrize("restarted", [1, 2])
def test_a_restarted_agent_is_follower_in_a_newer_epoch(restarted: int) -> None:
    """1 is leader by the file, 2 was leader of epoch 1 when it restarted: the epoch has no leader until a command."""
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    fleet.give(Lead((2,), 1))
    fleet.fly(20)
    fleet.vehicles[restarted], fleet.sessions[restarted] = fleet.started(restarted), 2
    fleet.phases[restarted] = FlightPhase.OBSERVE
    del fleet.packets[restarted]
    for i, vehicle in fleet.vehicles.items():  # it was away for so long that its peers have forgotten it
        if i != restarted:
            vehicle.peers = fleet.started(i).peers
    for _ in range(100):
        around = fleet.tick()
        assert around[restarted].lead.role is Role.FOLLOWER
        assert around[restarted].lead.term[0] <= 1
    expected = [2] if restarted == 1 else []
    assert leaders_in(around) == expected
    assert (around[3].lead.beacon is not None) is bool(expected)


def test_mission_time_is_passed_on_and_continues_at_a_change_of_leader() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    around = fleet.fly(500)
    leader_s = around[1].lead.reference_s
    assert all(abs(what.lead.reference_s - leader_s) < 2 * (TICK_S - WAITED_S) + 1e-6 for what in around.values())
    for epoch in range(1, 41):
        fleet.give(Lead((1 + epoch % 2,), epoch))
        before_s = around[1 + epoch % 2].lead.reference_s
        around = fleet.tick()
        assert around[1 + epoch % 2].lead.reference_s - before_s == pytest.approx(TICK_S)
        around = fleet.fly(9)


@pytest.mark.parametrize("edges", [RING, CHAIN])
def test_the_rft_continues_after_its_leader_was_in_hold(edges: tuple[tuple[int, int], ...]) -> None:
    fleet = CooperatingFleet(edges, may_lead=(1, 2))
    stopped_s = fleet.fly(500)[1].lead.reference_s
    fleet.phases[1] = FlightPhase.HOLD
    around = fleet.fly(500)
    assert all(what.lead.reference_s == pytest.approx(stopped_s, abs=0.1) for what in around.values())
    assert all(what.lead.beacon is not None and what.lead.beacon.reference_s == 0.0 for what in around.values())
    stopped_at_s = around[2].lead.reference_s
    fleet.give(Lead((2,), 1))
    assert fleet.tick()[2].lead.reference_s == pytest.approx(stopped_at_s + TICK_S)
    continued_s = fleet.fly(100)[2].lead.reference_s
    assert continued_s == pytest.approx(stopped_at_s + 101 * TICK_S)
    fleet.give(Lead((1,), 2))  # back to the leader in hold: mission time stops there
    assert fleet.fly(100)[1].lead.reference_s == pytest.approx(continued_s, abs=0.1)
    fleet.phases[1] = FlightPhase.FORMATION
    around = fleet.fly(10)
    assert all(what.lead.reference_s == pytest.approx(continued_s + 10 * TICK_S, abs=0.1) for what in around.values())


@pytest.mark.parametrize("holds", [1, 3])
def test_a_leader_in_hold_does_not_stop_the_time_of_another(holds: int) -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 3))
    fleet.give(Lead((1, 3), 1))
    leads = 4 - holds
    fleet.phases[holds] = FlightPhase.HOLD
    began_s = fleet.fly(40)[leads].lead.reference_s  # the other one follows a mission time that lasts
    for tick in range(1, 200):
        around = fleet.tick()
        assert around[leads].lead.reference_s == pytest.approx(began_s + tick * TICK_S)
        # also of the one in hold: it enters formation at the time of the other
        assert all(abs(what.lead.reference_s - around[leads].lead.reference_s) < 0.03 for what in around.values())


def test_a_beacon_of_a_huge_epoch_claims_nothing() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    fleet.fly(20)
    honest = fleet.packets[4]
    forged = with_fields(
        honest,
        sequence=honest.sender.sequence + 1,
        sent_s=fleet.now_s,
        beacon=LeaderBeacon(1, MAX_EPOCH, 1, 1.0),
        position_enu_m=(0.0, 0.0, 0.5),
    )
    around = fleet.vehicles[1].step(
        fleet.now_s,
        VehicleState(armed=True, position_time_s=fleet.now_s),
        Flight(FlightPhase.FORMATION, in_formation=True),
        [ReceivedPeerPacket(fleet.now_s, forged)],
    )
    assert (around.lead.role, around.lead.term[0]) == (Role.LEADER, 0)
    assert around.peers.fresh[4].packet.motion.position_enu_m == (0.0, 0.0, 0.5)  # separation needs it
    assert dict(fleet.vehicles[1].peers.rejected) == {f"{Code.PEER_EPOCH_TOO_HIGH} 4": 1}
    fleet.vehicles[1].peers.rejected.clear()
    del fleet.packets[4]  # the forged one has taken its place
    fleet.now_s += TICK_S
    fleet.give(Lead((2,), 1))
    assert leaders_in(fleet.fly(5)) == [2]


def test_a_restarted_agent_catches_up_with_all_epochs_it_may_have_missed() -> None:
    fleet = CooperatingFleet(RING, may_lead=(1, 2))
    fleet.give(Lead((2,), NUMBERS_AHEAD))
    fleet.vehicles[1], fleet.phases[1] = fleet.started(1), FlightPhase.HOLD
    around = fleet.fly(5)
    assert leaders_in(around) == [2]
    assert {what.lead.term[0] for what in around.values()} == {NUMBERS_AHEAD}
