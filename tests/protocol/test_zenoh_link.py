"""The Zenoh links of agent and ground, over real sessions."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from itertools import count, pairwise
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace

from common import until, with_fields
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember, PeerLimits
from companion.config.vehicle import ZenohEndpoints
from companion.core.consensus.peers import FleetLimits, PeerTable
from companion.ground.publishers import AMSL, TargetPublisher, TrafficPublisher, above_ellipsoid
from companion.ground.session import AGAIN_S, FleetSession
from companion.link.fleet.zenoh_link import LONG_PAUSE_S, ZenohLink
from companion.link.fleet.zenoh_session import EndpointError, open_session
from companion.types.autopilot import LandedState
from companion.types.commands import Command, CommandName, CommandReply, Content, Lead, ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic, TrafficSample
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NeighbourReport,
    SafetyReport,
    Status,
)
from companion.wire.keys import abort_key, command_key, peer_key, status_key, target_key, traffic_key
from companion.wire.messages import WIRE_VERSION, Percentiles, StatusReport, Timing, encode, encode_peer
from ground_fleet import PACKET
from processes import free_port

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
NO_TIME = Percentiles(0.0, 0.0, 0.0)
REPORT = StatusReport(
    Status(
        agent=AgentIdentity(vehicle_id=1, session=7, fleet=FLEET.name, formation_hash=5, law="weighted"),
        phase=FlightPhase.HOLD,
        autopilot=AutopilotReport(mode_name="AUTO.LOITER", armed=True, landed=LandedState.IN_AIR),
        motion=MotionReport(position_enu_m=ZERO, velocity_enu_m_s=ZERO, state_age_s=0.02),
        control=ControlReport(hover_thrust_norm=0.5, disturbance_enu_m_s2=ZERO),
        leadership=LeadershipReport(role=Role.LEADER, epoch=0, prc=1, leader_beacon=None, leader_beacon_age_s=None),
        neighbourhood=NeighbourReport(neighbours=()),
        formation=FormationReport(slot=FlownSlot(ZERO), reference_enu_m=ZERO),
        safety=SafetyReport(flags=()),
        rejected={},
        last_event=None,
    ),
    Timing(50.0, 1, 0, NO_TIME, NO_TIME, 5.0, 49.0),
)


CONTENT_OF: dict[CommandName, Content] = {
    CommandName.LEAD: Lead((1,), 1),
    CommandName.FORMATION: FormationChange(1, (), 1.0, 1.0),
    CommandName.REFERENCE: ReferenceChange(1, {}, 1.0),
}


DONE, REFUSED = Code.PHASE_CHANGED, Code.WRONG_PHASE


def endpoint(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


@pytest.fixture
def port() -> int:
    return free_port(socket.SOCK_STREAM)


@pytest.fixture
def other_port() -> int:
    return free_port(socket.SOCK_STREAM)


@dataclass
class Vehicle:
    link: ZenohLink
    rejected: Counter[str] = field(default_factory=Counter)
    packets: list[ReceivedPeerPacket] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)

    def tick(self) -> None:
        self.link.publish_status(REPORT)  # a vehicle must be known before it is commanded
        packets, commands = self.link.receive(time.monotonic())
        self.packets += packets
        self.commands += commands

    def answer(self, reason: str) -> None:
        """Accept the first command."""
        first = self.commands[0]
        self.link.reply([CommandReply(1, first.number, True, DONE, reason, first.operator)])


@contextmanager
def vehicle(
    vehicle_id: int, listen: tuple[str, ...] = (), connect: tuple[str, ...] = (), fleet: FleetConfig = FLEET
) -> Iterator[Vehicle]:
    rejected: Counter[str] = Counter()
    link = ZenohLink(
        vehicle_id, fleet, ZenohEndpoints(listen=listen, connect=connect), lambda reason: rejected.update([reason])
    )
    with closing(link):
        yield Vehicle(link, rejected)


def test_a_packet_reaches_the_peers_and_not_its_sender(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:

        def both() -> None:
            first.link.publish_peer(PACKET)
            first.tick()
            second.tick()

        until(lambda: second.packets, each=both)
        assert second.packets[0].packet == PACKET
        assert abs(second.packets[0].received_s - time.monotonic()) < 10.0
        assert first.packets == []
        assert not first.rejected + second.rejected


def test_a_packet_that_arrives_between_the_parts_of_a_tick_is_received_once_with_its_own_time(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:
        until(lambda: second.packets, each=lambda: (first.link.publish_peer(PACKET), second.tick()))
        sequence, second.packets, late = count(PACKET.sender.sequence + 1), [], []

        def tick() -> None:
            second.tick()
            began_s = time.monotonic()
            first.link.publish_peer(with_fields(PACKET, sequence=next(sequence)))
            received = second.link.receive_late(time.monotonic())
            second.packets.extend(received)
            late.extend(one for one in received if one.received_s >= began_s)

        until(lambda: late, each=tick)
        second.tick()
        sequences = [received.packet.sender.sequence for received in second.packets]
        assert sequences == sorted(set(sequences))


def test_after_a_pause_between_the_parts_the_newest_packets_are_received(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:
        until(lambda: second.packets, each=lambda: (first.link.publish_peer(PACKET), second.tick()))
        prepared_s = time.monotonic()
        second.link.receive(prepared_s)
        last = PACKET.sender.sequence + 20
        for sequence in range(PACKET.sender.sequence + 1, last + 1):
            first.link.publish_peer(with_fields(PACKET, sequence=sequence))
        time.sleep(0.5)
        received = second.link.receive_late(prepared_s + 0.5)
        assert received[-1].packet.sender.sequence == last


def test_a_peer_that_starts_late_is_received_without_a_restart(port: int) -> None:
    with vehicle(2, connect=(endpoint(port),)) as second:
        for _ in range(50):
            second.tick()
            time.sleep(0.01)
        with vehicle(1, listen=(endpoint(port),)) as first:
            until(lambda: second.packets, each=lambda: (first.link.publish_peer(PACKET), second.tick()))


def test_agents_connect_to_configured_peers_only(port: int, other_port: int) -> None:
    """Vehicles 2 and 3 both know vehicle 1, which tells each of them where the other listens."""
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        vehicle(2, listen=(endpoint(other_port),), connect=(endpoint(port),)) as second,
        vehicle(3, connect=(endpoint(port),)) as third,
    ):

        def publish() -> None:
            third.link.publish_peer(with_fields(PACKET, vehicle_id=3))
            first.tick()
            second.tick()

        until(lambda: first.packets, each=publish)
        end_s = time.monotonic() + 1.0
        until(lambda: time.monotonic() > end_s, each=publish)
        assert second.packets == []


def test_a_malformed_peer_packet_is_rejected_and_counted(port: int) -> None:
    good = encode_peer(PACKET)
    bad = {
        f"{Code.WIRE_VERSION_DIFFERS} {WIRE_VERSION + 1}": (1, bytes((WIRE_VERSION + 1,)) + good[1:]),
        Code.PEER_MALFORMED: (1, good[:-3]),
        Code.MESSAGE_EMPTY: (1, b""),
        Code.PEER_KEY_MISMATCH: (3, good),
        Code.PEER_NOT_IN_FLEET: (3, encode_peer(with_fields(PACKET, vehicle_id=99))),
    }
    with vehicle(2, listen=(endpoint(port),)) as second, closing(open_session((), (endpoint(port),))) as stranger:
        until(
            lambda: set(second.rejected) == set(bad),
            each=lambda: (
                [stranger.put(peer_key(FLEET.name, vehicle_id), data) for vehicle_id, data in bad.values()],
                second.tick(),
            ),
        )
        assert second.packets == []


@pytest.mark.parametrize("end", ["9" * 5000, "01", "1x", "²", "1/2", "99"])
def test_a_key_without_a_vehicle_of_the_fleet_is_not_received(port: int, end: str) -> None:
    key = peer_key(FLEET.name, 1).removesuffix("1") + end
    with (
        vehicle(1, connect=(endpoint(port),)) as first,
        vehicle(2, listen=(endpoint(port),)) as second,
        closing(open_session((), (endpoint(port),))) as stranger,
    ):
        end_s = time.monotonic() + 0.5
        until(
            lambda: second.packets and time.monotonic() > end_s,
            each=lambda: (first.link.publish_peer(PACKET), stranger.put(key, b"nonsense"), second.tick()),
        )
        assert not second.rejected


def test_a_vehicle_that_floods_displaces_no_packet_of_another(port: int) -> None:
    with (
        vehicle(1, connect=(endpoint(port),)) as first,
        vehicle(2, listen=(endpoint(port),)) as second,
        vehicle(3, connect=(endpoint(port),)) as third,
    ):
        until(lambda: second.packets, each=lambda: (first.link.publish_peer(PACKET), second.tick()))
        second.packets.clear()
        flood = with_fields(PACKET, vehicle_id=3)
        for _ in range(100):
            first.link.publish_peer(PACKET)
            for _ in range(100):
                third.link.publish_peer(flood)
            time.sleep(0.02)
            second.tick()
        senders = Counter(received.packet.sender.vehicle_id for received in second.packets)
        assert senders[1] > 50
        assert senders[3] <= 8 * 101


def test_garbage_under_the_key_of_a_vehicle_displaces_none_of_its_packets(port: int) -> None:
    """A hundred messages of garbage after each packet."""
    with (
        vehicle(1, connect=(endpoint(port),)) as first,
        vehicle(2, listen=(endpoint(port),)) as second,
        closing(open_session((), (endpoint(port),))) as stranger,
    ):
        key, version = peer_key(FLEET.name, 1), encode_peer(PACKET)[:1]
        until(
            lambda: second.packets and second.rejected,
            each=lambda: (first.link.publish_peer(PACKET), stranger.put(key, b"nonsense"), second.tick()),
        )
        second.packets.clear()
        for _ in range(50):
            first.link.publish_peer(PACKET)
            for number in range(100):
                stranger.put(key, version + b"nonsense" if number % 2 else b"nonsense")
            time.sleep(0.05)
            second.tick()
        assert len(second.packets) >= 45
        assert second.rejected[Code.PEER_MALFORMED] > 1000


LARGE_FLEET = replace(FLEET, peers=PeerLimits(full_rate_up_to=1))


def test_a_peer_is_received_at_the_rate_of_the_choice_without_gaps(port: int) -> None:
    """50 Hz, then 5 Hz, then 50 Hz again; two vehicles that are not distant stay at 50 Hz."""
    with (
        vehicle(1, connect=(endpoint(port),), fleet=LARGE_FLEET) as first,
        vehicle(2, listen=(endpoint(port),), fleet=LARGE_FLEET) as second,
        vehicle(3, connect=(endpoint(port),), fleet=LARGE_FLEET) as third,
    ):
        sequence = count(1)

        def tick(distant_ids: tuple[int, ...]) -> None:
            number = next(sequence)
            for sender, vehicle_id in ((first, 1), (third, 3)):
                sender.link.publish_peer(with_fields(PACKET, vehicle_id=vehicle_id, sequence=number))
            time.sleep(0.01)
            second.link.set_low_rate_peers(distant_ids)
            second.tick()

        until(
            lambda: {received.packet.sender.vehicle_id for received in second.packets} == {1, 3}, each=lambda: tick(())
        )
        second.packets.clear()
        for distant_ids in ((), (1,), (), (1,), ()):
            since = next(sequence)
            for _ in range(60):
                tick(distant_ids)
            received = [received.packet for received in second.packets if received.packet.sender.sequence > since]
            sequences = [packet.sender.sequence for packet in received if packet.sender.vehicle_id == 1]
            wanted = range(5, 15) if distant_ids else range(50, 62)
            assert len(sequences) in wanted, (distant_ids, sequences)
            assert sequences == sorted(set(sequences)), "no packet twice, none out of order"
            assert all(b - a <= 21 for a, b in pairwise(sequences)), sequences
            assert sum(packet.sender.vehicle_id == 3 for packet in received) >= 55
        assert not second.rejected


def test_a_command_under_the_key_of_another_operator_is_counted(port: int) -> None:
    command = encode(Command(CommandName.HOLD, 1, "anna", 7))
    with vehicle(1, listen=(endpoint(port),)) as first, closing(open_session((), (endpoint(port),))) as stranger:
        until(
            lambda: first.rejected,
            each=lambda: (stranger.put(command_key(FLEET.name, 1, "mallory"), command), first.tick()),
        )
        assert first.rejected.keys() == {Code.COMMAND_KEY_MISMATCH}
        assert first.commands == []


def test_packets_that_waited_through_a_pause_are_dated_back(port: int) -> None:
    peers = PeerTable(
        2,
        {1: True, 2: False},
        PACKET.sender.formation_hash,
        max_age_s=1.0,
        limits=FleetLimits(25.0, 8.0, (200.0, 200.0, 55.0)),
        successors=(),
    )
    sequence = count(1)

    def publish() -> None:
        beacon = LeaderBeacon(1, 0, 1)
        packet = with_fields(PACKET, sequence=next(sequence), sent_s=time.monotonic() + 1000.0, beacon=beacon)
        first.link.publish_peer(packet)

    def age_s() -> float:
        now_s = time.monotonic()
        peers.fold(second.link.receive(now_s)[0], epochs_up_to=0)
        return (
            now_s - peers.in_time(now_s)[0][1].measured_s - PACKET.motion.state_age_s
            if peers.in_time(now_s)[0]
            else 99.0
        )

    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:
        until(lambda: age_s() < 0.05, each=publish)
        publish()
        time.sleep(4 * LONG_PAUSE_S)
        assert age_s() == pytest.approx(4 * LONG_PAUSE_S, abs=LONG_PAUSE_S)
        until(lambda: age_s() < 0.05, each=publish)


def test_a_flood_of_packets_is_bounded_and_blocks_neither_side(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, vehicle(2, connect=(endpoint(port),)) as second:
        until(lambda: second.packets, each=lambda: (first.link.publish_peer(PACKET), second.tick()))
        sequences = count(10)
        flood = [with_fields(PACKET, sequence=next(sequences)) for _ in range(5000)]
        for packet in flood:
            first.link.publish_peer(packet)

        def drain() -> bool:
            """Whether something newer than the flood has arrived: who sends may drop any packet, its last ones too."""
            first.link.publish_peer(with_fields(PACKET, sequence=next(sequences)))
            packets, _ = second.link.receive(time.monotonic())
            assert len(packets) <= 8 * len(FLEET.vehicles)
            return any(received.packet.sender.sequence > flood[-1].sender.sequence for received in packets)

        until(drain)


def test_a_command_is_answered_by_the_tick_that_decides(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, FleetSession(FLEET.name, (endpoint(port),)) as ground:
        with ThreadPoolExecutor() as pool:
            asked = pool.submit(ground.command, (1, 2), CommandName.FORM, 2.0)
            until(lambda: first.commands, each=first.tick)
            command = first.commands[0]
            assert command.name is CommandName.FORM
            first.link.reply(
                [
                    CommandReply(1, 999, True, DONE, "not asked", command.operator),
                    CommandReply(1, command.number, False, REFUSED, "no", command.operator),
                ]
            )
            until(asked.done, each=first.tick)
            assert asked.result() == {
                1: CommandReply(1, command.number, False, REFUSED, "no", command.operator),
                2: None,
            }
        seen = len(first.commands)
        for _ in range(3 * round(AGAIN_S / 0.01)):
            first.tick()
            time.sleep(0.01)
        assert len(first.commands) == seen  # not repeated any more


def test_a_target_reaches_only_possible_leaders_and_malformed_ones_are_counted(port: int) -> None:
    received: list[ReceivedTarget] = []
    with (
        vehicle(1, listen=(endpoint(port),)) as leader,
        vehicle(2, connect=(endpoint(port),)) as follower,
        TargetPublisher(FLEET.name, (endpoint(port),), "walker") as walker,
        closing(open_session((), (endpoint(port),))) as stranger,
    ):

        def publish() -> None:
            walker.publish((1.0, 0.0, 0.0), (5.0, 6.0, 7.0))
            stranger.put(target_key(FLEET.name, "main"), bytes((WIRE_VERSION,)) + b"nonsense")
            received.extend(leader.link.targets(time.monotonic()))
            assert follower.link.targets(time.monotonic()) == ()

        until(lambda: len(received) > 1 and leader.rejected, each=publish)
    first, second = received[0].sample, received[1].sample
    assert {target.name for target in received} == {"walker"}
    assert (first.position_enu_m, first.velocity_enu_m_s) == ((5.0, 6.0, 7.0), (1.0, 0.0, 0.0))
    assert (second.session, second.sequence) == (first.session, first.sequence + 1)
    assert second.sent_s > first.sent_s
    assert set(leader.rejected) == {Code.TARGET_MALFORMED}


def test_traffic_reaches_every_vehicle_and_malformed_samples_are_counted(port: int, other_port: int) -> None:
    received: dict[int, list[ReceivedTraffic]] = {1: [], 2: []}
    origin_deg_deg_m = (47.397742, 8.545594, 488.0)
    with (
        vehicle(1, listen=(endpoint(port),)) as leader,
        vehicle(2, listen=(endpoint(other_port),), connect=(endpoint(port),)) as follower,
        TrafficPublisher(FLEET.name, (endpoint(port), endpoint(other_port))) as receiver_of_adsb,
        closing(open_session((), (endpoint(port),))) as stranger,
    ):

        def publish() -> None:
            receiver_of_adsb.publish("4b1805", (5.0, 6.0, 7.0), (1.0, 0.0, 0.0), age_s=0.5, error_m=2.0)
            at_origin = ((0.0, 0.0, 0.0), origin_deg_deg_m)
            receiver_of_adsb.publish_geodetic("4b1806", origin_deg_deg_m, *at_origin, height=AMSL)
            ellipsoid_deg_deg_m = (*origin_deg_deg_m[:2], 488.0 + 47.0)
            receiver_of_adsb.publish_geodetic("4b1807", ellipsoid_deg_deg_m, *at_origin, height=above_ellipsoid(47.0))
            receiver_of_adsb.publish_geodetic("4b1808", (*origin_deg_deg_m[:2], 39_000.0), *at_origin)
            stranger.put(traffic_key(FLEET.name, "main", "4b1805"), bytes((WIRE_VERSION,)) + b"nonsense")
            for vehicle_id, one in ((1, leader), (2, follower)):
                received[vehicle_id].extend(one.link.traffic(time.monotonic()))

        def known(vehicle_id: int) -> dict[str, TrafficSample]:
            return {each.name: each.sample for each in received[vehicle_id]}

        until(lambda: len(known(1)) == len(known(2)) == 4 and leader.rejected, each=publish)
    for newest in (known(1), known(2)):
        assert newest["4b1805"] == TrafficSample((5.0, 6.0, 7.0), (1.0, 0.0, 0.0), 0.5, 2.0)
        for name, height in (("4b1806", "fleet"), ("4b1807", "fleet"), ("4b1808", "unknown")):
            assert newest[name].position_enu_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
            assert newest[name].height == height
    assert set(leader.rejected) == {Code.TRAFFIC_MALFORMED}


@pytest.mark.parametrize("key", ["**", f"formation/{FLEET.name}/**", "formation/*/*/*/*", "formation/*/*/*"])
@pytest.mark.parametrize(
    "payload", [b"", encode_peer(PACKET)[:20], encode(TrafficSample((1.0, 2.0, 3.0), ZERO, 0.0, 0.0))]
)
def test_a_message_to_every_key_costs_itself_alone(port: int, key: str, payload: bytes) -> None:
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession("*", (endpoint(port),)) as ground,
        closing(open_session((), (endpoint(port),))) as stranger,
    ):
        received: list[ReceivedTraffic] = []

        def listen() -> None:
            stranger.put(key, payload)
            first.tick()
            first.link.targets(time.monotonic())
            received.extend(first.link.traffic(time.monotonic()))
            ground.drain()
            ground.drain_other_replies()

        until(lambda: first.rejected, each=listen)
        first.rejected.clear()
        until(lambda: first.rejected and ground.newest(), each=listen)
        assert first.packets == first.commands == received == []
        assert set(ground.newest()) == {1}


def test_the_command_lead_carries_its_leaders_and_epoch(port: int) -> None:
    lead = Lead((1, 2), 7)
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession(FLEET.name, (endpoint(port),)) as ground,
        ThreadPoolExecutor() as pool,
    ):
        asked = pool.submit(ground.command, (1,), CommandName.LEAD, 10.0, lead)
        until(lambda: first.commands, each=first.tick)
        assert first.commands[0].content == lead
        first.link.reply(
            [CommandReply(1, first.commands[0].number, True, DONE, "follower in epoch 7", first.commands[0].operator)]
        )
        assert getattr(asked.result(15.0)[1], "accepted", False)


@pytest.mark.parametrize("name", CommandName)
def test_a_command_that_waited_through_a_pause_is_executed_only_if_it_ends_a_formation(
    port: int, name: CommandName
) -> None:
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession(FLEET.name, (endpoint(port),)) as ground,
        ThreadPoolExecutor() as pool,
    ):
        until(lambda: ground.drain(), each=lambda: first.link.publish_status(REPORT))  # connected
        first.tick()
        asked = pool.submit(ground.command, (1,), name, 10.0, CONTENT_OF.get(name))
        time.sleep(5 * LONG_PAUSE_S)  # the process hangs
        first.tick()
        if name in (CommandName.LAND, CommandName.HOLD, CommandName.ABORT):
            assert {command.name for command in first.commands} == {name}
            assert len(set(first.commands)) == 1  # the same one, repeated
            first.answer("")
        else:
            reply = asked.result(15.0)[1]
            assert reply is not None
            assert (reply.accepted, reply.code) == (False, Code.COMMAND_LATE)
            assert first.commands == []


def test_a_vehicle_that_appears_within_the_timeout_still_gets_the_command(port: int) -> None:
    with FleetSession(FLEET.name, (endpoint(port),)) as ground, ThreadPoolExecutor() as pool:
        asked = pool.submit(ground.command, (1,), CommandName.LAND, 10.0)
        time.sleep(0.3)
        with vehicle(1, listen=(endpoint(port),)) as first:
            until(lambda: first.commands, each=first.tick)
            first.link.reply(
                [CommandReply(1, first.commands[0].number, True, DONE, "land", first.commands[0].operator)]
            )
            reply = asked.result(15.0)[1]
            assert reply is not None
            assert reply.reason == "land"


def test_commands_of_two_ground_stations_with_the_same_number_are_both_answered(port: int) -> None:
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        FleetSession(FLEET.name, (endpoint(port),), "one") as one,
        FleetSession(FLEET.name, (endpoint(port),), "other") as other,
        ThreadPoolExecutor() as pool,
    ):
        asked = [pool.submit(ground.command, (1,), CommandName.HOLD, 10.0) for ground in (one, other)]
        until(lambda: len(set(first.commands)) == 2, each=first.tick)
        first.link.reply(
            [
                CommandReply(1, command.number, True, DONE, command.operator, command.operator)
                for command in set(first.commands)
            ]
        )
        replies = [future.result(15.0)[1] for future in asked]
        assert replies == [
            CommandReply(1, 1, True, DONE, "one", "one"),
            CommandReply(1, 1, True, DONE, "other", "other"),
        ]


@pytest.mark.parametrize(
    ("payload", "key"),
    [
        (bytes((WIRE_VERSION,)) + b"garbage", Code.COMMAND_MALFORMED),
        (bytes((WIRE_VERSION + 1,)), f"{Code.WIRE_VERSION_DIFFERS} {WIRE_VERSION + 1}"),
        (b"", Code.MESSAGE_EMPTY),
        (encode(REPORT), Code.COMMAND_MALFORMED),
    ],
)
def test_a_malformed_command_is_counted(port: int, payload: bytes, key: str) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, closing(open_session((), (endpoint(port),))) as stranger:
        until(
            lambda: first.rejected[key],
            each=lambda: (
                stranger.put(command_key(FLEET.name, 1, "mallory"), payload),
                stranger.put(abort_key(FLEET.name, 1, "mallory"), payload),
                first.tick(),
            ),
        )
        # On the abort key all but an ABORT counts as malformed, mostly without decoding.
        assert set(first.rejected) - {Code.COMMAND_MALFORMED} == {key} - {Code.COMMAND_MALFORMED}
        assert first.commands == []


def test_the_ground_connects_no_vehicles_with_each_other(port: int, other_port: int) -> None:
    """Nor two fleets: it knows where two agents listen, and neither learns of the other."""
    second_report = replace(REPORT, status=with_fields(REPORT.status, vehicle_id=2))
    with (
        vehicle(1, listen=(endpoint(port),)) as first,
        vehicle(2, listen=(endpoint(other_port),)) as second,
        FleetSession("*", (endpoint(port), endpoint(other_port))) as ground,
    ):
        reported: set[int] = set()

        def publish() -> None:
            first.link.publish_status(REPORT)
            second.link.publish_status(second_report)
            first.link.publish_peer(PACKET)
            second.tick()
            reported.update(report.status.agent.vehicle_id for report in ground.drain())

        until(lambda: reported == {1, 2}, each=publish)
        end_s = time.monotonic() + 1.0
        until(lambda: time.monotonic() > end_s, each=publish)
        assert second.packets == []


def test_the_ground_counts_malformed_reports(port: int) -> None:
    with vehicle(1, listen=(endpoint(port),)) as first, FleetSession(FLEET.name, (endpoint(port),)) as ground:
        session = first.link.session

        def disturb() -> None:
            session.put(status_key(FLEET.name, 1), bytes((WIRE_VERSION,)) + b"nonsense")
            session.put(status_key(FLEET.name, 3), encode(REPORT))
            assert ground.drain() == []

        until(lambda: len(ground.rejected) == 2, each=disturb)
        assert set(ground.rejected) == {Code.REPORT_MALFORMED, Code.PEER_KEY_MISMATCH}


@pytest.mark.parametrize(
    ("listen", "connect", "kind", "words"),
    [
        ("tcp/127.0.0.1", "", "listen", "expected PROTOCOL/HOST:PORT"),
        ("nonsense", "", "listen", "expected PROTOCOL/HOST:PORT"),
        ("", "tcp/127.0.0.1:99999", "connect", "expected PROTOCOL/HOST:PORT"),
        ("tcp/192.0.2.1:17609", "", "listen", "no such address"),
        ("", "pigeon/127.0.0.1:17609", "connect", 'unknown protocol "pigeon"'),
        ("tls/127.0.0.1:17609", "", "listen", "needs an identity"),
    ],
)
def test_an_endpoint_that_cannot_be_used_is_named_in_one_line(listen: str, connect: str, kind: str, words: str) -> None:
    with pytest.raises(EndpointError, match=words) as caught:
        open_session([listen] if listen else [], [connect] if connect else []).close()
    assert (caught.value.kind, caught.value.endpoint) == (kind, listen or connect)
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


def test_a_listen_port_in_use_is_named_in_one_line(port: int) -> None:
    with (
        closing(open_session([endpoint(port)], [])),
        pytest.raises(EndpointError, match="the port is in use") as caught,
    ):
        open_session([endpoint(port)], [])
    assert caught.value.endpoint == endpoint(port)


def test_no_session_stays_open_when_a_declaration_fails(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[zenoh.Session] = []

    def recording(*arguments: Any, **named: Any) -> zenoh.Session:
        opened.append(open_session(*arguments, **named))
        return opened[-1]

    monkeypatch.setattr("companion.ground.session.open_session", recording)
    monkeypatch.setattr("companion.link.fleet.zenoh_link.open_session", recording)
    with pytest.raises(zenoh.ZError):
        FleetSession("a*", (endpoint(port),))
    with pytest.raises(zenoh.ZError):
        ZenohLink(1, replace(FLEET, name="a*"), ZenohEndpoints(), lambda _reason: None)
    assert [session.is_closed() for session in opened] == [True]  # the ground refuses the name before it opens one


def test_a_process_with_a_closed_session_ends(port: int) -> None:
    program = (
        "from companion.ground.session import AGAIN_S, FleetSession\n"
        f"with FleetSession('*', ('{endpoint(port)}',)) as ground:\n"
        "    ground.drain()\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=30)
