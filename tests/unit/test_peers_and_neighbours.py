"""What reaches the law from outside, and what never does."""

from math import inf, nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.neighbours import EdgeRule, RangeRule
from companion.core.peers import PeerState, PeerTable
from companion.types import (
    FlightPhase,
    FlownSlot,
    FormationChange,
    Heading,
    LeaderWord,
    PeerPacket,
    PositionError,
    ReceivedPeerPacket,
    Role,
)

MAY_LEAD = {1: True, 2: False, 3: False}
GOOD = PeerPacket(
    vehicle_id=2,
    session=77,
    sequence=10,
    formation_hash=42,
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    position_enu_m=(1.0, 2.0, 3.0),
    velocity_enu_m_s=(0.5, 0.0, 0.0),
    acceleration_enu_m_s2=(0.0, 0.0, 0.0),
    state_age_s=0.01,
    sent_s=501.0,
    prc=2,
    leader_word=LeaderWord(1, 0, 20),
    slot=FlownSlot((-1.5, 0.0, 0.0)),
)


def table() -> PeerTable:
    return PeerTable(own_id=3, may_lead=MAY_LEAD, formation_hash=42, max_age_s=0.3, max_speed_m_s=25.0, successors=(1,))


def heard(peers: PeerTable, received_s: float = 1.0, **changes: Any) -> list[str]:
    """Fold one packet that was not held up; the reasons of refusal counted so far."""
    packet = replace(GOOD, **{"sent_s": 500.0 + received_s} | changes)
    peers.fold([ReceivedPeerPacket(received_s, packet)], epoch=7)
    return list(peers.rejected)


def test_a_good_packet_is_believed() -> None:
    peers = table()
    assert heard(peers) == []
    assert peers.fresh(1.1)[2].position_at(1.1) == pytest.approx((1.055, 2.0, 3.0))  # 0.11 s at 0.5 m/s


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"vehicle_id": 3}, "own id"),
        ({"vehicle_id": 9}, "not in the fleet file"),
        ({"formation_hash": 43}, "another fleet file"),
        ({"role": Role.LEADER, "prc": 1}, "claims to be leader"),
        ({"position_enu_m": (nan, 0.0, 0.0)}, "not finite"),
        ({"velocity_enu_m_s": (inf, 0.0, 0.0)}, "not finite"),
        ({"acceleration_enu_m_s2": (0.0, nan, 0.0)}, "not finite"),
        ({"state_age_s": nan}, "not finite"),
        ({"position_enu_m": (30_000.0, 0.0, 0.0)}, "position not plausible"),
        ({"velocity_enu_m_s": (20.0, 20.0, 0.0)}, "speed not plausible"),
        ({"acceleration_enu_m_s2": (0.0, 0.0, 500.0)}, "acceleration not plausible"),
        ({"state_age_s": -0.5}, "future"),
        ({"sent_s": inf}, "not finite"),
        ({"sent_s": -0.1}, "time of sending"),
        ({"sent_s": 1e10}, "time of sending"),
        ({"position_error": PositionError(nan, 0.1)}, "position error"),
        ({"position_error": PositionError(0.1, -0.1)}, "position error"),
        ({"prc": 0}, "PrC"),
        ({"prc": 4}, "PrC"),
        ({"prc": 1}, "PrC"),
        ({"leader_word": LeaderWord(2, 0, 100)}, "leader's word"),
        ({"leader_word": LeaderWord(9, 0, 100)}, "leader's word"),
        ({"leader_word": LeaderWord(1, -1, 100)}, "leader's word"),
        ({"leader_word": LeaderWord(1, 1008, 100)}, "its leader's epoch is too far ahead"),
        ({"leader_word": LeaderWord(1, 2**63, 100)}, "its leader's epoch is too far ahead"),
        ({"leader_word": LeaderWord(1, 1, 100, claim=2)}, "leader's word"),
        ({"leader_word": LeaderWord(1, 1, 100, claim=-1)}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, nan)}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, heading=Heading(nan))}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, heading=Heading(3.2))}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, heading=Heading(0.0, -5.1))}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, heading=Heading(0.0, 0.0, inf))}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, -0.1)}, "leader's word"),
        ({"leader_word": LeaderWord(1, 0, 100, 1e9)}, "leader's word"),
        ({"vehicle_id": 1, "prc": 2, "role": Role.LEADER}, "PrC"),
        ({"vehicle_id": 1, "prc": 1, "role": Role.FOLLOWER}, "PrC"),
        ({"vehicle_id": 1, "prc": 1, "role": Role.LEADER, "leader_word": None}, "without a word of its own"),
    ],
)
def test_what_cannot_be_true_is_counted_and_never_used(changes: dict[str, Any], reason: str) -> None:
    peers = table()
    rejected = heard(peers, **changes)
    assert len(rejected) == 1
    assert reason in rejected[0]
    assert peers.fresh(1.0) == {}


