"""A .tlog: each MAVLink packet after its time, 8 bytes of microseconds of Unix time, the most significant first.

QGroundControl, Mission Planner and pymavlink write and read such files.
"""

from __future__ import annotations

import struct

from companion.recording.writer.files import PartFormat

_TIME = struct.Struct(">Q")


def stamped(packet: bytes, unix_us: int) -> bytes:
    """A packet with its time, which must not be negative."""
    return _TIME.pack(unix_us) + packet


class TlogPart(PartFormat[bytes]):
    """A file of stamped packets, which has neither beginning nor end."""

    def opening(self) -> bytes:
        """Nothing."""
        return b""

    def piece(self, piece: bytes) -> bytes:
        """Stamped packets as they are."""
        return piece

    def closing(self, _offset: int) -> bytes:
        """Nothing."""
        return b""
