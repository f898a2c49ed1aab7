"""The wire to the autopilot: UDP, TCP or a serial line. Bytes in, bytes out; what they mean is `mavlink/`'s.

Nothing waits in a queue here: what cannot be sent now is dropped, for a setpoint that comes late is worse than none.
"""

from __future__ import annotations

from typing import Protocol

from companion.link.endpoint import LinkError, Received
from companion.link.stream_link import SerialLine, StreamLink, TcpConnection
from companion.link.udp_link import UdpLink

LONGEST_NUMBER = 9  # digits; Python refuses to read thousands of them


class MavlinkLink(Protocol):
    """One way to the autopilot."""

    def send(self, data: bytes) -> None:
        """Hand one message to the operating system, now or never. Never raises, never blocks."""

    def offer(self, data: bytes) -> bool:
        """Like `send`, but for what may wait: only while hardly anything is under way. False: not now."""

    async def run(self) -> None:
        """Receive until cancelled; a lost connection is made again."""

    def problem(self) -> str:
        """Why nothing is heard, as far as this end knows."""

    def close(self) -> None: ...


def open_link(endpoint: str, received: Received) -> MavlinkLink:
    """The link for "udpin:HOST:PORT", "tcp:HOST:PORT" or "serial:DEVICE:BAUD". Raises LinkError."""
    kind, _, rest = endpoint.partition(":")
    address, _, number = rest.rpartition(":")
    if len(number) > LONGEST_NUMBER:
        raise LinkError(f"the number at its end has {len(number)} digits")
    if kind == "serial":
        return StreamLink(SerialLine(address, int(number)), received)
    if not 0 < int(number) <= 65535:
        raise LinkError(f"port {number}, expected 1 to 65535")
    if kind == "tcp":
        return StreamLink(TcpConnection(address, int(number)), received)
    return UdpLink(address, int(number), received)