@given(st.tuples(*[st.floats()] * 3), st.tuples(*[st.floats()] * 3), st.floats(), st.integers())
def test_whatever_comes_the_table_holds_only_finite_numbers(position: Any, velocity: Any, age: float, prc: int) -> None:
    peers = table()
    heard(peers, position_enu_m=position, velocity_enu_m_s=velocity, state_age_s=age, prc=prc)
    for peer in peers.fresh(1.0).values():
        assert all(abs(x) < 1e6 for x in peer.position_at(1.0))


SLOTS = ((1, (0.0, 0.0, 0.0)), (2, (-2.0, 0.0, 0.0)), (3, (-4.0, 0.0, 0.0)))
LEADS = {"vehicle_id": 1, "prc": 1, "role": Role.LEADER}


@pytest.mark.parametrize(
    ("change", "by"),
    [
        (FormationChange(1, SLOTS, 10.0, 5.0), {}),  # a follower passes on none
        (FormationChange(1, SLOTS[:2], 10.0, 5.0), LEADS),
        (FormationChange(1, (*SLOTS, SLOTS[0]), 10.0, 5.0), LEADS),
        (FormationChange(1, ((1, (nan, 0.0, 0.0)), *SLOTS[1:]), 10.0, 5.0), LEADS),
        (FormationChange(1, ((1, (0.0, 3e4, 0.0)), *SLOTS[1:]), 10.0, 5.0), LEADS),
        (FormationChange(-1, SLOTS, 10.0, 5.0), LEADS),
        (FormationChange(1, SLOTS, nan, 5.0), LEADS),
        (FormationChange(1, SLOTS, 10.0, inf), LEADS),
    ],
)
def test_a_formation_passed_on_that_cannot_be_is_never_used(change: FormationChange, by: dict[str, Any]) -> None:
    assert heard(table(), change=FormationChange(1, SLOTS, 10.0, 5.0), **LEADS) == []
    peers = table()
    assert "formation passed on not plausible" in heard(peers, change=change, **by)[0]
    assert peers.fresh(1.0) == {}


def test_who_may_lead_is_believed_in_either_role() -> None:
    peers = table()
    assert heard(peers, vehicle_id=1, role=Role.LEADER, prc=1) == []
    assert heard(peers, vehicle_id=1, role=Role.FOLLOWER, prc=2, sequence=11) == []
    assert peers.fresh(1.0)[1].packet.role is Role.FOLLOWER


def test_a_stale_peer_drops_out() -> None:
    peers = table()
    heard(peers)
    assert 2 in peers.fresh(1.28)
    assert 2 not in peers.fresh(1.31)  # 0.01 s old when it was sent


def test_replayed_and_overtaken_packets_are_refused() -> None:
    peers = table()
    heard(peers)
    assert "replayed" in heard(peers, 1.02)[0]
    assert "replayed" in heard(peers, 1.02, sequence=9)[0]
    assert peers.rejected.total() == 2


def test_a_restarted_peer_is_believed_once_its_old_life_is_stale() -> None:
    peers = table()
    heard(peers)
    assert "two vehicles" in heard(peers, 1.02, session=78, sequence=1)[0]
    heard(peers, 2.0, session=78, sequence=2)
    assert peers.fresh(2.0)[2].packet.session == 78


