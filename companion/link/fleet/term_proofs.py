"""Hearsay about who leads: in a fleet with identities a relayed term counts only with the signature of its leader.

A packet that names its own sender as leader needs none: the network has authenticated it. What a vehicle passes on of another
one, a signature must confirm, or any admitted vehicle could depose the leader. So a leader signs each of its terms once, and
who relays its beacon relays the signature. The term of the fleet file needs none, as it is the oldest.

Signatures are made and verified in a thread, each term once: not in a tick, and no liar makes anybody verify more often.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import inf
from typing import TYPE_CHECKING

from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.core.consensus.neighbours import LOW_RATE_TICKS
from companion.security.names import ParticipantRole
from companion.security.terms import TermStatement, is_signed, sign_term
from companion.types.formation import LeaderBeacon, Term
from companion.types.notices import Code
from companion.types.peers import PeerPacket, ReceivedPeerPacket, TermProof
from companion.types.rejections import rejection_key

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

    from companion.security.admission import Admitted

CONFIGURED: Term = (0, 0)  # that of the fleet file
NEW_FOR_PACKETS = 50  # so often in a row the proof of a new term is sent, then at 5 Hz
AFTER_FALSE_S = 0.1  # no other signature from a sender is verified so long after a false one
KEPT = 8  # newest proofs of each leader

Job = Callable[[], None]
_Claim = tuple[int, Term, TermProof]  # a leader, its term, and what is to prove it


class TermProofs:
    """The signatures that one vehicle has verified, and its own. `submit` runs a job outside the tick."""

    def __init__(
        self,
        own_id: int,
        fleet: FleetConfig,
        key: EllipticCurvePrivateKey,
        admitted: Admitted,
        reject: Callable[[str], None],
        submit: Callable[[Job], object] | None = None,
    ) -> None:
        """`key` is this vehicle's own, `reject` gets the counter's key for each term that is no more than hearsay."""
        self._own_id, self._fleet_name, self._formation_hash = own_id, fleet.name, fleet.formation_hash()
        self._key, self._admitted, self._reject = key, admitted, reject
        self._submit = submit or ThreadPoolExecutor(1, thread_name_prefix="terms").submit
        self._proven: dict[int, dict[Term, TermProof]] = {}  # by leader
        self._sessions: dict[int, int] = {}  # of each vehicle, as it was last heard itself
        self._busy: set[int] = set()  # senders whose proof is being verified; the own id: the own term is being signed
        self._pending: set[_Claim] = set()  # those being verified
        self._false: dict[int, tuple[_Claim, float]] = {}  # the last false one of each sender, and when
        self._sent: tuple[int, Term, int] = (0, CONFIGURED, 0)  # leader, term, in how many packets

    def judge(self, received: ReceivedPeerPacket) -> ReceivedPeerPacket:
        """The packet, marked where its beacon is hearsay. Never blocks."""
        packet = received.packet
        sender_id, beacon, proof = packet.sender.vehicle_id, packet.leader.beacon, packet.leader.proof
        self._sessions[sender_id] = packet.sender.session
        if beacon is None or beacon.term == CONFIGURED:
            return received
        known = self._proof_of(beacon.leader_id, beacon.term)
        if known is None and proof is not None:
            self._consider(received.received_s, sender_id, beacon, proof)
            known = self._proof_of(beacon.leader_id, beacon.term)
        if known is not None or beacon.leader_id == sender_id:
            return received
        if sender_id not in self._busy and (beacon.leader_id, beacon.term, proof) not in self._pending:
            self._reject(rejection_key(Code.PEER_TERM_UNPROVEN, sender_id))
        return ReceivedPeerPacket(received.received_s, packet, False)

    def attach(self, packet: PeerPacket) -> PeerPacket:
        """The own packet, with the proof of the term in its beacon where that is new, and each tenth time. Never blocks."""
        beacon, sender = packet.leader.beacon, packet.sender
        self._sessions[self._own_id] = sender.session
        if beacon is None or beacon.term == CONFIGURED:
            return packet
        proof = self._proof_of(beacon.leader_id, beacon.term)
        if proof is None:
            if beacon.leader_id == self._own_id:
                self._sign(sender.session, beacon)
            return packet
        leader_id, term, packets = self._sent
        packets = packets + 1 if (leader_id, term) == (beacon.leader_id, beacon.term) else 1
        self._sent = (beacon.leader_id, beacon.term, packets)
        # The same packets as those that peers receive at 5 Hz
        if packets > NEW_FOR_PACKETS and (sender.sequence + self._own_id) % LOW_RATE_TICKS != 0:
            return packet
        return replace(packet, leader=replace(packet.leader, proof=proof))

    def admit(self, admitted: Admitted) -> None:
        """From now on the keys of this list count; what those have signed that it does not admit is forgotten."""
        before, self._admitted = self._admitted, admitted
        for leader_id in list(self._proven):
            name = before.name_of(ParticipantRole.VEHICLE, leader_id)
            if leader_id != self._own_id and name != admitted.name_of(ParticipantRole.VEHICLE, leader_id):
                del self._proven[leader_id]

    def _proof_of(self, leader_id: int, term: Term) -> TermProof | None:
        """A verified one, of the agent that was last heard of this leader where it was heard."""
        proof = self._proven.get(leader_id, {}).get(term)
        if proof is None or self._sessions.get(leader_id, proof.session) != proof.session:
            return None
        return proof

    def _consider(self, now_s: float, sender_id: int, beacon: LeaderBeacon, proof: TermProof) -> None:
        """Verify a proof soon, unless it is of an earlier agent, the same false one again, or one too many of its sender."""
        false, false_s = self._false.get(sender_id, (None, -inf))
        others_session = self._sessions.get(beacon.leader_id, proof.session) != proof.session
        claim = (beacon.leader_id, beacon.term, proof)
        repeated = claim == false or now_s - false_s < AFTER_FALSE_S or claim in self._pending
        if beacon.leader_id == self._own_id or others_session or repeated or sender_id in self._busy:
            return
        self._busy.add(sender_id)
        self._pending.add(claim)
        self._submit(lambda: self._verify(now_s, sender_id, beacon, proof))

    def _verify(self, now_s: float, sender_id: int, beacon: LeaderBeacon, proof: TermProof) -> None:
        """In the thread, like `_make`: each changes one entry of a dictionary, the tick reads it."""
        try:
            name = self._admitted.name_of(ParticipantRole.VEHICLE, beacon.leader_id)
            entry = self._admitted.participant(name) if name else None
            if entry and is_signed(self._statement(proof.session, beacon), proof.signature, entry.key()):
                self._keep(beacon, proof)
            else:
                self._false[sender_id] = ((beacon.leader_id, beacon.term, proof), now_s)
        finally:
            self._busy.discard(sender_id)
            self._pending.discard((beacon.leader_id, beacon.term, proof))

    def _sign(self, session: int, beacon: LeaderBeacon) -> None:
        if self._own_id not in self._busy:
            self._busy.add(self._own_id)
            self._submit(lambda: self._make(session, beacon))

    def _make(self, session: int, beacon: LeaderBeacon) -> None:
        try:
            self._keep(beacon, TermProof(session, sign_term(self._statement(session, beacon), self._key)))
        finally:
            self._busy.discard(self._own_id)

    def _keep(self, beacon: LeaderBeacon, proof: TermProof) -> None:
        before = [(term, one) for term, one in self._proven.get(beacon.leader_id, {}).items() if term != beacon.term]
        self._proven[beacon.leader_id] = dict([*before[1 - KEPT :], (beacon.term, proof)])

    def _statement(self, session: int, beacon: LeaderBeacon) -> TermStatement:
        return TermStatement(
            self._fleet_name, self._formation_hash, beacon.leader_id, session, beacon.epoch, beacon.claim
        )
