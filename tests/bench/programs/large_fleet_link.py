"""The peer states of one vehicle over Zenoh, with two rates: what `make bench-large-fleet` measures.

Keys, publishers and channels are those of the agent's `ZenohLink`. The slow key beside each of them is of this measurement
alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Sequence
from typing import Any

import zenoh

from companion.link.fleet.peer_states import samples_kept
from companion.link.fleet.zenoh_session import SETTINGS, THREADS, drain
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.peers import PeerPacket
from companion.types.values import ZERO3
from companion.wire.keys import distant_key, peer_key
from companion.wire.peer import decode_peer, encode_peer

FLEET = "large"


def opened(mode: str, listen: Sequence[str], connect: Sequence[str]) -> zenoh.Session:
    """A session with the agent's settings in another mode: a router forwards to clients, not to peers."""
    os.environ.setdefault("ZENOH_RUNTIME", THREADS)
    zenoh.init_log_from_env_or("off")
    config = zenoh.Config()
    settings: dict[str, Any] = {
        **SETTINGS,
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
    }
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


class PeerLink:
    """Publishes the own state on both keys, and receives vehicles at full rate or a few times per second."""

    def __init__(
        self, own_id: int, session: zenoh.Session, full_ids: Collection[int], slow_ids: Collection[int]
    ) -> None:
        self._own_id = own_id
        self._session = session
        self._sequence = 0
        self._full = session.declare_publisher(
            peer_key(FLEET, own_id),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._slow = session.declare_publisher(
            distant_key(FLEET, own_id), congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
        )
        self._samples_kept = samples_kept(1 + len({*full_ids, *slow_ids}))
        self._channels = [self.subscribed(peer_key(FLEET, i)) for i in full_ids]
        self._channels += [self.subscribed(distant_key(FLEET, i)) for i in slow_ids]

    def subscribed(self, key: str) -> Any:
        """A subscriber as the agent has one for each vehicle."""
        return self._session.declare_subscriber(
            key, zenoh.handlers.RingChannel(self._samples_kept), allowed_origin=zenoh.Locality.REMOTE
        )

    def publish(self, now_s: float, also_slow: bool) -> None:
        """The next packet, at full rate; on the slow key as well where it is its turn."""
        self._sequence += 1
        data = encode_peer(_packet(self._own_id, self._sequence, now_s))
        self._full.put(data)
        if also_slow:
            self._slow.put(data)

    def receive(self) -> list[PeerPacket]:
        """All packets since the last call."""
        return [
            decode_peer(sample.payload.to_bytes())
            for channel in self._channels
            for sample in drain(channel, self._samples_kept)
        ]


def _packet(vehicle_id: int, sequence: int, now_s: float) -> PeerPacket:
    """In formation, of the usual size."""
    return PeerPacket(
        vehicle_id=vehicle_id,
        session=2**61,
        sequence=sequence,
        formation_hash=2**61,
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        position_enu_m=(1.5, 2.5, 10.5),
        velocity_enu_m_s=(0.5, 0.5, 0.5),
        acceleration_enu_m_s2=(0.1, 0.1, 0.1),
        state_age_s=0.01,
        sent_s=now_s,
        prc=2,
        leader_beacon=LeaderBeacon(1, 1, 100_000, 100.5),
        slot=FlownSlot(ZERO3),
    )
