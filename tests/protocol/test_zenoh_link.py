"""An agent's Zenoh side and the ground's, over real sessions."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from itertools import count

import msgspec
import pytest
import zenoh
from msgspec.structs import replace

from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.vehicle import ZenohEndpoints
from companion.core.peers import PeerTable
from companion.ground.session import FleetSession
from companion.ground.target import TargetPublisher
from companion.link.zenoh_link import LONG_PAUSE_S, ZenohLink
from companion.link.zenoh_session import EndpointError, open_session
from companion.types import (
    Command,
    CommandName,
    CommandReply,
    Content,
    FlightPhase,
    FlownSlot,
    FormationChange,
    LandedState,
    Lead,
    LeaderWord,
    PeerPacket,
    ReceivedPeerPacket,
    ReceivedTarget,
    ReferenceChange,
    Role,
    Status,
)
from companion.wire.ground import Percentiles, StatusReport, Timing, decode_reply, encode
from companion.wire.keys import command_key, peer_key, status_key, target_key
from companion.wire.peer import encode_peer
from companion.wire.version import WIRE_VERSION

FLEET = FleetConfig(
    name="testfleet",
    origin="indoor",
    vehicles=tuple(
        FormationMember(id=i, role=Role.LEADER if i == 1 else Role.FOLLOWER, slot_enu_m=(-1.5 * i, 0.0, 0.0))
        for i in (1, 2, 3)
    ),
    neighbours=EdgeNeighbours(edges=((1, 2), (2, 3))),
)
ZERO = (0.0, 0.0, 0.0)
PACKET = PeerPacket(1, 7, 1, 5, FlightPhase.HOLD, Role.LEADER, ZERO, ZERO, ZERO, 0.01, 0.0, 1, None, FlownSlot(ZERO))
NO_TIME = Percentiles(0.0, 0.0, 0.0)
REPORT = StatusReport(
    Status(
        1, 7, FLEET.name, 5, "weighted", FlightPhase.HOLD, "AUTO.LOITER", True, LandedState.IN_AIR, ZERO, ZERO, 0.02,
        0.5, ZERO, Role.LEADER, 0, 1, None, None, (), FlownSlot(ZERO), ZERO, (), {}, "",
    ),
    Timing(50.0, 1, 0, NO_TIME, NO_TIME, 5.0, 49.0),
)  # fmt: skip


CONTENT_OF: dict[CommandName, Content] = {
    CommandName.LEAD: Lead((1,), 1),
    CommandName.FORMATION: FormationChange(1, (), 1.0, 1.0),
    CommandName.REFERENCE: ReferenceChange(1, {}, 1.0),
}


def endpoint(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


@pytest.fixture
def port() -> int:
    """Free just now, and away from what a simulated fleet uses."""
    for candidate in range(17600, 17700):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", candidate)) != 0:
                return candidate
    raise AssertionError("no free port from 17600 to 17699")


@dataclass
class Vehicle:
    link: ZenohLink
    rejected: Counter[str] = field(default_factory=Counter)
    packets: list[ReceivedPeerPacket] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)

    def tick(self) -> None:
        self.link.publish_status(REPORT)  # whoever is commanded is heard first
        packets, commands = self.link.receive(time.monotonic())
        self.packets += packets
        self.commands += commands


@contextmanager
def vehicle(vehicle_id: int, listen: tuple[str, ...] = (), connect: tuple[str, ...] = ()) -> Iterator[Vehicle]:
    rejected: Counter[str] = Counter()
    link = ZenohLink(
        vehicle_id, FLEET, ZenohEndpoints(listen=listen, connect=connect), lambda reason: rejected.update([reason])
    )
    with closing(link):
        yield Vehicle(link, rejected)


def until(condition: Callable[[], object], each: Callable[[], object] = lambda: None, timeout_s: float = 10.0) -> None:
    """Repeat `each` until the condition holds."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "it never came true"
        each()
        time.sleep(0.01)


