"""The cameras of a fleet of stand-ins and its wires to the autopilots: from a published pose to the packet for the autopilot.

    python -m tests.bench.programs.pose_source FLEET PORT_OFFSET FILE ID...

Each stand-in is behind a relay. Its true poses are published at 100 Hz. For each pose that comes back to the autopilot FILE
has a line: its arrival (CLOCK_MONOTONIC, seconds), and microseconds from before its publication to the kernel's time stamp.
"""

from __future__ import annotations

import selectors
import socket
import struct
import sys
import time
from itertools import count
from pathlib import Path
from typing import TextIO

from companion.ground.publishers import PosePublisher
from sitl.links.cameras import TRUTH
from sitl.links.ports import LOOPBACK, capture_ports, ports_of, zenoh_endpoint
from tests.bench.programs.relay import READ_BYTES, Relay, message_ids

PERIOD_S = 0.01
POSE = 102  # VISION_POSITION_ESTIMATE
NORTH = slice(18, 22)  # of its packet: x, of which each pose has another one
FLOAT = struct.Struct("<f")
SPARE = 100  # ports of vehicles with ids so much higher are free for the agents


class PoseRelay(Relay):
    """`put_ns`: when poses were published, by their x on the wire."""

    def __init__(self, vehicle_id: int, offset: int, out: TextIO) -> None:
        super().__init__(ports_of(vehicle_id, offset).companion, ports_of(vehicle_id + SPARE, offset).companion, out)
        self.put_ns: dict[bytes, int] = {}

    def sent(self, data: bytes, at_ns: int) -> None:
        if POSE in message_ids(data) and (put_ns := self.put_ns.pop(data[NORTH], None)):
            self.out.write(f"{time.monotonic():.6f} {(at_ns - put_ns) / 1e3:.1f}\n")


def run(fleet: str, offset: int, ids: list[int], out: TextIO) -> None:
    """In one thread, until the process is ended: nothing delays a publication that has begun."""
    relays = {i: PoseRelay(i, offset, out) for i in ids}
    truths: dict[int, list[float]] = {}
    truth_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    truth_socket.bind((LOOPBACK, capture_ports(offset).truth))

    def read_truth() -> None:
        vehicle_id, _, *truths[vehicle_id] = TRUTH.unpack(truth_socket.recv(READ_BYTES))

    with (
        PosePublisher(fleet, [zenoh_endpoint(i, offset) for i in ids]) as cameras,
        selectors.DefaultSelector() as ready,
    ):
        ready.register(truth_socket, selectors.EVENT_READ, read_truth)
        for relay in relays.values():
            relay.register(ready)
        due_s = time.monotonic()
        for number in count():
            due_s = max(due_s + PERIOD_S, time.monotonic())
            while (wait_s := due_s - time.monotonic()) > 0.0:
                for key, _ in ready.select(wait_s):
                    key.data()
            for i, (x, y, z, _, _, _, *quaternion) in truths.items():
                north_m = y + 1e-5 * (number % 100)
                w, qx, qy, qz = quaternion
                relays[i].put_ns[FLOAT.pack(north_m)] = time.time_ns()
                cameras.publish(i, (x, north_m, z), (w, qx, qy, qz))


if __name__ == "__main__":
    with Path(sys.argv[3]).open("w", encoding="ascii", buffering=1) as lines:
        run(sys.argv[1], int(sys.argv[2]), list(map(int, sys.argv[4:])), lines)
