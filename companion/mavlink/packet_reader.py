"""Received bytes -> MAVLink packets. Behind a damaged packet the search goes on one byte later: no good packet is lost."""

from __future__ import annotations

from collections import Counter

from companion.mavlink.checksum import mcrf4xx
from companion.mavlink.messages import mavlink
from companion.mavlink.plain_packets import CHECKSUM_BYTES, Packet, read_plain
from companion.mavlink.signing import SIGNATURE_CODES
from companion.types.notices import Code

MAVLINK_2, MAVLINK_1 = 0xFD, 0xFE  # first byte of a packet
SIGNED = 0x01  # the only incompat_flag that is defined
OVERHEAD = {MAVLINK_2: 12, MAVLINK_1: 8}  # bytes of header and checksum
ID_AT = {MAVLINK_2: slice(7, 10), MAVLINK_1: slice(5, 6)}
SIGNATURE_BYTES = 13
MOST_DAMAGED = 16  # packets of one call; each costs a checksum, and what follows is discarded


class PacketReader:
    """Splits bytes into packets and checks them with `mav`. Keeps an incomplete packet until the next call.

    `refused` counts runs of garbage and packets with a refused signature, by code. pymavlink's own parser skips as many bytes
    as a damaged packet claims to have, and with them the good packets behind it.
    """

    def __init__(self, mav: mavlink.MAVLink) -> None:
        self._mav = mav
        self._has_key = mav.signing.secret_key is not None
        self._rest = b""
        self.refused: Counter[str] = Counter()

    @property
    def is_between_packets(self) -> bool:
        """Whether the bytes so far ended with a complete packet."""
        return not self._rest

    def read(self, data: bytes) -> list[Packet]:
        """All packets in the kept bytes and `data`, in order. Messages of unknown ones are MAVLink_unknown. Never raises."""
        if not self._rest and (packet := self._plain(data)) is not None:
            return [packet]  # nearly always
        if self._rest and _is_packet(data, 0):  # what was kept is garbage, or lost its other half
            self.refused[Code.MAVLINK_UNREADABLE] += 1
            self._rest = b""
        data = self._rest + data
        packets: list[Packet] = []
        at, damaged, in_garbage = 0, 0, False
        while (start := _next_magic(data, at)) < len(data):
            end = _claimed_end(data, start)
            if end > len(data):
                break  # the rest of this packet is yet to come
            packet = self._checked(data, start, end) if end > start else None
            if packet is None or start > at:
                self.refused[Code.MAVLINK_UNREADABLE] += not in_garbage
                in_garbage = True
            if packet is None:
                damaged, at = damaged + (end > start), start + 1
                if damaged == MOST_DAMAGED:
                    start = len(data)
                    break
                continue
            if packet.message_id != mavlink.MAVLINK_MSG_ID_BAD_DATA:
                packets.append(packet)
            at, in_garbage = end, False
        if start == len(data) and at < start:
            self.refused[Code.MAVLINK_UNREADABLE] += not in_garbage
        self._rest = data[start:]
        return packets

    def _plain(self, data: bytes) -> Packet | None:
        """A packet that no key protects; None where pymavlink has to judge it."""
        return None if self._has_key else read_plain(data)

    def _checked(self, data: bytes, start: int, end: int) -> Packet | None:
        """The packet of these bytes, BAD_DATA where its signature is refused, None where it is none."""
        candidate = data[start:end]
        if (packet := self._plain(candidate)) is not None:
            return packet
        try:
            message = self._mav.decode(bytearray(candidate))
        except mavlink.MAVError as error:
            reason = str(error)
            if reason not in SIGNATURE_CODES:
                return None
            self.refused[reason] += 1
            message = mavlink.MAVLink_bad_data(b"", reason)
        message_id = message.get_msgId()
        if message_id == mavlink.MAVLINK_MSG_ID_UNKNOWN and not _ends_well(data, start, end):
            return None
        sender, flags = (message.get_srcSystem(), message.get_srcComponent()), message.get_header().incompat_flags
        return Packet(candidate, message_id, *sender, is_signed=bool(flags), known=message)


def _next_magic(data: bytes, start: int) -> int:
    """Index of the first byte from `start` on that may begin a packet; the length of the data where there is none."""
    if start < len(data) and data[start] in OVERHEAD:  # nearly always
        return start
    found = [at for magic in (MAVLINK_2, MAVLINK_1) if (at := data.find(magic, start)) >= 0]
    return min(found, default=len(data))


def _claimed_end(data: bytes, start: int) -> int:
    """End of the packet that begins at `start`, by its header; `start` where it cannot be one. May lie beyond the data."""
    magic = data[start]
    if len(data) < start + 3:
        return start + OVERHEAD[magic]
    end = start + OVERHEAD[magic] + data[start + 1]
    if magic == MAVLINK_1:
        return end
    incompat_flags = data[start + 2]
    if incompat_flags & ~SIGNED:
        return start
    return end + SIGNATURE_BYTES if incompat_flags else end


def _is_packet(data: bytes, start: int) -> bool:
    """Whether a known packet with a good checksum begins here, complete in the data."""
    if start >= len(data) or data[start] not in OVERHEAD:
        return False
    end = _claimed_end(data, start)
    if not start < end <= len(data):
        return False
    packet = data[start:end]
    known = mavlink.mavlink_map.get(int.from_bytes(packet[ID_AT[packet[0]]], "little"))
    if known is None:
        return False
    if packet[0] == MAVLINK_2 and packet[2]:
        packet = packet[:-SIGNATURE_BYTES]
    checksum = mcrf4xx(packet[1:-CHECKSUM_BYTES] + bytes([known.crc_extra]))
    return bool(checksum == int.from_bytes(packet[-CHECKSUM_BYTES:], "little"))


def _ends_well(data: bytes, start: int, end: int) -> bool:
    """Whether a packet of unknown id, whose checksum cannot be checked, is followed by another one and contains none."""
    if end < len(data) and data[end] not in OVERHEAD:
        return False
    inner = start + 1
    while (inner := _next_magic(data, inner)) < end:
        if _is_packet(data, inner):
            return False
        inner += 1
    return True
