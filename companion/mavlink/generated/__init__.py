"""The dialect as `make mavlink` writes it, and the checksum of MAVLink, CRC-16/MCRF4XX, that it uses.

Python has the same CRC with the bits of each byte in the other order. A library for it would take 0.8 MB of each agent's
memory, and save 0.2 us of a packet.
"""

from __future__ import annotations

from binascii import crc_hqx

START = 0xFFFF
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # each byte with its bits in the other order


def mcrf4xx(data: bytes | bytearray, start: int = START) -> int:
    """The checksum of these bytes, behind those of which `start` is the checksum."""
    if start != START:
        start = _REVERSED[start & 0xFF] << 8 | _REVERSED[start >> 8]
    crc = crc_hqx(data.translate(_REVERSED), start)
    return _REVERSED[crc & 0xFF] << 8 | _REVERSED[crc >> 8]
