"""A link to the autopilot that hands every packet it sends to a recorder."""

from __future__ import annotations

from collections.abc import Callable

from companion.link.mavlink_link import MavlinkLink
from companion.link.tick import monotonic_s

RecordPacket = Callable[[bytes, float], None]  # (packet, time on the monotonic clock)


class RecordedLink:
    """A MavlinkLink. What arrives is recorded where it is decoded, packet by packet."""

    def __init__(self, link: MavlinkLink, record: RecordPacket) -> None:
        self._link, self._record = link, record

    def send(self, data: bytes) -> None:
        self._link.send(data)
        self._record(data, monotonic_s())

    def offer(self, data: bytes) -> bool:
        if sent := self._link.offer(data):
            self._record(data, monotonic_s())
        return sent

    async def run(self) -> None:
        await self._link.run()

    def problem(self) -> str:
        return self._link.problem()

    def close(self) -> None:
        self._link.close()