def test_a_packet_reaches_the_peers_and_not_its_own_sender(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:

        def both() -> None:
            first.link.publish_peer(PACKET)
            first.tick()
            second.tick()

        until(lambda: second.packets, both)
        assert second.packets[0].packet == PACKET
        assert abs(second.packets[0].received_s - time.monotonic()) < 10.0
        assert first.packets == []
        assert not first.rejected + second.rejected


def test_a_peer_that_starts_late_is_heard_without_anybody_restarting(port: int) -> None:
    with vehicle(2, connect=(endpoint(port),)) as second:
        for _ in range(50):
            second.tick()
            time.sleep(0.01)
        with vehicle(1, listen=(endpoint(port),)) as first:
            until(lambda: second.packets, lambda: (first.link.publish_peer(PACKET), second.tick()))


def test_what_is_no_peer_packet_is_refused_and_counted(port: int) -> None:
    good = encode_peer(PACKET)
    bad = {
        f"wire version 9, expected {WIRE_VERSION}": (1, b"\x09" + good[1:]),
        "malformed peer packet": (1, good[:-3]),
        "empty message": (1, b""),
        "peer packet of another vehicle than its key says": (3, good),
        "peer packet of a vehicle that is not in the fleet file": (99, encode_peer(replace(PACKET, vehicle_id=99))),
    }
    with vehicle(2, listen=(endpoint(port),)) as second, closing(open_session((), (endpoint(port),))) as stranger:
        until(
            lambda: set(second.rejected) == set(bad),
            lambda: (
                [stranger.put(peer_key(FLEET.name, vehicle_id), data) for vehicle_id, data in bad.values()],
                second.tick(),
            ),
        )
        assert second.packets == []


@pytest.mark.parametrize("end", ["9" * 5000, "01", "1x", "²"])
def test_a_key_that_ends_in_no_vehicle_id_is_refused_and_counted(port: int, end: str) -> None:
    key = peer_key(FLEET.name, 1).removesuffix("1") + end
    with vehicle(2, listen=(endpoint(port),)) as second, closing(open_session((), (endpoint(port),))) as stranger:
        until(lambda: second.rejected, lambda: (stranger.put(key, encode_peer(PACKET)), second.tick()))
        assert set(second.rejected) == {"peer packet of another vehicle than its key says"}
        assert second.packets == []


def test_after_a_pause_packets_are_as_old_as_they_waited_and_later_ones_are_not(port: int) -> None:
    peers = PeerTable(2, {1: True, 2: False}, PACKET.formation_hash, max_age_s=1.0, max_speed_m_s=25.0, successors=())
    sequence = count(1)

    def publish() -> None:
        word = LeaderWord(1, 0, 1)
        packet = replace(PACKET, sequence=next(sequence), sent_s=time.monotonic() + 1000.0, leader_word=word)
        first.link.publish_peer(packet)

    def age_s() -> float:
        now_s = time.monotonic()
        peers.fold(second.link.receive(now_s)[0], epoch=0)
        return now_s - peers.fresh(now_s)[1].measured_s - PACKET.state_age_s if peers.fresh(now_s) else 99.0

    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:
        until(lambda: age_s() < 0.05, publish)
        publish()
        time.sleep(4 * LONG_PAUSE_S)
        assert age_s() == pytest.approx(4 * LONG_PAUSE_S, abs=LONG_PAUSE_S)
        until(lambda: age_s() < 0.05, publish)


def test_a_flood_is_kept_short_and_blocks_neither_side(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:
        until(lambda: second.packets, lambda: (first.link.publish_peer(PACKET), second.tick()))
        for sequence in range(5000):
            first.link.publish_peer(replace(PACKET, sequence=sequence + 10))
        newest = 0

        def drain() -> None:
            nonlocal newest
            packets, _ = second.link.receive(time.monotonic())
            assert len(packets) <= 8 * len(FLEET.vehicles)
            newest = max([newest] + [received.packet.sequence for received in packets])

        until(lambda: newest > 4000, drain)  # what is left is the newest


def test_a_command_gets_its_answer_from_the_tick_that_decided(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, FleetSession.open(FLEET.name, (endpoint(port),)) as ground:
        with ThreadPoolExecutor() as pool:
            asked = pool.submit(ground.command, (1, 2), CommandName.FORM, 2.0)
            until(lambda: first.commands, first.tick)
            command = first.commands[0]
            assert command.name is CommandName.FORM
            first.link.reply([CommandReply(1, 999, True, "not asked"), CommandReply(1, command.number, False, "no")])
            until(asked.done, first.tick)
            assert asked.result() == {1: CommandReply(1, command.number, False, "no"), 2: None}
        first.tick()
        assert len(first.commands) == 1  # it was never repeated


def test_a_target_reaches_who_may_lead_and_nobody_else_and_what_is_none_is_counted(port: int) -> None:
    heard: list[ReceivedTarget] = []
    with (
        vehicle(1, listen=(endpoint(port),)) as leader,
        vehicle(2, connect=(endpoint(port),)) as follower,
        TargetPublisher.open(FLEET.name, (endpoint(port),), "walker") as walker,
        closing(open_session((), (endpoint(port),))) as stranger,
    ):

        def tell() -> None:
            walker.tell((1.0, 0.0, 0.0), (5.0, 6.0, 7.0))
            stranger.put(target_key(FLEET.name, "main"), bytes((WIRE_VERSION,)) + b"nonsense")
            heard.extend(leader.link.targets(time.monotonic()))
            assert follower.link.targets(time.monotonic()) == ()

        until(lambda: len(heard) > 1 and leader.rejected, tell)
    first, second = heard[0].sample, heard[1].sample
    assert {target.name for target in heard} == {"walker"}
    assert (first.position_enu_m, first.velocity_enu_m_s) == ((5.0, 6.0, 7.0), (1.0, 0.0, 0.0))
    assert (second.session, second.sequence) == (first.session, first.sequence + 1)
    assert second.sent_s > first.sent_s
    assert set(leader.rejected) == {"malformed target"}


def test_the_command_lead_brings_its_leaders_and_epoch(port: int) -> None:
    lead = Lead((1, 2), 7)
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession.open(FLEET.name, (endpoint(port),)) as ground,
        ThreadPoolExecutor() as pool,
    ):
        asked = pool.submit(ground.command, (1,), CommandName.LEAD, 10.0, lead)
        until(lambda: first.commands, first.tick)
        assert first.commands[0].content == lead
        first.link.reply([CommandReply(1, first.commands[0].number, True, "follower in epoch 7")])
        assert getattr(asked.result(15.0)[1], "accepted", False)


@pytest.mark.parametrize("name", CommandName)
def test_a_command_that_waited_through_a_pause_is_obeyed_only_if_it_ends_a_formation(
    port: int, name: CommandName
) -> None:
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession.open(FLEET.name, (endpoint(port),)) as ground,
        ThreadPoolExecutor() as pool,
    ):
        until(lambda: ground.drain(), lambda: first.link.publish_status(REPORT))  # connected
        first.tick()
        asked = pool.submit(ground.command, (1,), name, 10.0, CONTENT_OF.get(name))
        time.sleep(1.0)  # the process hangs
        first.tick()
        if name in (CommandName.LAND, CommandName.HOLD, CommandName.ABORT):
            assert [command.name for command in first.commands] == [name]
            first.link.reply([CommandReply(1, first.commands[0].number, True, "")])
        else:
            reply = asked.result(15.0)[1]
            assert reply is not None
            assert (reply.accepted, reply.reason) == (False, "came while this agent was paused; give it again")
            assert first.commands == []


def test_a_vehicle_that_appears_within_the_timeout_still_gets_the_command(port: int) -> None:
    with FleetSession.open(FLEET.name, (endpoint(port),)) as ground, ThreadPoolExecutor() as pool:
        asked = pool.submit(ground.command, (1,), CommandName.LAND, 10.0)
        time.sleep(0.3)
        with vehicle(1, listen=(endpoint(port),)) as first:
            until(lambda: first.commands, first.tick)
            first.link.reply([CommandReply(1, first.commands[0].number, True, "land")])
            reply = asked.result(15.0)[1]
            assert reply is not None
            assert reply.reason == "land"


def test_commands_of_two_ground_stations_with_the_same_number_are_both_answered(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.ground.session.time.time_ns", lambda: 5_000_000)
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession.open(FLEET.name, (endpoint(port),), "one") as one,
        FleetSession.open(FLEET.name, (endpoint(port),), "other") as other,
        ThreadPoolExecutor() as pool,
    ):
        asked = [pool.submit(ground.command, (1,), CommandName.HOLD, 10.0) for ground in (one, other)]
        until(lambda: len(first.commands) == 2, first.tick)
        first.link.reply([CommandReply(1, command.number, True, command.operator) for command in first.commands])
        replies = [future.result(15.0)[1] for future in asked]
        assert replies == [CommandReply(1, 5, True, "one"), CommandReply(1, 5, True, "other")]


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (bytes((WIRE_VERSION,)) + b"garbage", "malformed command"),
        (b"\x09", f"wire version 9, expected {WIRE_VERSION}"),
        (None, "empty message"),
        (encode(REPORT), "malformed command"),
    ],
)
def test_a_malformed_command_is_refused_in_words_and_counted(port: int, payload: bytes | None, reason: str) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, closing(open_session((), (endpoint(port),))) as stranger:
        answers: list[CommandReply] = []

        def ask() -> None:
            replies = stranger.get(command_key(FLEET.name, 1), payload=payload, timeout=1.0)
            for _ in range(20):
                first.tick()
                time.sleep(0.005)
            answers.extend(decode_reply(reply.ok.payload.to_bytes()) for reply in replies if reply.ok)

        until(lambda: answers, ask)
        assert (answers[0].accepted, answers[0].reason) == (False, f"refused: {reason}")
        assert first.rejected[reason] >= 1
        assert first.commands == []