def test_a_jump_is_refused_until_the_old_state_is_stale() -> None:
    peers = table()
    heard(peers)
    assert "jumped" in heard(peers, 1.02, sequence=11, position_enu_m=(60.0, 2.0, 3.0))[0]
    heard(peers, 1.5, sequence=30, position_enu_m=(60.0, 2.0, 3.0))
    assert peers.fresh(1.5)[2].packet.position_enu_m[0] == 60.0


class Way:
    """How a peer's packets come to this vehicle, 50 a second; the sender's clock began somewhere else."""

    def __init__(self, drift: float = 0.0) -> None:
        self.peers, self.drift, self.sent = table(), drift, 0

    def send(self, delay_s: float, ticks: int = 1, **changes: Any) -> list[str]:
        for _ in range(ticks):
            self.sent += 1
            self.sent_s = 0.02 * self.sent
            told_s = 8000.0 + self.sent_s * (1.0 + self.drift)
            reasons = heard(self.peers, self.sent_s + delay_s, sequence=self.sent, **{"sent_s": told_s} | changes)
        return reasons

    def fresh(self, after_s: float) -> dict[int, PeerState]:
        """So long after the last packet was sent."""
        return self.peers.fresh(self.sent_s + after_s)


def test_a_constant_delay_cannot_be_seen_and_one_more_s_is_a_second_of_age() -> None:
    way = Way()
    assert way.send(0.1, ticks=50) == []
    assert way.sent_s + 0.1 - way.fresh(0.1)[2].measured_s == pytest.approx(0.01, abs=1e-9)  # as without any delay
    assert way.send(0.25) == []
    state = way.fresh(0.25)[2]
    assert way.sent_s + 0.25 - state.measured_s == pytest.approx(0.01 + 0.15, abs=1e-4)
    assert state.position_at(way.sent_s + 0.25)[0] == pytest.approx(1.0 + 0.5 * 0.16, abs=1e-4)
    assert way.fresh(0.41) == {}


def test_what_comes_in_order_but_five_seconds_late_is_refused() -> None:
    way = Way()
    way.send(0.01, ticks=50)
    assert way.send(5.0, ticks=500) == ["peer 2: comes too late"]  # for ten seconds, word of its leader and all
    assert way.peers.rejected.total() == 500
    assert way.fresh(5.0) == {}
    way.send(0.01)
    assert 2 in way.fresh(0.02)


def test_packets_that_waited_before_the_first_look_are_found_out_by_the_next() -> None:
    way = Way()
    way.send(3.0, ticks=3)
    way.send(0.01)
    assert way.send(3.0) == ["peer 2: comes too late"]


def test_a_restarted_peer_has_another_clock() -> None:
    way = Way()
    way.send(0.01, ticks=50)
    way.sent += 100  # silent while it starts
    assert way.send(0.01, session=78, sent_s=3.0) == []
    assert 2 in way.fresh(0.02)


@pytest.mark.parametrize("drift", [-1e-4, 1e-4])
def test_clocks_that_drift_apart_do_not_make_a_peer_old(drift: float) -> None:
    way = Way(drift)
    assert way.send(0.01, ticks=180_000) == []  # an hour, in which they come 0.36 s apart
    assert way.sent_s + 0.01 - way.fresh(0.01)[2].measured_s == pytest.approx(0.01, abs=1e-3)


def test_edges() -> None:
    rule = EdgeRule(2, [(1, 2), (2, 3), (3, 4)])
    everyone = dict.fromkeys((1, 3, 4), (0.0, 0.0, 0.0))
    assert rule.select((0.0, 0.0, 0.0), everyone) == (1, 3)
    del everyone[1]
    assert rule.select((0.0, 0.0, 0.0), everyone) == (3,)


def test_range_with_hysteresis() -> None:
    rule = RangeRule(3.0, 0.5)
    own = (0.0, 0.0, 0.0)
    seen = [rule.select(own, {7: (x, 0.0, 0.0)}) for x in (3.2, 3.0, 3.4, 3.6, 3.4, 2.9)]
    assert seen == [(), (7,), (7,), (), (), (7,)]
    assert rule.select(own, {}) == ()
