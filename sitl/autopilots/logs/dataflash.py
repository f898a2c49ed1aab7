"""ArduPilot's log format (DataFlash, .bin): estimated position and attitude."""

from __future__ import annotations

import struct
from math import degrees

from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.messages import attitude, global_position

HEAD = b"\xa3\x95"
FMT = 128
# Of each message: number, name, struct format, FMT format, column names.
MESSAGES = (
    (FMT, "FMT", "<BB4s16s64s", "BBnNZ", "Type,Length,Name,Format,Columns"),
    (1, "ATT", "<Qfff", "Qfff", "TimeUS,Roll,Pitch,Yaw"),
    (2, "POS", "<Qiiff", "QLLff", "TimeUS,Lat,Lng,Alt,RelHomeAlt"),
)
PACKED = {name: (number, struct.Struct(fields)) for number, name, fields, _, _ in MESSAGES}


class DataFlash:
    """The log format of one vehicle."""

    def __init__(self, copter: Autopilot) -> None:
        self._copter = copter

    def head(self) -> bytes:
        """FMT messages, which describe all messages."""
        return b"".join(
            _message(
                "FMT", number, len(HEAD) + 1 + struct.calcsize(fields), name.encode(), form.encode(), columns.encode()
            )
            for number, name, fields, form, columns in MESSAGES
        )

    def row(self) -> bytes:
        time_us = round(self._copter.time_s * 1e6)
        angles, position = attitude(self._copter), global_position(self._copter)
        angles_deg = (degrees(angles.roll), degrees(angles.pitch), degrees(angles.yaw) % 360.0)
        return _message("ATT", time_us, *angles_deg) + _message(
            "POS", time_us, position.lat, position.lon, position.alt / 1e3, position.relative_alt / 1e3
        )


def _message(name: str, *values: float | bytes) -> bytes:
    number, fields = PACKED[name]
    return HEAD + bytes([number]) + fields.pack(*values)