def test_the_ground_hears_every_vehicle_through_one_of_them(port: int) -> None:
    second_report = replace(REPORT, status=replace(REPORT.status, vehicle_id=2))
    other = endpoint(port + 100)
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        vehicle(2, listen=(other,), connect=(endpoint(port),)) as second,
        FleetSession.open("*", (endpoint(port),)) as ground,
    ):
        heard: set[int] = set()
        until(
            lambda: heard == {1, 2},
            lambda: (
                first.link.publish_status(REPORT),
                second.link.publish_status(second_report),
                heard.update(report.status.vehicle_id for report in ground.drain()),
            ),
        )


def test_the_ground_counts_what_is_no_report(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, FleetSession.open(FLEET.name, (endpoint(port),)) as ground:
        session = first.link._session

        def disturb() -> None:
            session.put(status_key(FLEET.name, 1), bytes((WIRE_VERSION,)) + b"nonsense")
            session.put(status_key(FLEET.name, 3), encode(REPORT))
            assert ground.drain() == []

        until(lambda: len(ground.rejected) == 2, disturb)
        assert set(ground.rejected) == {"malformed status report", "status of another vehicle than its key says"}


@pytest.mark.parametrize(
    ("listen", "connect", "kind", "words"),
    [
        ("tcp/127.0.0.1", "", "listen", "expected PROTOCOL/HOST:PORT"),
        ("nonsense", "", "listen", "expected PROTOCOL/HOST:PORT"),
        ("", "tcp/127.0.0.1:99999", "connect", "expected PROTOCOL/HOST:PORT"),
        ("tcp/192.0.2.1:17609", "", "listen", "no such address"),
        ("", "pigeon/127.0.0.1:17609", "connect", 'no protocol "pigeon"'),
        ("tls/127.0.0.1:17609", "", "listen", "Missing TLS private key"),
    ],
)
def test_an_endpoint_that_cannot_be_used_is_told_in_one_line(listen: str, connect: str, kind: str, words: str) -> None:
    with pytest.raises(EndpointError, match=words) as caught:
        open_session([listen] if listen else [], [connect] if connect else []).close()
    assert (caught.value.kind, caught.value.endpoint) == (kind, listen or connect)
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


def test_a_listen_port_in_use_is_told_in_one_line(port: int) -> None:
    with (
        closing(open_session([endpoint(port)], [])),
        pytest.raises(EndpointError, match="the port is in use") as caught,
    ):
        open_session([endpoint(port)], [])
    assert caught.value.endpoint == endpoint(port)


def test_no_session_stays_open_where_a_name_cannot_be_declared(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[zenoh.Session] = []

    def recording(listen: Sequence[str], connect: Sequence[str]) -> zenoh.Session:
        opened.append(open_session(listen, connect))
        return opened[-1]

    monkeypatch.setattr("companion.ground.session.open_session", recording)
    monkeypatch.setattr("companion.link.zenoh_link.open_session", recording)
    with pytest.raises(zenoh.ZError):
        FleetSession.open("a*", (endpoint(port),))
    with pytest.raises(zenoh.ZError):
        ZenohLink(1, msgspec.structs.replace(FLEET, name="a*"), ZenohEndpoints(), lambda _reason: None)
    assert [session.is_closed() for session in opened] == [True, True]


def test_a_process_with_a_closed_session_ends(port: int) -> None:
    program = (
        "from companion.ground.session import FleetSession\n"
        f"with FleetSession.open('*', ('{endpoint(port)}',)) as ground:\n"
        "    ground.drain()\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=30)
