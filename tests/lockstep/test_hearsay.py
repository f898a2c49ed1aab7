"""Who leads, by hearsay: a fleet whose vehicles have identities, in a chain, with real keys and bytes, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from common import ROOT, with_fields
from companion.link.fleet.term_proofs import TermProofs
from companion.security.admission import new_key
from companion.types.flight import FlightPhase, Role
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from companion.wire.messages import decode_peer, encode_peer
from lockstep_fleet import CommandedFlight
from secured_fleet import admitted_vehicles

LINE = ROOT / "config" / "scenarios" / "four_in_line.yaml"
SUCCESSORS = ("fleet.successors=[2, 3]", "fleet.vehicles[1].may_lead=true", "fleet.vehicles[2].may_lead=true")
Forge = Callable[[PeerPacket], PeerPacket]


class ChainFlight(CommandedFlight):
    """Each vehicle receives the one before and the one behind it alone. With `identities` hearsay needs a signature."""

    def __init__(self, *, identities: bool = True) -> None:
        super().__init__(LINE, *SUCCESSORS)
        self.rejected: list[str] = []
        self.forge: dict[int, Forge] = {}  # by sender: what it says in place of the truth
        network = self.lockstep.network
        for sender, paths in network.paths.items():
            network.paths[sender] = [path for path in paths if abs(path.receiver - sender) == 1]
        if identities:
            self._with_proofs()
        self.go_on(0.5)

    def _with_proofs(self) -> None:
        keys = {vehicle.vehicle_id: new_key() for vehicle in self.lockstep.in_order}
        admitted = admitted_vehicles(self.scenario.fleet.name, keys)
        proofs = {
            i: TermProofs(i, self.scenario.fleet, key, admitted, self.rejected.append, lambda job: job())
            for i, key in keys.items()
        }
        network = self.lockstep.network
        send, receive = network.send, network.receive

        def sent(packet: PeerPacket, now_s: float) -> None:
            i = packet.sender.vehicle_id
            packet = self.forge[i](packet) if i in self.forge else proofs[i].attach(packet)
            send(decode_peer(encode_peer(packet)), now_s)

        def received(vehicle_id: int, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
            return tuple(map(proofs[vehicle_id].judge, receive(vehicle_id, now_s)))

        network.send, network.receive = sent, received  # type: ignore[method-assign]

    def ends(self, vehicle_id: int) -> None:
        """The agent of this vehicle dies."""
        self.lockstep.in_order = [one for one in self.lockstep.in_order if one.vehicle_id != vehicle_id]
        del self.newest[vehicle_id]

    def leads(self) -> dict[int, tuple[Role, int, int | None]]:
        """Role, epoch and leader of each vehicle."""
        return {
            i: (lead.role, lead.epoch, lead.leader_beacon.leader_id if lead.leader_beacon else None)
            for i, lead in ((i, status.leadership) for i, status in self.newest.items())
        }


LEADS_AS_CONFIGURED = {1: (Role.LEADER, 0, 1)} | dict.fromkeys((2, 3, 4), (Role.FOLLOWER, 0, 1))


def test_a_chain_elects_the_successor_of_a_dead_leader_by_its_signature() -> None:
    flight = ChainFlight()
    assert flight.leads() == LEADS_AS_CONFIGURED
    flight.ends(1)
    flight.go_on(1.2)
    assert flight.leads() == {2: (Role.LEADER, 1, 2), 3: (Role.FOLLOWER, 1, 2), 4: (Role.FOLLOWER, 1, 2)}
    flight.ends(2)
    flight.go_on(1.5)
    assert flight.leads() == {3: (Role.LEADER, 2, 3), 4: (Role.FOLLOWER, 2, 3)}
    assert {status.phase for status in flight.newest.values()} == {FlightPhase.FORMATION}


def test_a_vehicle_at_the_end_of_a_chain_does_not_follow_a_claim_without_its_signature() -> None:
    """So is the signature what made it follow in the test before."""
    flight = ChainFlight()
    flight.forge[3] = lambda packet: packet  # without proof
    flight.ends(1)
    flight.go_on(1.2)
    assert flight.leads()[3] == (Role.FOLLOWER, 1, 2)
    assert flight.leads()[4][1] == 0
    assert f"{Code.PEER_TERM_UNPROVEN} 3" in flight.rejected


def lie(leader_id: int, epoch: int, claim: int) -> Forge:
    """What vehicle 3 says of another: that it leads in a newer term, with stamps that rise."""

    def forged(packet: PeerPacket) -> PeerPacket:
        stamp = 10_000 + int(1000 * packet.motion.sent_s)
        return with_fields(packet, beacon=LeaderBeacon(leader_id, epoch, stamp, 5.0, claim), proof=None)

    return forged


@pytest.mark.parametrize(("leader_id", "epoch", "claim"), [(2, 1, 1), (2, 1, 0), (1, 7, 0), (2, 7, 1)])
def test_a_followers_hearsay_deposes_nobody(leader_id: int, epoch: int, claim: int) -> None:
    flight = ChainFlight()
    flight.forge[3] = lie(leader_id, epoch, claim)
    for _ in range(20):
        flight.go_on(0.1)
        leads = flight.leads()
        assert {i: leads[i] for i in (1, 2)} == {i: LEADS_AS_CONFIGURED[i] for i in (1, 2)}
        assert (leads[4][0], leads[4][1]) == (Role.FOLLOWER, 0)
    assert {flight.newest[i].phase for i in (1, 2)} == {FlightPhase.FORMATION}
    assert set(flight.rejected) == {f"{Code.PEER_TERM_UNPROVEN} 3"}


def test_without_identities_a_relayed_term_counts_as_it_comes() -> None:
    flight = ChainFlight(identities=False)
    flight.ends(1)
    flight.go_on(1.2)
    assert flight.leads() == {2: (Role.LEADER, 1, 2), 3: (Role.FOLLOWER, 1, 2), 4: (Role.FOLLOWER, 1, 2)}
