"""The datagrams of one vehicle without its flight and without identities: publishes at 50 Hz and listens to the others.

    python -m tests.bench.programs.datagram_vehicle VEHICLE_FILE

It prints `heard` when every other vehicle was heard, measures from the next line of its input on, and prints what it heard as
one line of JSON when its input ends.
"""

from __future__ import annotations

import logging
import sys
from contextlib import closing
from pathlib import Path

import msgspec
from msgspec.structs import replace

from companion.config.vehicle import load_agent
from companion.link.byte_links import LinkError
from companion.link.fleet.peer_datagrams import PeerDatagrams
from tests.bench.programs.vehicle import Input, TickGrid, example_packet, ignore_refused


class Heard(msgspec.Struct, frozen=True):
    """Of the vehicle that was heard worst: longest time without a packet, and the time since the last one, in seconds."""

    longest_s: float
    since_s: float
    logged: tuple[str, ...]


class Lines(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def main(file: Path) -> None:
    config, log, talk, grid = load_agent(file), Lines(), Input(), TickGrid()
    logging.getLogger().addHandler(log)
    assert config.datagrams
    packet, own_id = example_packet(config.vehicle.id), config.vehicle.id
    others = {member.id for member in config.fleet.vehicles} - {own_id}
    last_s: dict[int, float] = {}
    longest_s, is_said, is_measuring = 0.0, False, False
    with closing(PeerDatagrams(config.datagrams, config.fleet, ignore_refused)) as datagrams:
        while not talk.ended.is_set():
            now_s = grid.wait()
            if talk.begun.is_set() and not is_measuring:
                is_measuring, last_s = True, dict.fromkeys(others, now_s)
            for one in datagrams.receive(now_s):
                last_s[one.packet.sender.vehicle_id] = now_s
            if not is_said and last_s.keys() >= others:
                is_said = True
                print("heard", flush=True)
            if is_measuring:
                longest_s = max(longest_s, *(now_s - at_s for at_s in last_s.values()))
            sender = replace(packet.sender, sequence=packet.sender.sequence + 1)
            packet = replace(packet, sender=sender, motion=replace(packet.motion, sent_s=now_s))
            datagrams.publish_peer(packet)
    since_s = max(now_s - at_s for at_s in last_s.values())
    print(msgspec.json.encode(Heard(longest_s, since_s, tuple(log.lines))).decode(), flush=True)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except LinkError as error:
        print(error, flush=True)
