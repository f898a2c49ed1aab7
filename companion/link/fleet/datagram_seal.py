"""Authentication of peer datagrams: one tag for each receiver, with a key that only the sender and this receiver know.

A key for the whole fleet would let every vehicle speak for every other one. The keys are random, new with each start of the
sender, and reach each receiver over its own authenticated link (`zenoh_link.py`).

A datagram: MARK, sender id, number of tags, the tags (receiver id, 8 bytes), then the peer packet. A tag is the keyed
BLAKE2s (RFC 7693) of sender id and peer packet, 8 bytes long: a quarter of the time of an HMAC-SHA256.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Collection

from companion.types.notices import Code

MARK = 0xD5  # no wire version, so that a fleet with and without authentication is told apart
KEY_BYTES, TAG_BYTES = 32, 8
HEADER_BYTES = 3


class DatagramSeal:
    """Keys of one vehicle for all others, and their keys for it."""

    def __init__(self, own_id: int, fleet_ids: Collection[int]) -> None:
        self._own_id = own_id
        self.own_keys = {i: secrets.token_bytes(KEY_BYTES) for i in sorted(fleet_ids) if i != own_id}
        self._keys: dict[int, bytes] = {}  # by sender

    def learn(self, sender_id: int, key: bytes) -> None:
        """The key with which this sender makes its tags for this vehicle. Another length is no key."""
        if sender_id in self.own_keys and len(key) == KEY_BYTES:
            self._keys[sender_id] = bytes(key)

    def forget(self, vehicle_id: int) -> None:
        """From now on neither receive from this vehicle nor make tags for it."""
        self.own_keys.pop(vehicle_id, None)
        self._keys.pop(vehicle_id, None)

    def sealed(self, payload: bytes) -> bytes:
        """The datagram of a peer packet."""
        signed = bytes((self._own_id,)) + payload
        tags = [bytes((i,)) + _tag(key, signed) for i, key in self.own_keys.items()]
        return b"".join((bytes((MARK, self._own_id, len(tags))), *tags, payload))

    def opened(self, datagram: bytes) -> tuple[int, bytes] | Code:
        """Sender and peer packet; for anything that this sender did not make for this vehicle the code of the rejection."""
        if len(datagram) < HEADER_BYTES or datagram[0] != MARK:
            return Code.PEER_NOT_AUTHENTICATED
        sender_id, count = datagram[1], datagram[2]
        payload = datagram[HEADER_BYTES + count * (1 + TAG_BYTES) :]
        key = self._keys.get(sender_id)
        tag = self._own_tag(datagram, count)
        if key is None or tag is None or not hmac.compare_digest(tag, _tag(key, bytes((sender_id,)) + payload)):
            return Code.PEER_NOT_AUTHENTICATED
        return sender_id, payload

    def _own_tag(self, datagram: bytes, count: int) -> bytes | None:
        for place in range(HEADER_BYTES, HEADER_BYTES + count * (1 + TAG_BYTES), 1 + TAG_BYTES):
            if len(datagram) >= place + 1 + TAG_BYTES and datagram[place] == self._own_id:
                return datagram[place + 1 : place + 1 + TAG_BYTES]
        return None


def _tag(key: bytes, content: bytes) -> bytes:
    return hashlib.blake2s(content, key=key, digest_size=TAG_BYTES).digest()
