"""Checks of peer packets, and the neighbour rules."""

from math import inf, nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from common import with_fields
from companion.core.consensus.neighbours import BRIDGED_S, BRIDGES_AFTER_S, EdgeRule, RangeRule
from companion.core.consensus.peers import EXTRAPOLATED_MOST_S, FleetLimits, PeerState, PeerTable, neighbour_at
from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, Heading, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import LeaderReport, Motion, PeerPacket, ReceivedPeerPacket, Sender
from companion.types.values import ZERO3

LIMITS = FleetLimits(25.0, 8.0, (200.0, 200.0, 55.0))
MAY_LEAD = {1: True, 2: False, 3: False}
GOOD = PeerPacket(
    sender=Sender(vehicle_id=2, session=77, sequence=10, formation_hash=42),
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    motion=Motion(
        position_enu_m=(1.0, 2.0, 3.0),
        velocity_enu_m_s=(0.5, 0.0, 0.0),
        acceleration_enu_m_s2=(0.0, 0.0, 0.0),
        state_age_s=0.01,
        sent_s=501.0,
    ),
    leader=LeaderReport(prc=2, beacon=LeaderBeacon(1, 0, 20)),
    slot=FlownSlot((-1.5, 0.0, 0.0)),
)


def table() -> PeerTable:
    return PeerTable(own_id=3, may_lead=MAY_LEAD, formation_hash=42, max_age_s=0.3, limits=LIMITS, successors=(1,))


def rejections(peers: PeerTable, received_s: float = 1.0, **changes: Any) -> list[str]:
    """Rejections counted so far, after one packet without delay."""
    packet = with_fields(GOOD, **{"sent_s": 500.0 + received_s} | changes)
    peers.fold([ReceivedPeerPacket(received_s, packet)], epochs_up_to=1007)
    return list(peers.rejected)


def test_valid_packet_is_accepted() -> None:
    peers = table()
    assert rejections(peers) == []
    assert peers.in_time(1.1)[0][2].position_at(1.1) == pytest.approx((1.055, 2.0, 3.0))  # 0.11 s at 0.5 m/s


MOVING = with_fields(
    GOOD,
    velocity_enu_m_s=(2.0, -1.0, 0.0),
    acceleration_enu_m_s2=(1.0, 0.5, -0.5),
    slot=FlownSlot((-1.5, 0.0, 0.0), (0.5, 0.0, 0.0), (0.2, 0.0, 0.0)),
)


@given(st.floats(0.0, EXTRAPOLATED_MOST_S))
def test_the_law_uses_neighbours_where_they_are_now(age_s: float) -> None:
    """A neighbour with constant acceleration, less its slot: x + v a + u a^2 / 2, and v + u a."""
    state = neighbour_at(PeerState(MOVING, 1.0, 0.0, measured_s=1.0), 1.0 + age_s, 1)
    assert state.position_enu_m[0] == pytest.approx(2.5 + 1.5 * age_s + 0.4 * age_s**2)
    assert state.position_enu_m[1:] == pytest.approx((2.0 - age_s + 0.25 * age_s**2, 3.0 - 0.25 * age_s**2))
    assert state.velocity_enu_m_s == pytest.approx((1.5 + 0.8 * age_s, -1.0 + 0.5 * age_s, -0.5 * age_s))
    assert state.acceleration_enu_m_s2 == pytest.approx((0.8, 0.5, -0.5))


@pytest.mark.parametrize(("prc", "most_s"), [(1, 0.08), (3, 0.08), (4, 0.04), (100, 0.04)])
def test_states_are_extrapolated_by_two_ticks_at_most_and_by_four_near_the_leader(prc: int, most_s: float) -> None:
    state = PeerState(with_fields(MOVING, prc=prc), 1.0, 0.0, measured_s=1.0)
    longest, nearly = (neighbour_at(state, 1.0 + age_s, prc) for age_s in (most_s, most_s - 0.01))
    assert neighbour_at(state, 1.3, prc).position_enu_m == longest.position_enu_m != nearly.position_enu_m
    assert neighbour_at(state, 1.3, prc).age_s == pytest.approx(0.3)  # the law is told how old it is
    assert state.position_at(1.3)[0] == pytest.approx(1.0 + 2.0 * 0.3)  # what is kept apart is where it is


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"vehicle_id": 3}, Code.PEER_OWN_ID),
        ({"vehicle_id": 9}, Code.PEER_NOT_IN_FLEET),
        ({"formation_hash": 43}, Code.PEER_OTHER_FLEET_FILE),
        ({"role": Role.LEADER, "prc": 1}, Code.PEER_NOT_A_LEADER),
        ({"position_enu_m": (nan, 0.0, 0.0)}, Code.PEER_NOT_FINITE),
        ({"velocity_enu_m_s": (inf, 0.0, 0.0)}, Code.PEER_NOT_FINITE),
        ({"acceleration_enu_m_s2": (0.0, nan, 0.0)}, Code.PEER_NOT_FINITE),
        ({"state_age_s": nan}, Code.PEER_NOT_FINITE),
        ({"position_enu_m": (30_000.0, 0.0, 0.0)}, Code.PEER_POSITION_IMPLAUSIBLE),
        ({"velocity_enu_m_s": (20.0, 20.0, 0.0)}, Code.PEER_SPEED_IMPLAUSIBLE),
        ({"acceleration_enu_m_s2": (0.0, 0.0, 500.0)}, Code.PEER_ACCELERATION_IMPLAUSIBLE),
        ({"state_age_s": -0.5}, Code.PEER_TIME_IMPLAUSIBLE),
        ({"state_age_s": 1000.0}, Code.PEER_TIME_IMPLAUSIBLE),
        ({"slot": FlownSlot((9000.0, 0.0, 0.0))}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"slot": FlownSlot((nan, 0.0, 0.0))}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"slot": FlownSlot((0.0, 0.0, 0.0), (30.0, 0.0, 0.0))}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"slot": FlownSlot((0.0, 0.0, 0.0), (0.0, nan, 0.0))}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"slot": FlownSlot((0.0, 0.0, 0.0), formation=2, waiting=-1)}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"rft": ((nan, 0.0, 0.0), ZERO3, ZERO3)}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"rft": ((0.0, 2e5, 0.0), ZERO3, ZERO3)}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"rft": (ZERO3, (0.0, 0.0, 30.0), ZERO3)}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"rft": (ZERO3, ZERO3, (nan, 0.0, 0.0))}, Code.PEER_SLOT_IMPLAUSIBLE),
        ({"sent_s": inf}, Code.PEER_NOT_FINITE),
        ({"sent_s": -0.1}, Code.PEER_TIME_IMPLAUSIBLE),
        ({"sent_s": 1e10}, Code.PEER_TIME_IMPLAUSIBLE),
        ({"position_error": PositionError(nan, 0.1)}, Code.PEER_POSITION_ERROR_IMPLAUSIBLE),
        ({"position_error": PositionError(0.1, -0.1)}, Code.PEER_POSITION_ERROR_IMPLAUSIBLE),
        ({"prc": 0}, Code.PEER_PRC_IMPLAUSIBLE),
        ({"prc": 4}, Code.PEER_PRC_IMPLAUSIBLE),
        ({"prc": 1}, Code.PEER_PRC_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(2, 0, 100)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(9, 0, 100)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, -1, 100)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 2**63, 100)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 1, 100, claim=2)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 1, 100, claim=-1)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, nan)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, heading=Heading(nan))}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, heading=Heading(3.2))}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, heading=Heading(0.0, -5.1))}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, heading=Heading(0.0, 0.0, inf))}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, -0.1)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"beacon": LeaderBeacon(1, 0, 100, 1e9)}, Code.PEER_BEACON_IMPLAUSIBLE),
        ({"vehicle_id": 1, "prc": 2, "role": Role.LEADER}, Code.PEER_PRC_IMPLAUSIBLE),
        ({"vehicle_id": 1, "prc": 1, "role": Role.FOLLOWER}, Code.PEER_PRC_IMPLAUSIBLE),
        ({"vehicle_id": 1, "prc": 1, "role": Role.LEADER, "beacon": None}, Code.PEER_BEACON_MISSING),
    ],
)
def test_implausible_packet_is_counted_and_not_used(changes: dict[str, Any], code: Code) -> None:
    peers = table()
    assert rejections(peers, **changes) == [f"{code} {changes.get('vehicle_id', 2)}"]
    assert peers.in_time(1.0)[0] == {}


