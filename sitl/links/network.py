"""The network between agents. `Path` is what one direction does to packets, `Network` all of it in virtual time. No clocks."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable
from random import Random

from companion.core.consensus.neighbours import LOW_RATE_TICKS
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from sitl.vehicle.config import Links
from sitl.vehicle.lies import Liars

ROUNDING_S = 1e-9  # what arrives at the time of a receipt is received by the next one
SUBSCRIBED_AFTER_S = 0.05  # a change of rate takes effect, beside the delay of the path


class Path:
    """One directed path. Its random numbers depend on (seed, sender, receiver) alone."""

    def __init__(self, sender: int, receiver: int, links: Links, seed: int) -> None:
        self.sender, self.receiver, self.links = sender, receiver, links
        self._random = Random(f"{seed} {sender} {receiver} network")

    def reseed(self, seed: str) -> None:
        """From now on its random numbers are those of this seed."""
        self._random.seed(f"{seed} {self.sender} {self.receiver} network")

    def is_cut(self, now_s: float) -> bool:
        """Whether a partition separates sender and receiver at this time of the flight."""
        return any(partition.separates(self.sender, self.receiver, now_s) for partition in self.links.partitions)

    def loses(self) -> bool:
        """Whether the next packet is lost."""
        return self.links.peer_loss > 0.0 and self._random.random() < self.links.peer_loss

    def delay_s(self) -> float:
        """Delay of the next packet."""
        jitter_s = self.links.peer_jitter_s
        return self.links.peer_delay_s + (jitter_s * self._random.random() if jitter_s else 0.0)

    def arrivals_s(self, now_s: float) -> tuple[float, ...]:
        """Arrival times of a datagram sent now: one, none if it is lost, two if it is duplicated."""
        if self.loses() or self.is_cut(now_s):
            return ()
        arrives_s = now_s + self.delay_s()
        duplicates = self.links.peer_duplicates
        if duplicates and self._random.random() < duplicates:
            return arrives_s, now_s + self.delay_s()
        return (arrives_s,)


class Network:
    """Peer packets in transit. The result depends on the packets, the rates, `links` and the seed alone."""

    def __init__(self, vehicle_ids: Iterable[int], links: Links, seed: int) -> None:
        ids = list(vehicle_ids)
        # In the order of arrival; the number of the packet keeps those of one time in order. True: its beacon is proven.
        self._in_transit: dict[int, list[tuple[float, int, PeerPacket, bool]]] = {i: [] for i in ids}
        self.paths = {i: [Path(i, j, links, seed) for j in ids if j != i] for i in ids}
        self.distant: dict[int, frozenset[int]] = {i: frozenset() for i in ids}  # of each receiver
        self._next_distant: list[tuple[float, int, frozenset[int]]] = []  # from when on, receiver, its distant peers
        self._subscribed_after_s = SUBSCRIBED_AFTER_S + links.peer_delay_s + links.peer_jitter_s
        self.liars = Liars(links.lies) if links.lies else None
        self._links = links  # those of a path may be replaced in flight
        self._is_undisturbed = not (links.peer_loss or links.peer_jitter_s or links.peer_duplicates or links.partitions)
        self._stated: set[tuple[int, int, int]] = set()  # leader, epoch and claim, as leaders said themselves
        self._sent = 0

    def send(self, packet: PeerPacket, now_s: float) -> None:
        """To all others; to those that receive the sender at 5 Hz only every tenth."""
        while self._next_distant and self._next_distant[0][0] <= now_s:
            _, receiver, distant_ids = self._next_distant.pop(0)
            self.distant[receiver] = distant_ids
        self._sent += 1
        sender_id = packet.sender.vehicle_id
        if self.liars is not None:
            packet = self.liars.stated(packet, now_s)
        proven = self._is_proven(packet)
        at_low_rate = (packet.sender.sequence + sender_id) % LOW_RATE_TICKS == 0
        in_transit, distant = self._in_transit, self.distant
        in_time = (now_s + self._links.peer_delay_s, self._sent, packet, proven)
        for path in self.paths[sender_id]:
            receiver = path.receiver
            if not at_low_rate and sender_id in distant[receiver]:
                continue
            if path.links is self._links and self._is_undisturbed:
                insort(in_transit[receiver], in_time)
                continue
            for arrives_s in path.arrivals_s(now_s):
                insort(in_transit[receiver], (arrives_s, self._sent, packet, proven))

    def _is_proven(self, packet: PeerPacket) -> bool:
        """As between vehicles with identities: who passes on a term has the leader's signature where that has stated it."""
        beacon = packet.leader.beacon
        if beacon is None or (beacon.epoch == 0 and beacon.claim == 0):
            return True
        if beacon.leader_id == packet.sender.vehicle_id:
            self._stated.add((beacon.leader_id, beacon.epoch, beacon.claim))
        return (beacon.leader_id, beacon.epoch, beacon.claim) in self._stated

    def set_low_rate_peers(self, vehicle_id: int, distant_ids: Iterable[int], now_s: float) -> None:
        """This vehicle subscribes to these peers at 5 Hz, and to all others at 50 Hz."""
        self._next_distant.append((now_s + self._subscribed_after_s, vehicle_id, frozenset(distant_ids)))

    def receive(self, vehicle_id: int, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """Packets that arrived since the last call; as on board, their time of receipt is that of this call."""
        waiting = self._in_transit[vehicle_id]
        arrived = bisect_left(waiting, (now_s - ROUNDING_S,))
        packets = tuple([ReceivedPeerPacket(now_s, packet, proven) for _, _, packet, proven in waiting[:arrived]])
        del waiting[:arrived]
        return packets
