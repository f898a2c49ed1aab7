"""Gives every other vehicle the key of this one's datagrams, over its authenticated Zenoh link, and takes theirs."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import zenoh

from companion.link.fleet.zenoh_session import drain
from companion.wire.keys import every_pairing, pairing_key

if TYPE_CHECKING:
    from companion.link.fleet.datagram_seal import DatagramSeal

PERIOD_S = 1.0  # a vehicle that restarts has all keys after this time
KEYS_READ = 16  # in one tick


class Pairing:
    """Publishes and receives once per period; a step costs a few microseconds otherwise."""

    def __init__(self, session: zenoh.Session, fleet: str, own_id: int, seal: DatagramSeal) -> None:
        self._session, self._fleet, self._own_id, self._seal = session, fleet, own_id, seal
        self._keys = session.declare_subscriber(
            every_pairing(fleet, own_id), zenoh.handlers.RingChannel(2 * len(seal.own_keys) or 1)
        )
        self._due_s = -inf

    def step(self, now_s: float) -> None:
        """Never blocks."""
        for sample in drain(self._keys, KEYS_READ):
            sender = str(sample.key_expr).split("/")[-2]
            if len(sender) <= 3 and sender.isdecimal():
                self._seal.learn(int(sender), sample.payload.to_bytes())
        if now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S
        for receiver_id, key in self._seal.own_keys.items():
            self._session.put(
                pairing_key(self._fleet, self._own_id, receiver_id),
                key,
                congestion_control=zenoh.CongestionControl.DROP,
            )