@given(st.tuples(*[st.floats()] * 3), st.tuples(*[st.floats()] * 3), st.floats(), st.integers())
def test_table_holds_only_finite_numbers(position: Any, velocity: Any, age: float, prc: int) -> None:
    peers = table()
    rejections(peers, position_enu_m=position, velocity_enu_m_s=velocity, state_age_s=age, prc=prc)
    for peer in peers.in_time(1.0)[0].values():
        assert all(abs(x) < 1e6 for x in peer.position_at(1.0))


@pytest.mark.parametrize(
    "changes",
    [
        {"slot": FlownSlot((-500.0, 0.0, 0.0))},
        {"slot": FlownSlot((-1.5, 0.0, 0.0), moves_for_s=-1.0)},
        {"slot": FlownSlot((nan, 0.0, 0.0))},
        {"velocity_enu_m_s": (24.0, 0.0, 0.0), "slot": FlownSlot((-1.5, 0.0, 0.0), (-24.0, 0.0, 0.0))},
    ],
)
def test_a_slot_is_checked_after_another_one_was_accepted(changes: dict[str, Any]) -> None:
    peers = table()
    assert rejections(peers) == []
    assert rejections(peers, 1.02, sequence=11) == []
    assert rejections(peers, 1.04, sequence=12, **changes) == [f"{Code.PEER_SLOT_IMPLAUSIBLE} 2"]


def test_the_speed_of_the_rft_is_checked_with_a_known_slot() -> None:
    peers, slot = table(), FlownSlot((-1.5, 0.0, 0.0), (20.0, 0.0, 0.0))
    assert rejections(peers, slot=slot) == []
    counted = rejections(peers, 1.02, sequence=11, slot=slot, velocity_enu_m_s=(-20.0, 0.0, 0.0))
    assert counted == [f"{Code.PEER_SLOT_IMPLAUSIBLE} 2"]


def test_of_a_packet_with_an_epoch_too_high_only_the_motion_is_used() -> None:
    """By repeated commands one vehicle had such an epoch, and its position was missing for separation for 48 s."""
    peers = table()
    leads = {"vehicle_id": 1, "prc": 1, "role": Role.LEADER, "beacon": LeaderBeacon(1, 1008, 100)}
    assert rejections(peers, **leads) == [f"{Code.PEER_EPOCH_TOO_HIGH} 1"]
    peer = peers.in_time(1.0)[0][1]
    assert peer.term == (0, 0)
    assert (peer.packet.role, peer.packet.leader.prc, peer.packet.leader.beacon) == (Role.FOLLOWER, 3, None)


SLOTS = ((1, (0.0, 0.0, 0.0)), (2, (-2.0, 0.0, 0.0)), (3, (-4.0, 0.0, 0.0)))
LEADS = {"vehicle_id": 1, "prc": 1, "role": Role.LEADER}


@pytest.mark.parametrize(
    ("change", "by"),
    [
        (FormationChange(1, SLOTS, 10.0, 5.0), {}),  # a follower passes on none
        (FormationChange(1, SLOTS[:2], 10.0, 5.0), LEADS),
        (FormationChange(1, (*SLOTS, SLOTS[0]), 10.0, 5.0), LEADS),
        (FormationChange(1, SLOTS, 10.0, 5.0, absent=(1, 2, 3)), LEADS),
        (FormationChange(1, SLOTS, 10.0, 5.0, absent=(9,)), LEADS),
    ],
)
def test_invalid_formation_change_is_not_used(change: FormationChange, by: dict[str, Any]) -> None:
    assert rejections(table(), change=FormationChange(1, SLOTS, 10.0, 5.0), **LEADS) == []
    peers = table()
    assert rejections(peers, change=change, **by)[0].startswith(Code.PEER_CHANGE_IMPLAUSIBLE)
    assert peers.in_time(1.0)[0] == {}


def test_permitted_leader_is_accepted_in_either_role() -> None:
    peers = table()
    assert rejections(peers, vehicle_id=1, role=Role.LEADER, prc=1) == []
    assert rejections(peers, vehicle_id=1, role=Role.FOLLOWER, prc=2, sequence=11) == []
    assert peers.in_time(1.0)[0][1].packet.role is Role.FOLLOWER


def test_stale_peer_is_not_fresh() -> None:
    peers = table()
    rejections(peers)
    assert 2 in peers.in_time(1.28)[0]
    assert 2 not in peers.in_time(1.31)[0]  # 0.01 s old when it was sent


