"""PX4's logs: its format (ULog, version 1), and its side of the log protocol.

It does not answer without logs, answers also in the air, and sends all requested data at once.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.logs import CHUNK_BYTES, Answers, log_data, log_requests
from sitl.autopilots.messages import attitude_quaternion, local_position

MAGIC = b"ULog\x01\x12\x35\x01"
TOPICS = (
    ("vehicle_local_position", "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;"),
    ("vehicle_attitude", "uint64_t timestamp;float[4] q;"),
)
LOCAL_POSITION, ATTITUDE = range(len(TOPICS))
NAME = b"char[3] sys_name"
END_OF_LIST = 0xFFFF


def ulog_head(px4: Autopilot) -> bytes:
    """Magic and time; flags, name and formats; subscribed topics."""
    flags = _message("B", bytes(40))
    name = _message("I", bytes([len(NAME)]) + NAME + b"PX4")
    formats = b"".join(_message("F", f"{topic}:{fields}".encode()) for topic, fields in TOPICS)
    topics = b"".join(_message("A", struct.pack("<BH", 0, i) + topic.encode()) for i, (topic, _) in enumerate(TOPICS))
    return MAGIC + struct.pack("<Q", _time_us(px4)) + flags + name + formats + topics


def ulog_row(px4: Autopilot) -> bytes:
    position, attitude = local_position(px4), attitude_quaternion(px4)
    assert position is not None  # PX4 always has one
    fields = (position.x, position.y, position.z, position.vx, position.vy, position.vz)
    quaternion = (attitude.q1, attitude.q2, attitude.q3, attitude.q4)
    return _message("D", struct.pack("<HQ6f", LOCAL_POSITION, _time_us(px4), *fields)) + _message(
        "D", struct.pack("<HQ4f", ATTITUDE, _time_us(px4), *quaternion)
    )


def _time_us(px4: Autopilot) -> int:
    return round(px4.time_s * 1e6)


def _message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


@dataclass(frozen=True, slots=True)
class Listed:
    """A log as it was when the list was made."""

    content: bytearray
    size_bytes: int
    utc_s: int


class Px4LogTransfer:
    """Log transfer on one link. Ids count from 0; the list ends with the last log, whatever end was requested."""

    def __init__(self, px4: Autopilot) -> None:
        self.requests = log_requests(self._list, self._data, self._end, self._erase)
        self._px4 = px4
        self._listed: list[Listed] = []
        self._entries: list[MavlinkMessage] = []  # to be sent
        self._sent_id, self._sent_bytes, self._until_bytes = 0, 0, 0

    def due(self) -> Answers:
        yield from self._entries
        self._entries = []
        while self._sent_bytes < self._until_bytes:
            log = self._listed[self._sent_id]
            content = bytes(log.content[self._sent_bytes : min(self._sent_bytes + CHUNK_BYTES, log.size_bytes)])
            yield log_data(self._sent_id, self._sent_bytes, content)
            self._sent_bytes += len(content)

    def _list(self, request: MavlinkMessage) -> None:
        logs = self._px4.flight_logs
        self._listed = [Listed(log.content, len(log.content), logs.utc_s(log.written_s)) for log in logs.files]
        self._until_bytes = 0
        number = len(self._listed)
        last = number if request.end == END_OF_LIST else request.end
        self._entries = [
            mavlink.MAVLink_log_entry_message(i, number, last, self._listed[i].utc_s, self._listed[i].size_bytes)
            for i in range(request.start, number)
        ]

    def _data(self, request: MavlinkMessage) -> None:
        """The last packet is as long as the log allows, also beyond the requested count."""
        self._entries, self._until_bytes = [], 0
        if request.id < len(self._listed):
            self._sent_id, self._sent_bytes = request.id, request.ofs
            self._until_bytes = min(request.ofs + request.count, self._listed[request.id].size_bytes)

    def _end(self, _request: MavlinkMessage) -> None:
        self._entries, self._until_bytes = [], 0

    def _erase(self, request: MavlinkMessage) -> None:
        self._px4.flight_logs.erase()
        self._listed = []
        self._end(request)
