"""Byte links to the autopilot: UDP, TCP or serial. `companion.mavlink` encodes and decodes the bytes.

Nothing is queued: data that cannot be sent now is dropped, because a late setpoint is worse than none.
"""

from __future__ import annotations

from typing import Protocol

from companion.link.endpoint import AllRead, LinkError, Received
from companion.link.stream_link import SerialLine, StreamLink, TcpConnection
from companion.link.udp_link import UdpLink

LONGEST_NUMBER = 9  # digits; Python refuses to parse thousands of them


class MavlinkLink(Protocol):
    """A byte link to the autopilot."""

    def send(self, data: bytes) -> None:
        """Hand one message to the operating system, or drop it. Never raises, never blocks."""

    def offer(self, data: bytes) -> bool:
        """Like `send`, for data that may wait: only while the link is nearly free. Returns whether it was sent."""

    async def run(self) -> None:
        """Receive until cancelled; a lost connection is opened again."""

    def problem(self) -> str:
        """Why nothing is received, as far as this end knows."""

    def close(self) -> None:
        """Close the link."""


def open_link(endpoint: str, received: Received, all_read: AllRead) -> MavlinkLink:
    """The link for "udpin:HOST:PORT", "tcp:HOST:PORT" or "serial:DEVICE:BAUD". Raises LinkError."""
    kind, _, rest = endpoint.partition(":")
    address, _, number = rest.rpartition(":")
    if len(number) > LONGEST_NUMBER:
        raise LinkError(f"the number at the end has {len(number)} digits, expected at most {LONGEST_NUMBER}")
    if kind == "serial":
        return StreamLink(SerialLine(address, int(number)), received, all_read)
    if not 0 < int(number) <= 65535:
        raise LinkError(f"port {number}, expected 1 to 65535")
    if kind == "tcp":
        return StreamLink(TcpConnection(address, int(number)), received, all_read)
    return UdpLink(address, int(number), received, all_read)
