"""Relayed terms count with the signature of their leader, of this agent of it; each is verified once."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from common import AT_REST, ROOT, count_calls, with_fields
from companion.link.fleet.term_proofs import AFTER_FALSE_S, KEPT, NEW_FOR_PACKETS, TermProofs
from companion.security.admission import new_key
from companion.types.flight import Role
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import PeerPacket, ReceivedPeerPacket, TermProof
from secured_fleet import admitted_vehicles
from sitl.flight.scenario import load_scenario

FLEET = load_scenario(ROOT / "config" / "scenarios" / "four_in_line.yaml", ()).fleet
KEYS = {i: new_key() for i in (1, 2, 3, 4)}
ADMITTED = admitted_vehicles(FLEET.name, KEYS)
CLAIM = LeaderBeacon(2, 1, 100, 5.0, 1)
UNPROVEN = f"{Code.PEER_TERM_UNPROVEN} 3"


class Vehicle:
    def __init__(self, vehicle_id: int, session: int = 1, submit: Callable[..., object] = lambda job: job()) -> None:
        self.vehicle_id, self.session, self.now_s, self.sequence = vehicle_id, session, 10.0, 0
        self.rejected: list[str] = []
        self.proofs = TermProofs(vehicle_id, FLEET, KEYS[vehicle_id], ADMITTED, self.rejected.append, submit)

    def packet(self, beacon: LeaderBeacon | None, proof: TermProof | None = None) -> PeerPacket:
        """A packet of this vehicle, before it is published."""
        self.sequence += 1
        leads = beacon is not None and beacon.leader_id == self.vehicle_id
        return with_fields(
            AT_REST,
            vehicle_id=self.vehicle_id,
            session=self.session,
            sequence=self.sequence,
            role=Role.LEADER if leads else Role.FOLLOWER,
            beacon=beacon,
            proof=proof,
        )

    def published(self, beacon: LeaderBeacon | None) -> PeerPacket:
        return self.proofs.attach(self.packet(beacon))

    def states(self, beacon: LeaderBeacon) -> TermProof:
        """Its signature for this term: the second packet has it, as it is made outside the tick."""
        assert self.published(beacon).leader.proof is None
        proof = self.published(beacon).leader.proof
        assert proof is not None
        return proof

    def believes(self, packet: PeerPacket) -> bool:
        self.now_s += 0.02
        return self.proofs.judge(ReceivedPeerPacket(self.now_s, packet)).proven


def test_the_leaders_own_packet_needs_no_signature() -> None:
    assert Vehicle(4).believes(Vehicle(2).packet(CLAIM))


def test_a_relayed_claim_counts_with_the_signature_of_its_leader() -> None:
    leader, relay, last = Vehicle(2), Vehicle(3), Vehicle(4)
    assert leader.states(CLAIM)
    assert relay.believes(leader.published(CLAIM))
    assert last.believes(relay.published(CLAIM))
    assert last.believes(relay.packet(CLAIM))  # also without it, once it is known
    assert not last.rejected


@pytest.mark.parametrize(
    "beacon",
    [LeaderBeacon(2, 2, 100, 5.0, 1), LeaderBeacon(2, 1, 100, 5.0, 0), LeaderBeacon(1, 1, 100, 5.0, 1)],
    ids=["another epoch", "a command", "another leader"],
)
def test_a_signature_is_good_for_its_own_term_alone(beacon: LeaderBeacon) -> None:
    proof, last = Vehicle(2).states(CLAIM), Vehicle(4)
    assert not last.believes(Vehicle(3).packet(beacon, proof))
    assert last.rejected == [UNPROVEN]
    last.now_s += 1.0
    assert last.believes(Vehicle(3).packet(CLAIM, proof))


@pytest.mark.parametrize("proof", [None, TermProof(1, bytes(64)), TermProof(1, b"\xff" * 64), TermProof(1, b"short")])
def test_hearsay_without_a_good_signature_does_not_count(proof: TermProof | None) -> None:
    last = Vehicle(4)
    assert not last.believes(Vehicle(3).packet(CLAIM, proof))
    assert last.rejected == [UNPROVEN]


def test_another_vehicle_cannot_sign_for_the_leader() -> None:
    liar, last = Vehicle(3), Vehicle(4)
    own = liar.states(LeaderBeacon(3, 1, 100, 5.0, 1))
    assert not last.believes(liar.packet(CLAIM, own))


def test_what_a_leader_stated_in_an_earlier_flight_does_not_count_again() -> None:
    old = Vehicle(2, session=1).states(CLAIM)
    last, liar = Vehicle(4), Vehicle(3)
    assert last.believes(Vehicle(2, session=2).packet(None))  # on the ground before take-off
    assert not last.believes(liar.packet(CLAIM, old))
    last = Vehicle(4)
    assert last.believes(liar.packet(CLAIM, old))  # it has never heard the leader itself
    assert last.believes(Vehicle(2, session=2).packet(None))
    assert not last.believes(liar.packet(CLAIM, old))


def test_nobody_else_tells_a_vehicle_that_it_leads() -> None:
    old = Vehicle(2).states(CLAIM)
    assert not Vehicle(2).believes(Vehicle(3).packet(CLAIM, old))


def test_the_term_of_the_fleet_file_needs_no_signature() -> None:
    leader = Vehicle(1)
    beacon = LeaderBeacon(1, 0, 100, 5.0)
    assert [leader.published(beacon).leader.proof for _ in range(3)] == [None] * 3
    assert Vehicle(4).believes(Vehicle(3).packet(beacon))


def test_each_term_is_verified_once_and_a_liar_costs_ten_a_second() -> None:
    jobs: list[Callable[[], None]] = []
    last, proof = Vehicle(4, submit=jobs.append), Vehicle(2).states(CLAIM)
    relays = [Vehicle(1), Vehicle(3)]
    assert not any(last.believes(relay.packet(CLAIM, proof)) for relay in relays * 3)
    assert len(jobs) == 1  # one is at work, for all that bring it
    assert not last.rejected
    jobs.pop()()
    assert all(last.believes(relay.packet(CLAIM, proof)) for relay in relays * 3)
    assert not jobs
    began_s = last.now_s
    for number in range(100):
        last.believes(Vehicle(3).packet(LeaderBeacon(2, 5, 1, 5.0), TermProof(1, number.to_bytes(64))))
        while jobs:
            jobs.pop()()
            number_verified = 1 + int((last.now_s - began_s) / AFTER_FALSE_S)
    assert number_verified <= 21


def test_the_signature_is_sent_with_a_new_term_and_then_at_5_hz() -> None:
    leader = Vehicle(2)
    leader.states(CLAIM)
    sent = [leader.published(CLAIM).leader.proof is not None for _ in range(NEW_FOR_PACKETS + 100)]
    assert all(sent[: NEW_FOR_PACKETS - 1])
    assert sum(sent[NEW_FOR_PACKETS:]) == 10


def test_a_known_term_costs_a_packet_few_calls() -> None:
    last = Vehicle(4)
    packet = ReceivedPeerPacket(1.0, Vehicle(3).packet(CLAIM, Vehicle(2).states(CLAIM)))
    assert last.proofs.judge(packet).proven
    with count_calls() as work:
        last.proofs.judge(packet)
    assert work.calls <= 12


def test_a_vehicle_that_is_no_longer_admitted_proves_nothing() -> None:
    last, proof = Vehicle(4), Vehicle(2).states(CLAIM)
    assert last.believes(Vehicle(3).packet(CLAIM, proof))
    last.proofs.admit(admitted_vehicles(FLEET.name, {i: KEYS[i] for i in (1, 3, 4)}))
    assert not last.believes(Vehicle(3).packet(CLAIM, proof))


def test_the_newest_terms_of_a_leader_are_kept() -> None:
    leader, last = Vehicle(2), Vehicle(4)
    terms = [LeaderBeacon(2, epoch, 1, 5.0) for epoch in range(1, 3 * KEPT)]
    proofs = [leader.states(beacon) for beacon in terms]
    assert all(last.believes(Vehicle(3).packet(*one)) for one in zip(terms, proofs, strict=True))
    assert last.believes(Vehicle(3).packet(terms[-KEPT]))
    assert not last.believes(Vehicle(3).packet(terms[-KEPT - 1]))
