"""The Zenoh link of an agent against a client that floods it with commands and reads no reply. Real processes."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from itertools import count

import pytest
import zenoh
from msgspec.structs import replace

from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.vehicle import ZenohEndpoints
from companion.core.command.arbitration import CommandArbitration
from companion.ground.session import FleetSession
from companion.link.fleet.peer_states import CHANGES_PER_TICK
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.fleet.zenoh_session import open_session
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Answer, Code, Notice
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.wire.keys import abort_key, peer_key
from companion.wire.messages import encode
from processes import free_port

FLEET = FleetConfig(
    name="floodtest",
    origin="indoor",
    vehicles=(FormationMember(id=1, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),),
    neighbours=EdgeNeighbours(edges=()),
)
ZERO = (0.0, 0.0, 0.0)
PACKET = PeerPacket(
    sender=Sender(vehicle_id=1, session=7, sequence=1, formation_hash=5),
    phase=FlightPhase.HOLD,
    role=Role.LEADER,
    motion=Motion(position_enu_m=ZERO, velocity_enu_m_s=ZERO, acceleration_enu_m_s2=ZERO, state_age_s=0.01, sent_s=0.0),
    leader=LeaderReport(prc=1, beacon=None),
    slot=FlownSlot(ZERO),
)
PERIOD_S = 0.02
ABORTS = 10
BLOCKED_S = 0.25  # a tick of this length was blocked: it was 5 s, and is 1 ms on an idle machine

# FifoChannel(1) is full after one packet; then Zenoh's reading thread in that process waits, and its connection fills.
DEAF_CLIENT = """
import time, zenoh
from companion.link.fleet.zenoh_session import BATCH_BYTES, open_session
from companion.types.commands import Command, CommandName
from companion.wire.messages import encode
session = open_session([], ["{endpoint}"])
deaf = session.declare_subscriber("formation/floodtest/peer/*", zenoh.handlers.FifoChannel(1))
replies = session.declare_subscriber("formation/floodtest/reply/*", zenoh.handlers.FifoChannel(1))
number = 0
while True:
    for _ in range(50):
        number += 1
        command = Command(CommandName.HOLD, number, "deaf", 7)
        session.put("formation/floodtest/command/1/deaf", encode(command), express=True)
    time.sleep(0.005)
"""


# More than 4 samples in each tick, of garbage and of other commands, on the key that has ABORT alone.
ABORT_FLOOD = """
import time, zenoh
from companion.link.fleet.zenoh_session import BATCH_BYTES, open_session
from companion.types.commands import Command, CommandName
from companion.wire.messages import encode
session = open_session([], ["{endpoint}"])
number = 0
while True:
    for _ in range(20):
        number += 1
        session.put("formation/floodtest/abort/1/mallory", bytes(range(100)), express=True)
        command = encode(Command(CommandName.LAND, number, "mallory", 7))
        session.put("formation/floodtest/abort/1/mallory", command, express=True)
    time.sleep(0.01)
