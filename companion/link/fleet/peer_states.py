"""Peer packets over Zenoh. Every vehicle publishes at 50 Hz, and in a large fleet every tenth packet under a second key.

Zenoh transmits only what a program subscribes to. So a receiver chooses the rate of each peer by its subscription, and no
other program needs to know.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from itertools import islice
from typing import Any

import zenoh

from companion.config.fleet import FleetConfig
from companion.core.consensus.neighbours import LOW_RATE_TICKS
from companion.link.fleet.peer_datagrams import packet_of_fleet
from companion.link.fleet.zenoh_session import drain, publisher, subscriber
from companion.types.peers import PeerPacket
from companion.wire.keys import distant_key, peer_key
from companion.wire.messages import encode_peer

PACKETS_PER_VEHICLE = 8  # used at most of each tick, the newest
# Messages that wait for a tick: what is no packet is dropped before it can displace one. To refuse one takes 10 us, so in a
# large fleet fewer wait for each vehicle.
SAMPLES_KEPT, LEAST_PER_VEHICLE, MOST_PER_VEHICLE = 1024, 2 * PACKETS_PER_VEHICLE, 128
TAKEN_LATE = 2  # messages of each vehicle in the tick; the rest of a flood waits for the next one
CHANGES_PER_TICK = 8  # at most this many subscriptions change in a tick; one takes 0.1 ms


def samples_to_keep(vehicles: int) -> int:
    """How many messages wait for each vehicle of a fleet of this size."""
    return min(max(SAMPLES_KEPT // vehicles, LEAST_PER_VEHICLE), MOST_PER_VEHICLE)


class PeerStates:
    """Publishes the own packets and receives those of the peers. Calls `reject` with the counter's key for a refused one."""

    def __init__(
        self, session: zenoh.Session, vehicle_id: int, fleet: FleetConfig, reject: Callable[[str], None]
    ) -> None:
        self._session, self._own_id, self._fleet_name, self._reject = session, vehicle_id, fleet.name, reject
        self._fleet_ids = frozenset(member.id for member in fleet.vehicles)
        self._samples_kept = samples_to_keep(len(self._fleet_ids))
        # A channel for each vehicle: one that floods displaces no packet of the others.
        self._at_50_hz = {member.id: self._subscribe(peer_key(fleet.name, member.id)) for member in fleet.vehicles}
        self._at_5_hz: dict[int, Any] = {}
        self._admitted = set(self._at_50_hz)
        self._publisher = publisher(session, peer_key(fleet.name, vehicle_id), zenoh.Priority.REAL_TIME)
        distant = distant_key(fleet.name, vehicle_id) if fleet.has_distant_peers else None
        self._low_rate_publisher = publisher(session, distant, zenoh.Priority.REAL_TIME) if distant else None

    def publish(self, packet: PeerPacket) -> None:
        """Publish the own packet."""
        payload = encode_peer(packet)
        self._publisher.put(payload)
        # Not all vehicles in the same tick
        if self._low_rate_publisher and (packet.sender.sequence + self._own_id) % LOW_RATE_TICKS == 0:
            self._low_rate_publisher.put(payload)

    def receive(self) -> list[PeerPacket]:
        """All packets since the last call. Never blocks."""
        return self._receive(self._samples_kept)

    def receive_late(self) -> list[PeerPacket]:
        """A few of the packets that the next `receive` would return. Never blocks."""
        return self._receive(TAKEN_LATE)

    def _receive(self, most: int) -> list[PeerPacket]:
        """From at most so many messages of each vehicle."""
        packets: list[PeerPacket] = []
        for sender_id, channel in self._at_50_hz.items():
            if samples := drain(channel, most):
                packets += self._packets(samples, sender_id)
        if self._at_5_hz:
            at_full_rate = {packet.sender.vehicle_id for packet in packets}
            for sender_id in at_full_rate & self._at_5_hz.keys():
                self._at_5_hz.pop(sender_id).undeclare()  # what it holds are copies
            for sender_id, channel in self._at_5_hz.items():
                packets += self._packets(drain(channel, most), sender_id)
        return packets

    def set_low_rate_peers(self, distant_ids: Collection[int]) -> None:
        """Receive these at 5 Hz and all others at 50 Hz. Once a tick: each call makes a few of the changes.

        A peer that is to be received at 50 Hz remains at 5 Hz as well until its first packet at 50 Hz.
        """
        if self._low_rate_publisher is None:
            return  # a small fleet
        changes = 0
        for peer_id in self._admitted.difference(distant_ids, self._at_50_hz):
            if changes < CHANGES_PER_TICK:
                self._at_50_hz[peer_id] = self._subscribe(peer_key(self._fleet_name, peer_id))
                changes += 1
        for peer_id in self._admitted.intersection(distant_ids, self._at_50_hz):
            if changes < CHANGES_PER_TICK:
                if peer_id not in self._at_5_hz:
                    self._at_5_hz[peer_id] = self._subscribe(distant_key(self._fleet_name, peer_id))
                self._at_50_hz.pop(peer_id).undeclare()
                changes += 1

    def refuse(self, vehicle_id: int) -> None:
        """From now on receive nothing of this vehicle."""
        self._admitted.discard(vehicle_id)
        for channels in (self._at_50_hz, self._at_5_hz):
            if channel := channels.pop(vehicle_id, None):
                channel.undeclare()

    def _packets(self, samples: list[zenoh.Sample], sender_id: int) -> list[PeerPacket]:
        """The newest packets in these messages, in their order."""
        newest_first = (sample.payload.to_bytes() for sample in reversed(samples))
        packets = (packet_of_fleet(data, self._fleet_ids, self._reject, sender_id) for data in newest_first)
        return list(islice(filter(None, packets), PACKETS_PER_VEHICLE))[::-1]

    def _subscribe(self, key: str) -> Any:
        return subscriber(self._session, key, self._samples_kept, allowed_origin=zenoh.Locality.REMOTE)
