"""CPU of an agent for each further peer: what it reads and decides with 15 peers and with 3, in turn."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from pathlib import Path
from statistics import median

from msgspec.structs import replace

from companion.config.vehicle import load_agent
from companion.link.fleet.peer_datagrams import PeerDatagrams
from companion.link.tick import PERIOD_S
from sitl.flight.files import autopilots_of, ids_of, write_files
from sitl.links.free_ports import reserved_ports
from tests.bench.agent_step import recorded, step_times_us
from tests.bench.figures import REPEATS, Row, Section, Target
from tests.bench.programs.vehicle import example_packet, ignore_refused
from tests.bench.scenarios import line

FEW, MANY = 3, 15  # peers
ROUNDS = 50  # of reading, in each pass
US_FOR_A_PERCENT = PERIOD_S * 1e6 / 100.0
HOW = """\
Two fleets in a line fly in virtual time and record their inputs, one with 3 and one with 15 peers of each agent; vehicle \
2 has two neighbours in both. Its inputs are fed to new agents in this process, with both fleets in turn, each tick after \
20 ms without work. The other row is the time in which the agent's datagram socket, also after 20 ms without work, reads \
and decodes what 15 other sockets have sent, and what 3 have sent. Of each pass the figure is the difference of the two \
medians, divided by 12. Both together, 50 times a second, are the share of a core. So no figure depends on what else a \
flight of sixteen agents does to this machine."""


def measure(folder: Path) -> Section:
    """Files of the flights are written below `folder`."""
    fleets = {peers: recorded(line(peers + 1, 4.0), folder / f"peers_{peers}") for peers in (FEW, MANY)}
    steps, reading = [], []
    for _ in range(REPEATS):
        took_us = {peers: median(step_times_us(*fleets[peers], PERIOD_S)) for peers in fleets}
        steps.append(_each(took_us))
        reading.append(_each(_read_us(folder / "datagrams")))
    shares = tuple((step + read) / US_FOR_A_PERCENT for step, read in zip(steps, reading, strict=True))
    span = f"for each further peer, from {FEW} to {MANY}"
    return Section(
        title="CPU for each further peer",
        how=HOW,
        rows=(
            Row(what=f"Agent.step {span}", unit="us", values=tuple(steps)),
            Row(what=f"reading and decoding {span}", unit="us", values=tuple(reading)),
            Row(what=f"CPU {span}", unit="% of a core", values=shares, target=Target("value", most=0.15)),
        ),
    )


def _each(of_peers: dict[int, float]) -> float:
    return (of_peers[MANY] - of_peers[FEW]) / (MANY - FEW)


def _read_us(folder: Path) -> dict[int, float]:
    """Median time of `PeerDatagrams.receive` by the number of peers that have sent."""
    folder.mkdir(exist_ok=True)
    scenario = line(MANY + 1, 1.0)
    ids = [int(i) for i in ids_of(scenario)]
    with reserved_ports(autopilots_of(scenario), None) as offset, ExitStack() as stack:
        write_files(scenario, folder, offset)
        own, *others = [stack.enter_context(closing(_datagrams(folder / f"vehicle_{i}.yaml"))) for i in ids]
        packets = {i: example_packet(i) for i in ids[1:]}
        took_us: dict[int, list[float]] = {FEW: [], MANY: []}
        for number in range(2 * ROUNDS):
            peers = (FEW, MANY)[number % 2]
            for other, packet in zip(others[:peers], packets.values(), strict=False):
                other.publish_peer(replace(packet, sender=replace(packet.sender, sequence=number)))
            time.sleep(PERIOD_S)
            began_ns = time.perf_counter_ns()
            received = own.receive(time.monotonic())
            took_us[peers].append((time.perf_counter_ns() - began_ns) / 1e3)
            if len(received) != peers:
                raise RuntimeError(f"{len(received)} of {peers} datagrams arrived")
    return {peers: median(times_us) for peers, times_us in took_us.items()}


def _datagrams(file: Path) -> PeerDatagrams:
    config = load_agent(file)
    assert config.datagrams
    return PeerDatagrams(config.datagrams, config.fleet, ignore_refused)
