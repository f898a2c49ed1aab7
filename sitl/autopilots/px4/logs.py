"""PX4's side of the log protocol: no answer without logs, also in the air, all requested data at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.logs.transfer import CHUNK_BYTES, LogTransfer, log_data

END_OF_LIST = 0xFFFF


@dataclass(frozen=True, slots=True)
class Listed:
    """A log as it was when the list was made."""

    content: bytearray
    size_bytes: int
    utc_s: int


class Px4LogTransfer(LogTransfer):
    """Log transfer on one link. Ids count from 0; the list ends with the last log, whatever end was requested."""

    def __init__(self, px4: Autopilot) -> None:
        super().__init__()
        self._px4 = px4
        self._listed: list[Listed] = []
        self._entries: list[MavlinkMessage] = []  # to be sent
        self._sent_id, self._sent_bytes, self._until_bytes = 0, 0, 0

    def due(self) -> Iterator[MavlinkMessage]:
        yield from self._entries
        self._entries = []
        while self._sent_bytes < self._until_bytes:
            log = self._listed[self._sent_id]
            content = bytes(log.content[self._sent_bytes : min(self._sent_bytes + CHUNK_BYTES, log.size_bytes)])
            yield log_data(self._sent_id, self._sent_bytes, content)
            self._sent_bytes += len(content)

    def _list(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]:
        logs = self._px4.flight_logs
        self._listed = [Listed(log.content, len(log.content), logs.utc_s(log.written_s)) for log in logs.files]
        self._until_bytes = 0
        number = len(self._listed)
        last = number if request.end == END_OF_LIST else request.end
        self._entries = [
            mavlink.MAVLink_log_entry_message(i, number, last, self._listed[i].utc_s, self._listed[i].size_bytes)
            for i in range(request.start, number)
        ]
        yield from ()

    def _data(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]:
        """The last packet is as long as the log allows, also beyond the requested count."""
        self._entries, self._until_bytes = [], 0
        if request.id < len(self._listed):
            self._sent_id, self._sent_bytes = request.id, request.ofs
            self._until_bytes = min(request.ofs + request.count, self._listed[request.id].size_bytes)
        yield from ()

    def _end(self, _request: MavlinkMessage) -> Iterator[MavlinkMessage]:
        self._entries, self._until_bytes = [], 0
        yield from ()

    def _erase(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]:
        self._px4.flight_logs.erase()
        self._listed = []
        yield from self._end(request)