def test_replayed_and_reordered_packets_are_refused() -> None:
    peers = table()
    rejections(peers)
    assert rejections(peers, 1.02) == [f"{Code.PEER_OUT_OF_ORDER} 2"]
    assert rejections(peers, 1.02, sequence=9) == [f"{Code.PEER_OUT_OF_ORDER} 2"]
    assert peers.rejected.total() == 2


def test_restarted_peer_is_accepted_when_its_old_session_is_stale() -> None:
    peers = table()
    rejections(peers)
    assert rejections(peers, 1.02, session=78, sequence=1) == [f"{Code.PEER_ID_TWICE} 2"]
    rejections(peers, 2.0, session=78, sequence=2)
    assert peers.in_time(2.0)[0][2].packet.sender.session == 78


def test_position_jump_is_refused_until_the_old_state_is_stale() -> None:
    peers = table()
    rejections(peers)
    assert rejections(peers, 1.02, sequence=11, position_enu_m=(60.0, 2.0, 3.0)) == [f"{Code.PEER_POSITION_JUMPED} 2"]
    rejections(peers, 1.5, sequence=30, position_enu_m=(60.0, 2.0, 3.0))
    assert peers.in_time(1.5)[0][2].packet.motion.position_enu_m[0] == 60.0


class DelayedLink:
    """A peer's packets to this vehicle at 50 Hz, with another clock offset."""

    def __init__(self, drift: float = 0.0) -> None:
        self.peers, self.drift, self.sent = table(), drift, 0

    def send(self, delay_s: float, ticks: int = 1, **changes: Any) -> list[str]:
        for _ in range(ticks):
            self.sent += 1
            self.sent_s = 0.02 * self.sent
            stamp_s = 8000.0 + self.sent_s * (1.0 + self.drift)
            reasons = rejections(
                self.peers, self.sent_s + delay_s, **{"sequence": self.sent, "sent_s": stamp_s} | changes
            )
        return reasons

    def fresh(self, after_s: float) -> dict[int, PeerState]:
        """Receive at this time after the last packet was sent."""
        return self.peers.in_time(self.sent_s + after_s)[0]


def test_additional_delay_increases_the_age() -> None:
    link = DelayedLink()
    assert link.send(0.1, ticks=50) == []
    assert link.sent_s + 0.1 - link.fresh(0.1)[2].measured_s == pytest.approx(0.01, abs=1e-9)  # as without any delay
    assert link.send(0.25) == []
    state = link.fresh(0.25)[2]
    assert link.sent_s + 0.25 - state.measured_s == pytest.approx(0.01 + 0.15, abs=1e-4)
    assert state.position_at(link.sent_s + 0.25)[0] == pytest.approx(1.0 + 0.5 * 0.16, abs=1e-4)
    assert link.fresh(0.41) == {}


def test_packet_delayed_by_five_seconds_is_refused() -> None:
    link = DelayedLink()
    link.send(0.01, ticks=50)
    assert link.send(5.0, ticks=500) == [f"{Code.PEER_LATE} 2"]  # for ten seconds, also its leader beacon
    assert link.peers.rejected.total() == 500
    assert link.fresh(5.0) == {}
    link.send(0.01)
    assert 2 in link.fresh(0.02)


def test_packets_queued_before_the_start_are_detected_as_old() -> None:
    link = DelayedLink()
    link.send(3.0, ticks=3)
    link.send(0.01, ticks=5)
    assert f"{Code.PEER_LATE} 2" in link.send(3.0)


def test_queued_packets_are_used_at_their_true_age() -> None:
    link = DelayedLink()
    link.send(3.0, ticks=3)
    link.send(0.01, ticks=6)
    assert link.sent_s + 0.01 - link.fresh(0.01)[2].measured_s == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize("established", [1, 10, 100])
@pytest.mark.parametrize(
    "wrong",
    [
        {"sequence": 2**62},
        {"sequence": 2**62, "session": 2**62},
        {"sequence": 400},
        {"sent_s": 1e9},
        {"sent_s": 8100.0},
        {"sent_s": 0.0},
        {"state_age_s": 9.0},
        {"sequence": 2**62, "sent_s": 1e9, "state_age_s": 9.0},
    ],
)
def test_one_wrong_packet_locks_no_peer_out(wrong: dict[str, Any], established: int) -> None:
    link = DelayedLink()
    link.send(0.01, ticks=established)
    link.send(0.01, **wrong)
    link.send(0.01, ticks=40)
    state = link.fresh(0.01)[2]
    assert state.packet.sender.sequence == link.sent
    assert link.sent_s + 0.01 - state.measured_s == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize("sequence", [700, 2**40, 2**62])
