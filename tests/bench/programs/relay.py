"""A wire between an autopilot and its client that measures, from outside, the time from a position to the command for it.

    python -m tests.bench.programs.relay AUTOPILOT_PORT CLIENT_PORT FILE

It receives the autopilot's packets on AUTOPILOT_PORT of this machine, forwards them to CLIENT_PORT, and the client's packets
back. For the first attitude target after each position it writes a line: time of the position's forwarding
(CLOCK_MONOTONIC, seconds), and microseconds until the command. The kernel's time stamp of the command counts, so that the
waking of this process is no part of it.
"""

from __future__ import annotations

import selectors
import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from sitl.links.ports import LOOPBACK

POSITION, ATTITUDE_TARGET = 32, 82  # LOCAL_POSITION_NED, SET_ATTITUDE_TARGET
SO_TIMESTAMPNS = 35  # Linux; not in Python's socket module
READ_BYTES = 65_536
V1, V2, SIGNED = 0xFE, 0xFD, 0x01


def message_ids(data: bytes) -> Iterator[int]:
    """Ids of the MAVLink messages of a datagram, which has whole messages only."""
    at = 0
    while at + 8 <= len(data):
        if data[at] == V2 and at + 12 <= len(data):
            yield int.from_bytes(data[at + 7 : at + 10], "little")
            at += 12 + data[at + 1] + (13 if data[at + 2] & SIGNED else 0)
        elif data[at] == V1:
            yield data[at + 5]
            at += 8 + data[at + 1]
        else:
            return


class Relay:
    """The two sockets, and the position that waits for its command."""

    def __init__(self, autopilot_port: int, client_port: int, out: TextIO) -> None:
        self.out = out
        self._autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._autopilot.bind((LOOPBACK, autopilot_port))
        self._client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._client.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._client.bind((LOOPBACK, 0))
        self._client_address = (LOOPBACK, client_port)
        self._autopilot_address: tuple[str, int] | None = None
        self._waiting: tuple[float, int] | None = None  # position forwarded: monotonic seconds, real time in ns

    def run(self) -> None:
        """Until the process is ended."""
        with selectors.DefaultSelector() as selector:
            self.register(selector)
            while True:
                for key, _ in selector.select():
                    key.data()

    def register(self, selector: selectors.BaseSelector) -> None:
        """The data of its keys are to be called where there is something to read."""
        selector.register(self._autopilot, selectors.EVENT_READ, self._from_autopilot)
        selector.register(self._client, selectors.EVENT_READ, self._from_client)

    def _from_autopilot(self) -> None:
        data, self._autopilot_address = self._autopilot.recvfrom(READ_BYTES)
        if POSITION in message_ids(data):
            self._waiting = (time.monotonic(), time.time_ns())
        try:
            self._client.sendto(data, self._client_address)
        except OSError:
            self._waiting = None  # the client does not listen yet

    def _from_client(self) -> None:
        try:
            data, ancillary, _, _ = self._client.recvmsg(READ_BYTES, 64)
        except OSError:
            return  # an ICMP error for an earlier packet
        if self._autopilot_address:
            self._autopilot.sendto(data, self._autopilot_address)
        for level, kind, value in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS):
                seconds, nanoseconds = struct.unpack("@qq", value)
                self.sent(data, seconds * 1_000_000_000 + nanoseconds)

    def sent(self, data: bytes, at_ns: int) -> None:
        """The client has sent this datagram, at this time of the real-time clock."""
        if self._waiting and ATTITUDE_TARGET in message_ids(data):
            (forwarded_s, forwarded_ns), self._waiting = self._waiting, None
            self.out.write(f"{forwarded_s:.6f} {(at_ns - forwarded_ns) / 1e3:.1f}\n")


def commands_of(file: Path) -> list[tuple[float, float]]:
    """All complete lines of a relay's file: time of the position in seconds, and us to its command."""
    lines = file.read_text(encoding="ascii").split("\n")[:-1] if file.exists() else []
    pairs = (line.split() for line in lines)
    return [(float(at_s), float(took_us)) for at_s, took_us in pairs]


def main() -> None:
    with Path(sys.argv[3]).open("w", encoding="ascii", buffering=1) as out:
        Relay(int(sys.argv[1]), int(sys.argv[2]), out).run()


if __name__ == "__main__":
    main()
