"""TCP between two agents: bytes are never lost; a lost segment is sent again, and all that follow wait for it.

A model of a sender for small messages: what is written while a segment waits for its retransmission goes out with it. The
first retransmission comes after a round trip, when later segments show the loss (RFC 8985), the next ones after the
retransmission timeout, which doubles each time (RFC 6298, with the least timeout of Linux).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from sitl.links.impairment import Path

SHOWN_BY_LATER_SEGMENTS_S = 0.02  # they follow one tick later
LEAST_TIMEOUT_S = 0.2
LONGEST_TIMEOUT_S = 120.0
WAITING_BYTES = 1 << 20  # then the sender is no longer read

Connect = Callable[[], Awaitable[asyncio.StreamWriter]]


class StreamDirection:
    """One direction of one connection. `connect` opens the receiver's end when the first segment arrives."""

    def __init__(self, path: Path, reader: asyncio.StreamReader, connect: Connect, epoch_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._path, self._reader, self._connect, self._epoch_s = path, reader, connect, epoch_s
        self._written, self._waiting, self._is_open = bytearray(), asyncio.Event(), True
        self._in_transit: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        self._is_connected = False

    async def run(self) -> None:
        """Pass bytes on until the sender closes. Raises OSError where the receiver has closed."""
        async with asyncio.TaskGroup() as group:
            for part in (self._read, self._transmit, self._deliver):
                group.create_task(part())

    async def _read(self) -> None:
        while self._is_open:
            while len(self._written) > WAITING_BYTES:
                await asyncio.sleep(0.01)
            data = b""
            with suppress(ConnectionError):
                data = await self._reader.read(65_536)
            self._written += data
            self._is_open = bool(data)
            self._waiting.set()

    async def _transmit(self) -> None:
        arrives_s = 0.0
        while self._is_open or self._written:
            await self._waiting.wait()
            self._waiting.clear()
            await self._until_sent_once()
            if not self._is_open and not self._is_connected:
                break  # the sender gave up before the connection was established
            segment, self._written = bytes(self._written), bytearray()
            arrives_s = max(arrives_s, self._loop.time() + self._path.delay_s())
            self._in_transit.put_nowait((arrives_s, segment))
        self._in_transit.put_nowait((arrives_s, b""))

    async def _until_sent_once(self) -> None:
        """Wait for the retransmissions of the first segment that waits."""
        links = self._path.links
        round_trip_s = 2.0 * links.peer_delay_s + links.peer_jitter_s
        wait_s, timeout_s = round_trip_s + SHOWN_BY_LATER_SEGMENTS_S, max(LEAST_TIMEOUT_S, 2.0 * round_trip_s)
        while self._path.loses() or self._path.is_cut(self._loop.time() - self._epoch_s):
            await asyncio.sleep(wait_s)
            wait_s, timeout_s = timeout_s, min(2.0 * timeout_s, LONGEST_TIMEOUT_S)

    async def _deliver(self) -> None:
        writer: asyncio.StreamWriter | None = None
        try:
            while True:
                arrives_s, segment = await self._in_transit.get()
                await asyncio.sleep(arrives_s - self._loop.time())
                if not segment:
                    return
                writer, self._is_connected = writer or await self._connect(), True
                writer.write(segment)
                await writer.drain()
        finally:
            if writer:
                writer.close()