def test_a_sequence_far_ahead_costs_no_true_packet(sequence: int) -> None:
    link = DelayedLink()
    link.send(0.01, ticks=50)
    assert link.send(0.01, sequence=sequence) == [f"{Code.PEER_OUT_OF_ORDER} 2"]
    link.send(0.01)
    assert link.fresh(0.01)[2].packet.sender.sequence == link.sent


@pytest.mark.parametrize("wrong", [{"sequence": 2**62}, {"sent_s": 1e9}, {"sent_s": 0.0}, {"session": 5}])
def test_a_wrong_first_packet_locks_no_peer_out(wrong: dict[str, Any]) -> None:
    link = DelayedLink()
    link.send(0.01, **wrong)
    link.send(0.01, ticks=50)
    assert link.fresh(0.01)[2].packet.sender.sequence == link.sent


def ages_s(link: DelayedLink, ticks: int) -> list[float]:
    """Age of the peer's state 10 ms after each of its next packets, in which it is 10 ms old, without any delay; inf: stale."""
    ages = []
    for _ in range(ticks):
        link.send(0.01)
        peers = link.fresh(0.02)
        ages.append(link.sent_s + 0.02 - peers[2].measured_s if 2 in peers else inf)
    return ages


@pytest.mark.parametrize("early_s", [0.004, 0.03, 0.0999])
def test_one_early_packet_costs_5_ms_of_age(early_s: float) -> None:
    link = DelayedLink()
    link.send(0.01, ticks=100)
    link.send(0.01, sent_s=8000.0 + 0.02 * (link.sent + 1) + early_s)
    assert link.fresh(0.01)[2].measured_s == pytest.approx(link.sent_s)  # used, and not from the future
    assert max(ages_s(link, 100)) < 0.02 + 0.0051


@pytest.mark.parametrize("established", [1, 2, 5, 25, 100])
@pytest.mark.parametrize("packets", [1, 2, 3, 5, 10])
@pytest.mark.parametrize("early_s", [0.003, 0.03, 0.0965, 0.0995, 0.29, 0.299])
def test_early_packets_make_no_peer_old_for_long(early_s: float, packets: int, established: int) -> None:
    """Each is earlier than the one before by as much."""
    link = DelayedLink()
    link.send(0.01, ticks=established)
    for k in range(1, packets + 1):
        link.send(0.01, sent_s=8000.0 + 0.02 * (link.sent + 1) + early_s * k)
    assert max(ages_s(link, 100)[27:]) <= 0.02 + 0.0201


@pytest.mark.parametrize("early_s", [0.05, 0.29, 0.299, 5.0])
def test_an_early_first_packet_makes_no_peer_old_for_long(early_s: float) -> None:
    link = DelayedLink()
    link.send(0.01, sent_s=8000.02 + early_s)
    assert max(ages_s(link, 100)[27:]) <= 0.0201


def test_congestion_that_lasts_is_seen() -> None:
    link = DelayedLink()
    link.send(0.01, ticks=50)
    for _ in range(60 * 50):
        link.send(0.21)
        assert (
            link.sent_s + 0.21 - link.fresh(0.21)[2].measured_s > 0.01 + 0.19 - 0.013
        )  # 200 ms, less the clocks' drift


def test_the_age_is_right_soon_after_a_congestion_at_the_start() -> None:
    link = DelayedLink()
    link.send(0.09, ticks=50)
    assert min(ages_s(link, 10)) >= 0.02 - 1e-9  # never from the future
    link.send(0.09)
    assert link.sent_s + 0.09 - link.fresh(0.09)[2].measured_s == pytest.approx(0.01 + 0.08, abs=1e-3)