"""


class Vehicle:
    """A link with the agent's arbitration behind it, ticked as by the control loop."""

    def __init__(self, link: ZenohLink) -> None:
        self._link = link
        self._arbitration = CommandArbitration(session=7)
        self.worst_s = 0.0
        self.received: Counter[CommandName] = Counter()

    def tick(self) -> None:
        start_s = time.monotonic()
        _, commands = self._link.receive(start_s)
        self.received.update(command.name for command in commands)
        self._link.reply(self._replies(commands))
        self._link.publish_peer(PACKET)
        self.worst_s = max(self.worst_s, time.monotonic() - start_s)

    def _replies(self, commands: tuple[Command, ...]) -> tuple[CommandReply, ...]:
        intake = self._arbitration.step(commands)
        done = Answer(True, Notice(Code.PHASE_CHANGED, "x" * 1900))
        return self._arbitration.replies(1, intake, [(command.number, done) for command in intake.admitted])

    def ticks(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.tick()
            time.sleep(PERIOD_S)


@pytest.fixture
def endpoint() -> str:
    import socket

    return f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"


@contextmanager
def deaf_client(endpoint: str, program: str = DEAF_CLIENT) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", program.format(endpoint=endpoint)], stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def test_a_client_that_reads_no_replies_does_not_block_the_tick(endpoint: str) -> None:
    rejected: Counter[str] = Counter()
    link = ZenohLink(1, FLEET, ZenohEndpoints(listen=(endpoint,)), lambda reason: rejected.update([reason]))
    with deaf_client(endpoint):
        vehicle = Vehicle(link)
        vehicle.ticks(8.0)
        start_s = time.monotonic()
        link.close()
        closed_s = time.monotonic() - start_s
    received = vehicle.received.total()
    print(
        f"\n{received} commands, longest tick {vehicle.worst_s * 1000:.1f} ms, closed in {closed_s:.2f} s, {rejected}"
    )
    assert received > 500  # enough replies to fill the connection
    assert vehicle.worst_s < BLOCKED_S
    assert closed_s < 5.0


@pytest.mark.parametrize("program", [DEAF_CLIENT, ABORT_FLOOD], ids=["commands", "abort key"])
def test_abort_passes_a_flood_and_is_repeated_until_answered(endpoint: str, program: str) -> None:
    rejected: Counter[str] = Counter()
    link = ZenohLink(1, FLEET, ZenohEndpoints(listen=(endpoint,)), lambda reason: rejected.update([reason]))
    with (
        closing(link),
        deaf_client(endpoint, program),
        FleetSession(FLEET.name, (endpoint,), "anna") as ground,
        ThreadPoolExecutor() as pool,
    ):
        vehicle = Vehicle(link)
        vehicle.ticks(2.0)
        answered, took_s = 0, []
        for _ in range(ABORTS):
            asked = pool.submit(ground.ask, (1,), CommandName.ABORT, 10.0)
            while not asked.done():
                vehicle.tick()
                time.sleep(PERIOD_S)
            answer = asked.result()[1]
            if answer is not None and answer.reply.accepted:
                answered += 1
                took_s.append(answer.after_s)
    print(f"\n{answered} of {ABORTS} answered, after {max(took_s, default=0.0) * 1000:.0f} ms at most")
    assert answered == ABORTS
    assert vehicle.worst_s < BLOCKED_S
    if program is ABORT_FLOOD:
        assert rejected[Code.COMMAND_MALFORMED] > 1000
        assert vehicle.received.keys() == {CommandName.ABORT}  # no other command is admitted by this key


def test_abort_is_received_among_other_messages_of_its_key_between_two_ticks(endpoint: str) -> None:
    link = ZenohLink(1, FLEET, ZenohEndpoints(listen=(endpoint,)), lambda _reason: None)
    session = open_session([], [endpoint])
    with closing(link), closing(session):
        key = abort_key(FLEET.name, 1, "anna")
        received: list[Command] = []
        for _ in range(200):
            for payload in (encode(Command(CommandName.ABORT, 1, "anna", 7)), *[b"garbage"] * 100):
                session.put(key, payload, express=True)
            time.sleep(PERIOD_S)
            received += link.receive(time.monotonic())[1]
            if received:
                break
    assert [command.name for command in received][:1] == [CommandName.ABORT]


# It reads nothing from its first packet on. Zenoh's threads in that process keep the connection alive.
DEAF_LISTENER = """
import time, zenoh
from companion.link.fleet.zenoh_session import open_session
session = open_session([], ["{endpoint}"])
deaf = session.declare_subscriber("formation/floodtest/peer/*", zenoh.handlers.FifoChannel(1))
while True:
    time.sleep(1.0)
"""
FILLS_WITHIN_S, CHANGES, CLOSED_WITHIN_S = 5.0, 300, 10.0


def test_a_client_that_reads_nothing_does_not_block_a_change_of_rates(endpoint: str) -> None:
    """Once its connection was full, the declarations of subscribers waited for it: one tick took 5 s."""
    others = frozenset(range(2, 65))
    large = replace(
        FLEET,
        vehicles=tuple(FormationMember(id=i, role=Role.LEADER, slot_enu_m=(3.0 * i, 0.0, 0.0)) for i in (1, *others)),
    )
    link = ZenohLink(1, large, ZenohEndpoints(listen=(endpoint,)), lambda _reason: None)
    with closing(link), deaf_client(endpoint, DEAF_LISTENER):
        until_s = time.monotonic() + 30.0
        while not link.session.info.peers_zid() and time.monotonic() < until_s:
            time.sleep(PERIOD_S)
        assert link.session.info.peers_zid()
        until_s = time.monotonic() + FILLS_WITHIN_S
        while time.monotonic() < until_s:  # the buffers of both computers' connections
            link.session.put(peer_key(FLEET.name, 1), bytes(60_000), congestion_control=zenoh.CongestionControl.DROP)
        worst_s = 0.0
        for change in range(CHANGES):
            distant = others if change % 2 == 0 else frozenset[int]()
            for _ in range(len(others) // CHANGES_PER_TICK + 1):
                start_s = time.monotonic()
                link.set_low_rate_peers(distant)
                worst_s = max(worst_s, time.monotonic() - start_s)
        until_s = time.monotonic() + CLOSED_WITHIN_S
        while (connected := bool(link.session.info.peers_zid())) and time.monotonic() < until_s:
            time.sleep(PERIOD_S)
    print(f"\nlongest call {worst_s * 1000:.1f} ms, the client is {'still' if connected else 'no longer'} connected")
    assert worst_s < BLOCKED_S
    assert not connected  # the connection was full, and was closed


def test_abort_reaches_a_vehicle_that_reports_nothing(endpoint: str) -> None:
    link = ZenohLink(1, FLEET, ZenohEndpoints(listen=(endpoint,)), lambda _reason: None)
    with closing(link), FleetSession(FLEET.name, (endpoint,), "anna") as ground, ThreadPoolExecutor() as pool:
        vehicle = Vehicle(link)
        asked = pool.submit(ground.ask, (1, 2), CommandName.ABORT, 3.0)
        for _ in count():
            vehicle.tick()
            time.sleep(PERIOD_S)
            if asked.done():
                break
        answers = asked.result()
        assert answers[1] is not None
        assert answers[1].reply.accepted
        assert answers[2] is None  # there is no such vehicle; it was asked again until the time was over
        assert ground.newest() == {}
