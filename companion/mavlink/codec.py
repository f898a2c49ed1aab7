"""Bytes <-> MAVLink 2 messages. No sockets, no clocks."""

from __future__ import annotations

from collections import Counter

from companion.mavlink.messages import mavlink
from companion.mavlink.packet_reader import PacketReader
from companion.mavlink.plain_packets import MavlinkMessage, Packet, encode_plain
from companion.mavlink.signing import SignedMavlink, SigningKey

__all__ = ["MavlinkCodec", "MavlinkMessage", "mavlink"]


class MavlinkCodec:
    """One end of a MAVLink link. It keeps an incomplete packet between calls and counts its own sequence.

    `refused` counts refused packets by code. With a key every sent packet is signed, and unsigned packets are refused.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey | None = None) -> None:
        self._signed = SignedMavlink(system_id, component_id, key) if key else None
        self._mav = self._signed or mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._reader = PacketReader(self._mav)
        self._packets: list[Packet] = []  # of the last `read`

    @property
    def refused(self) -> Counter[str]:
        return self._reader.refused

    @property
    def packets(self) -> list[bytes]:
        """Packets of the last `read`, unchanged, without refused ones."""
        return [packet.data for packet in self._packets]

    def read(self, data: bytes) -> list[Packet]:
        """All complete packets in the earlier remainder and `data`, in order. Unknown ones are left out. Never raises."""
        self._packets = self._reader.read(data)
        # The checksum and the signature of unknown messages are unchecked.
        return [packet for packet in self._packets if packet.message_id != mavlink.MAVLINK_MSG_ID_UNKNOWN]

    def decode(self, data: bytes) -> list[MavlinkMessage]:
        """The messages of `read`."""
        return [packet.message for packet in self.read(data)]

    def encode(self, message: MavlinkMessage) -> bytes:
        """The MAVLink 2 packet of a message."""
        if self._signed:
            self._signed.keep_time()
        packed: bytes = encode_plain(message, self._mav) or message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed
