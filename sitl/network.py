"""The network between agents in virtual time: every packet to every other vehicle, late and sometimes lost, by seed."""

from __future__ import annotations

from collections.abc import Iterable
from heapq import heappop, heappush
from random import Random

from companion.types import PeerPacket, ReceivedPeerPacket
from sitl.config import Links


class Network:
    """What is lost, and how late the rest is, comes out of (seed, sender, receiver) alone."""

    def __init__(self, vehicle_ids: Iterable[int], links: Links, seed: int) -> None:
        ids = list(vehicle_ids)
        self._delay_s, self._jitter_s, self._loss = links.peer_delay_s, links.peer_jitter_s, links.peer_loss
        self._on_the_way: dict[int, list[tuple[float, int, PeerPacket]]] = {i: [] for i in ids}
        self._ways = {i: [(j, Random(f"{seed} {i} {j} network")) for j in ids if j != i] for i in ids}
        self._sent = 0

    def send(self, packet: PeerPacket, now_s: float) -> None:
        """To all others."""
        self._sent += 1
        for receiver, random in self._ways[packet.vehicle_id]:
            if self._loss and random.random() < self._loss:
                continue
            jitter_s = self._jitter_s * random.random() if self._jitter_s else 0.0
            arrives_s = now_s + self._delay_s + jitter_s
            heappush(self._on_the_way[receiver], (arrives_s, self._sent, packet))  # their number keeps equals in order

    def receive(self, vehicle_id: int, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """What came to this vehicle before now since its last call. As on board, the time of looking is that of receipt."""
        waiting, packets = self._on_the_way[vehicle_id], []
        while waiting and waiting[0][0] < now_s:
            packets.append(ReceivedPeerPacket(now_s, heappop(waiting)[2]))
        return tuple(packets)
