"""PX4's log format (ULog, version 1): estimated position and attitude."""

from __future__ import annotations

import struct

from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.messages import attitude_quaternion, local_position

MAGIC = b"ULog\x01\x12\x35\x01"
TOPICS = (
    ("vehicle_local_position", "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;"),
    ("vehicle_attitude", "uint64_t timestamp;float[4] q;"),
)
LOCAL_POSITION, ATTITUDE = range(len(TOPICS))
NAME = b"char[3] sys_name"


class ULog:
    """The log format of one vehicle."""

    def __init__(self, px4: Autopilot) -> None:
        self._px4 = px4

    def head(self) -> bytes:
        """Magic and time; flags, name and formats; subscribed topics."""
        flags = _message("B", bytes(40))
        name = _message("I", bytes([len(NAME)]) + NAME + b"PX4")
        formats = b"".join(_message("F", f"{topic}:{fields}".encode()) for topic, fields in TOPICS)
        topics = b"".join(
            _message("A", struct.pack("<BH", 0, i) + topic.encode()) for i, (topic, _) in enumerate(TOPICS)
        )
        return MAGIC + struct.pack("<Q", self._time_us()) + flags + name + formats + topics

    def row(self) -> bytes:
        position, attitude = local_position(self._px4), attitude_quaternion(self._px4)
        fields = (position.x, position.y, position.z, position.vx, position.vy, position.vz)
        quaternion = (attitude.q1, attitude.q2, attitude.q3, attitude.q4)
        return _message("D", struct.pack("<HQ6f", LOCAL_POSITION, self._time_us(), *fields)) + _message(
            "D", struct.pack("<HQ4f", ATTITUDE, self._time_us(), *quaternion)
        )

    def _time_us(self) -> int:
        return round(self._px4.time_s * 1e6)


def _message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload
