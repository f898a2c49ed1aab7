"""ArduPilot's logs: its format (DataFlash, .bin), and its side of the log protocol.

It answers only on the ground, on one link at a time, with a few packets per loop.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import degrees

from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.autopilot import ERROR, INFO, Autopilot
from sitl.autopilots.logs import CHUNK_BYTES, Answers, Handler, log_data, log_requests
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
# As measured over TCP: 1600 entries and 1.3 MB a second.
ENTRIES_PER_STEP, PACKETS_PER_STEP = 6, 58
HIGHEST_ID = 0xFFFF


def dataflash_head() -> bytes:
    """FMT messages, which describe all messages."""
    return b"".join(
        _message("FMT", number, len(HEAD) + 1 + struct.calcsize(fields), name.encode(), form.encode(), columns.encode())
        for number, name, fields, form, columns in MESSAGES
    )


def dataflash_row(copter: Autopilot) -> bytes:
    time_us = round(copter.time_s * 1e6)
    angles, position = attitude(copter), global_position(copter)
    assert position is not None  # it sends zeros where it knows none
    angles_deg = (degrees(angles.roll), degrees(angles.pitch), degrees(angles.yaw) % 360.0)
    return _message("ATT", time_us, *angles_deg) + _message(
        "POS", time_us, position.lat, position.lon, position.alt / 1e3, position.relative_alt / 1e3
    )


def _message(name: str, *values: float | bytes) -> bytes:
    number, fields = PACKED[name]
    return HEAD + bytes([number]) + fields.pack(*values)


@dataclass(slots=True)
class LogService:
    """The link whose log request is served, and whether the refusal while armed was sent."""

    link: object | None = None
    refusal_sent: bool = False


class ArduPilotLogTransfer:
    """Log transfer on one link. Ids count from 1. `text` makes the STATUSTEXT of this link alone."""

    def __init__(self, copter: Autopilot, service: LogService, text: Callable[[int, str], Answers]) -> None:
        handlers = (partial(self._on_ground, handle) for handle in (self._list, self._data, self._end, self._erase))
        self.requests = log_requests(*handlers)
        self._copter = copter
        self._service = service
        self._text = text
        self._next_id, self._last_id, self._number = 0, 0, 0
        self._is_listing = False
        self._sent_id, self._sent_bytes, self._left_bytes = 0, 0, 0

    def due(self) -> Answers:
        for _ in range(ENTRIES_PER_STEP if self._is_listing else PACKETS_PER_STEP):
            if self._service.link is not self or self._copter.armed:
                return
            yield self._next_entry() if self._is_listing else self._next_data()

    def _next_entry(self) -> MavlinkMessage:
        """A list that begins past its end continues with empty logs until its last id comes round."""
        number, reply = self._next_id, self._date_and_size(self._next_id)
        self._next_id = (self._next_id + 1) & HIGHEST_ID
        if number == self._last_id:
            self._stop_serving()
        return mavlink.MAVLink_log_entry_message(number, self._number, self._last_id, *reply)

    def _date_and_size(self, number: int) -> tuple[int, int]:
        """Date and size of a log. The newest log is open until the next start; its date is the present time."""
        logs, time_s = self._copter.flight_logs, self._copter.time_s
        if not 1 <= number <= len(logs.files):
            return 0, 0
        log = logs.files[number - 1]
        return logs.utc_s(time_s if log is logs.files[-1] else log.written_s), len(log.content)

    def _next_data(self) -> MavlinkMessage:
        """Past its end a log has one empty packet. A packet that is not full ends the transfer."""
        file = self._copter.flight_logs.files[self._sent_id - 1].content
        content = bytes(file[self._sent_bytes : self._sent_bytes + min(self._left_bytes, CHUNK_BYTES)])
        reply = log_data(self._sent_id, self._sent_bytes, content)
        self._sent_bytes += len(content)
        self._left_bytes -= len(content)
        if len(content) < CHUNK_BYTES or not self._left_bytes:
            self._stop_serving()
        return reply

    # ------------------------------------------------------------ requests

    def _on_ground(self, handle: Handler, request: MavlinkMessage) -> Answers:
        """Armed, requests are refused; the text is sent once until a request comes while disarmed."""
        if not self._copter.armed:
            self._service.refusal_sent = False
            yield from handle(request) or ()
        elif not self._service.refusal_sent:
            self._service.refusal_sent = True
            yield from self._text(ERROR, "Disarm for log download")

    def _list(self, request: MavlinkMessage) -> Answers:
        if self._service.link is not None:
            yield from self._text(INFO, "Log download in progress")
        else:
            self._number = len(self._copter.flight_logs.files)
            self._next_id = max(request.start, 1) if self._number else 0
            self._last_id = min(request.end, self._number)
            self._is_listing = True
            self._service.link = self

    def _data(self, request: MavlinkMessage) -> Answers:
        served = self._service.link
        if served is not None:  # a request on the same link is dropped silently
            if served is not self:
                yield from self._text(INFO, "Log download in progress")
        elif 1 <= request.id <= len(self._copter.flight_logs.files):
            size_bytes = len(self._copter.flight_logs.files[request.id - 1].content)
            self._sent_id, self._sent_bytes = request.id, request.ofs
            self._left_bytes = min(max(size_bytes - request.ofs, 0), request.count)
            self._is_listing = False
            self._service.link = self
            self._copter.flight_logs.pause()  # it does not write logs while it reads them

    def _end(self, _request: MavlinkMessage) -> None:
        self._stop_serving()

    def _erase(self, request: MavlinkMessage) -> None:
        self._copter.flight_logs.erase()
        self._end(request)

    def _stop_serving(self) -> None:
        self._service.link = None
        self._copter.flight_logs.resume()