def test_accelerations_are_used_within_the_fleet_s_limits() -> None:
    peers = table()
    slot = FlownSlot((-1.5, 0.0, 0.0), acceleration_enu_m_s2=(0.0, 0.0, -90.0))
    rft = (ZERO3, ZERO3, (0.0, -90.0, 0.0))
    counted = rejections(peers, acceleration_enu_m_s2=(60.0, 80.0, 0.0), slot=slot, rft=rft)
    assert counted == [f"{Code.PEER_ACCELERATION_LIMITED} 2"]
    packet = peers.in_time(1.0)[0][2].packet
    assert packet.motion.acceleration_enu_m_s2 == pytest.approx((4.8, 6.4, 0.0))
    assert packet.slot.acceleration_enu_m_s2 == pytest.approx((0.0, 0.0, -8.0))
    assert packet.rft is not None
    assert packet.rft[2] == pytest.approx((0.0, -8.0, 0.0))
    assert packet.motion.position_enu_m == GOOD.motion.position_enu_m


def test_clock_offset_is_measured_again_after_a_restart() -> None:
    link = DelayedLink()
    link.send(0.01, ticks=50)
    link.sent += 100  # silent while it starts
    assert link.send(0.01, session=78, sent_s=3.0) == []
    assert 2 in link.fresh(0.02)


@pytest.mark.parametrize("drift", [-1e-4, 1e-4])
def test_clock_drift_does_not_increase_the_age(drift: float) -> None:
    link = DelayedLink(drift)
    assert link.send(0.01, ticks=60_000) == []  # 20 minutes, in which they come 0.12 s apart
    assert link.sent_s + 0.01 - link.fresh(0.01)[2].measured_s == pytest.approx(0.01, abs=1e-3)


def peer_at(x_m: float) -> PeerState:
    """At rest, as of 1 s."""
    packet = with_fields(GOOD, position_enu_m=(x_m, 0.0, 0.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
    return PeerState(packet, 1.0, 0.0, 1.0)


def without_leader(x_m: float) -> PeerState:
    """The same, without a leader beacon."""
    peer = peer_at(x_m)
    return replace(peer, packet=with_fields(peer.packet, beacon=None))


def test_neighbours_by_edges() -> None:
    rule = EdgeRule(2, [(1, 2), (2, 3), (3, 4)])
    everyone = dict.fromkeys((1, 3, 4), peer_at(0.0))
    assert rule.select((0.0, 0.0, 0.0), everyone, 1.0) == (1, 3)
    del everyone[1]
    assert rule.select((0.0, 0.0, 0.0), everyone, 1.0) == (3,)


def test_neighbours_by_range_with_hysteresis() -> None:
    rule = RangeRule(3.0, 0.5)
    own = (0.0, 0.0, 0.0)
    seen = [rule.select(own, {7: without_leader(x)}, 1.0) for x in (3.2, 3.0, 3.4, 3.6, 3.4, 2.9)]
    assert seen == [(), (7,), (7,), (), (), (7,)]
    assert rule.select(own, {}, 1.0) == ()


def test_beyond_the_range_the_nearest_that_leads_to_the_leader_is_a_neighbour() -> None:
    rule = RangeRule(3.0, 0.5)
    own, near = (0.0, 0.0, 0.0), without_leader(2.0)
    assert rule.select(own, {3: near, 7: peer_at(9.0)}, 0.9) == (3,)  # none has ever led to the leader
    assert rule.select(own, {3: peer_at(2.0), 7: peer_at(9.0)}, 1.9) == (3,)  # a neighbour does
    assert rule.select(own, {3: near, 7: peer_at(9.0)}, 1.9 + 0.9 * BRIDGES_AFTER_S) == (3,)
    far = {3: near, 5: without_leader(4.0), 7: peer_at(9.0), 8: peer_at(7.0)}
    assert rule.select(own, far, 2.0 + BRIDGES_AFTER_S) == (3, 8)
    bridged = [rule.select(own, {3: peer_at(2.0), 8: peer_at(7.0)}, now_s) for now_s in (2.3, 2.2 + BRIDGED_S)]
    assert bridged == [(3, 8), (3, 8)]  # 3 may have its beacon from this vehicle alone
    assert rule.select(own, {3: peer_at(2.0), 8: peer_at(7.0)}, 2.3 + BRIDGED_S) == (3,)
    assert rule.select(own, {3: near, 5: peer_at(5.0), 8: peer_at(7.0)}, 20.0) == (3, 5)
    assert rule.select(own, {3: near, 8: peer_at(7.0)}, 20.1) == (3, 8)  # 5 is silent
    assert rule.select(own, {3: near}, 20.2) == (3,)
