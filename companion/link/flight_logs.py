"""The autopilot's flight logs, by the log messages of MAVLink: the list, and one log at a time.

mavsdk's plugin expects numbers without gaps from 0 or 1 on. An ArduPilot that has deleted its oldest logs begins anywhere, and
logs whose file is missing are listed with size 0. Here each entry counts as it comes.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink, read_packet
from companion.types.errors import CompanionError

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
LAST_NUMBER = 0xFFFF  # in a request for the list: up to the last
LIST_TRIES = 3  # without anything new
FIRST_ENTRY_WITHIN_S = 5.0  # an autopilot may read its card first
NEXT_ENTRY_WITHIN_S, QUIET_S = 1.0, 0.3  # a new one in an incomplete list; after a complete one
POLL_PERIOD_S = 0.25
PACKET_BYTES = 90  # of LOG_DATA
WINDOW_BYTES = 512 * PACKET_BYTES  # asked for at once
ASK_AGAIN_S = 0.4  # without a packet
STALLED_AFTER_S = 20.0  # without a new byte
FIRST_SET_YEAR = 2000  # an autopilot clock that was never set is in 1970 or 1980


class FlightLogsError(CompanionError):
    """A list or a log that could not be read. `str()` is the reason."""


class NothingCameError(FlightLogsError):
    """The autopilot did not answer, or stopped answering."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One log of the autopilot's list (LOG_ENTRY), under the autopilot's own number.

    `date_utc` is the time of the last write; None where the autopilot's clock was not set. `file` is its copy after a download.
    """

    id: int
    date_utc: datetime | None
    size_bytes: int
    file: str = ""


class FlightLogs:
    """Logs of one autopilot. They are never erased."""

    def __init__(self, vehicle_id: int, send: Callable[[bytes], None]) -> None:
        """`send` gets packets that the link sends as its own."""
        self._vehicle_id, self._send_packet = vehicle_id, send
        self._codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._came = asyncio.Event()
        self._listed: dict[int, LogEntry] = {}
        self._expected: tuple[int, int] | None = None  # how many logs there are, and the last number, as entries say
        self._transfer: _Transfer | None = None

    def receive(self, packets: Sequence[bytes]) -> None:
        """Packets of the link, in the running loop."""
        for data in packets:
            packet = read_packet(data)
            if packet is None or packet.system_id != self._vehicle_id:
                continue
            if packet.message_id == mavlink.MAVLINK_MSG_ID_LOG_ENTRY:
                if not self._is_new(packet.fields):
                    continue
            elif packet.message_id == mavlink.MAVLINK_MSG_ID_LOG_DATA and self._transfer:
                offset, number, count, *content = packet.values
                self._transfer.take(number, offset, bytes(content[:count]))
            else:
                continue
            self._came.set()

    async def entries(self) -> tuple[LogEntry, ...]:
        """All logs in order of number; empty where the autopilot reports none. Raises NothingCameError without an answer.

        The request is repeated while entries are missing by what the others say, and until that brings nothing new: a list
        may have fewer than it says.
        """
        self._listed, self._expected = {}, None
        tries = 0
        while tries < LIST_TRIES:
            before = len(self._listed)
            self._send(mavlink.MAVLink_log_request_list_message(self._vehicle_id, AUTOPILOT, 0, LAST_NUMBER))
            while await self._comes(self._patience_s()):
                pass
            if self._is_complete():
                break
            tries = 0 if len(self._listed) > before else tries + 1
        if self._expected is None:
            raise NothingCameError("no answer to the request for its list")
        return tuple(entry for _, entry in sorted(self._listed.items()))

    async def download(self, log: LogEntry, path: Path) -> AsyncGenerator[int, None]:
        """Write a listed log to `path`, which must not exist. Yields the number of bytes written, often, until it is complete.

        Ended early it ends the transfer. Raises NothingCameError and OSError.
        """
        shown_s = time.monotonic()
        with path.open("xb") as file:
            try:
                for begin in range(0, log.size_bytes, WINDOW_BYTES):
                    transfer = _Transfer(log.id, begin, min(begin + WINDOW_BYTES, log.size_bytes))
                    self._transfer, asked_s = transfer, time.monotonic()
                    while (asked := transfer.missing()) is not None:
                        now_s = time.monotonic()
                        if now_s - max(transfer.grew_s, asked_s) > STALLED_AFTER_S:
                            raise NothingCameError(f"no data for {STALLED_AFTER_S:.0f} s")
                        if transfer.is_due(now_s):
                            transfer.ask(now_s, *asked)
                            self._send(
                                mavlink.MAVLink_log_request_data_message(self._vehicle_id, AUTOPILOT, log.id, *asked)
                            )
                        await self._comes(POLL_PERIOD_S)
                        if now_s - shown_s >= POLL_PERIOD_S:
                            shown_s = now_s
                            yield begin + transfer.complete_bytes
                    file.write(transfer.content)
                yield log.size_bytes
            finally:
                self._transfer = None
                self._end()

    def close(self) -> None:
        """End a transfer, which an autopilot would go on with."""
        self._end()

    def _is_new(self, entry: MavlinkMessage) -> bool:
        """Take an entry. Whether it says something new: what repeats itself for ever ends as silence does."""
        before = (self._expected, len(self._listed))
        self._expected = (entry.num_logs, entry.last_log_num)
        if entry.num_logs:
            date = datetime.fromtimestamp(entry.time_utc, UTC)
            self._listed[entry.id] = LogEntry(entry.id, date if date.year >= FIRST_SET_YEAR else None, entry.size)
        return (self._expected, len(self._listed)) != before

    def _is_complete(self) -> bool:
        if self._expected is None:
            return False
        number, last = self._expected
        return number == 0 or (len(self._listed) >= number and last in self._listed)

    def _patience_s(self) -> float:
        if self._expected is None:
            return FIRST_ENTRY_WITHIN_S
        return QUIET_S if self._is_complete() else NEXT_ENTRY_WITHIN_S

    async def _comes(self, within_s: float) -> bool:
        """Whether something comes within this time."""
        try:
            async with asyncio.timeout(within_s):
                await self._came.wait()
        except TimeoutError:
            return False
        self._came.clear()
        return True

    def _end(self) -> None:
        self._send(mavlink.MAVLink_log_request_end_message(self._vehicle_id, AUTOPILOT))

    def _send(self, message: MavlinkMessage) -> None:
        self._send_packet(self._codec.encode(message))


class _Transfer:
    """The bytes of a log from `begin` to `end`, of which those that are lost are asked for again."""

    def __init__(self, number: int, begin: int, end: int) -> None:
        self._number, self._begin = number, begin
        self.content = bytearray(end - begin)
        self._lacks = dict.fromkeys(range(begin, end, PACKET_BYTES))  # offsets, in order
        self._asked_to = 0  # end of the last request
        self._heard_s = -1.0
        self.grew_s = -1.0  # when a new byte came last

    @property
    def complete_bytes(self) -> int:
        """Bytes up to the first that is missing."""
        return next(iter(self._lacks), self._begin + len(self.content)) - self._begin

    def missing(self) -> tuple[int, int] | None:
        """(offset, count) of the first bytes that are missing; None without any."""
        if not self._lacks:
            return None
        begin = end = next(iter(self._lacks))
        while end in self._lacks:
            end += PACKET_BYTES
        return begin, min(end, self._begin + len(self.content)) - begin

    def is_due(self, now_s: float) -> bool:
        """Whether to ask: at first, after the end of what was asked for, and after a silence."""
        return self._asked_to == 0 or now_s - self._heard_s > ASK_AGAIN_S

    def ask(self, now_s: float, offset: int, count: int) -> None:
        self._asked_to, self._heard_s = offset + count, now_s

    def take(self, number: int, offset: int, content: bytes) -> None:
        """A packet. Of another log, or with another length than its place in this one, it is none of this transfer."""
        end = self._begin + len(self.content)
        if number != self._number or offset not in self._lacks or len(content) != min(PACKET_BYTES, end - offset):
            return
        self.content[offset - self._begin : offset - self._begin + len(content)] = content
        del self._lacks[offset]
        self._heard_s = self.grew_s = time.monotonic()
        if offset + len(content) >= self._asked_to:
            self._asked_to = 0  # what is still missing was lost
