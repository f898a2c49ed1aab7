"""The network between agents in virtual time: broadcast over one path per sender and receiver."""

from __future__ import annotations

from collections.abc import Iterable
from heapq import heappop, heappush

from companion.types.peers import PeerPacket, ReceivedPeerPacket
from sitl.links.impairment import Path
from sitl.vehicle.config import Links


class Network:
    """Peer packets in transit. The result depends on the packets, `links` and the seed alone."""

    def __init__(self, vehicle_ids: Iterable[int], links: Links, seed: int) -> None:
        ids = list(vehicle_ids)
        self._in_transit: dict[int, list[tuple[float, int, PeerPacket]]] = {i: [] for i in ids}
        self._paths = {i: [Path(i, j, links, seed) for j in ids if j != i] for i in ids}
        self._sent = 0

    def send(self, packet: PeerPacket, now_s: float) -> None:
        """To all others."""
        self._sent += 1
        for path in self._paths[packet.vehicle_id]:
            for arrives_s in path.arrivals_s(now_s):
                # The number keeps packets of one time in order.
                heappush(self._in_transit[path.receiver], (arrives_s, self._sent, packet))

    def receive(self, vehicle_id: int, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """Packets that arrived since the last call; as on board, their time of receipt is that of this call."""
        waiting, packets = self._in_transit[vehicle_id], []
        while waiting and waiting[0][0] < now_s:
            packets.append(ReceivedPeerPacket(now_s, heappop(waiting)[2]))
        return tuple(packets)
