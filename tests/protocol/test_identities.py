"""What strangers and other participants can do to an agent's Zenoh link with an identity, over real TLS and QUIC."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import timedelta
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common import until, with_fields
from companion.config.fleet_check import load_fleet
from companion.config.vehicle import ZenohEndpoints
from companion.ground.publishers import PosePublisher, TargetPublisher, TrafficPublisher
from companion.ground.session import FleetSession
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.fleet.zenoh_session import EndpointError, open_session
from companion.security.admission import accept, read_certificate
from companion.types.commands import Command, CommandName
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import BodyPose, PeerPacket, TargetSample, TrafficSample
from companion.wire.keys import (
    abort_key,
    command_key,
    peer_key,
    pose_key,
    reply_key,
    status_key,
    target_key,
    traffic_key,
)
from companion.wire.messages import encode, encode_peer
from ground_fleet import PACKET
from heard_poses import UNIT, HeardPoses, hearing_poses
from processes import free_port
from secured_fleet import FLEET_NAME, Identities, provisioned, stranger, tls_of

TRIES_S = 1.5
ZERO = (0.0, 0.0, 0.0)
NOBODY = 666  # session of a source of poses that no certificate names


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Identities:
    return provisioned(tmp_path_factory.mktemp("secured") / "fleet")


class Link:
    """The Zenoh link of a vehicle, and everything that came over it."""

    def __init__(self, link: ZenohLink, rejected: Counter[str], heard: HeardPoses) -> None:
        self.link, self.rejected, self._heard = link, rejected, heard
        self.packets: list[PeerPacket] = []
        self.proven: list[bool] = []  # of each packet
        self.commands: list[Command] = []
        self.others: list[Any] = []

    def tick(self) -> None:
        now_s = time.monotonic()
        packets, commands = self.link.receive(now_s)
        self.packets += [received.packet for received in packets]
        self.proven += [received.proven for received in packets]
        self.commands += commands
        self.others += [*self.link.targets(now_s), *self.link.traffic(now_s), *self._heard.taken()]

    @property
    def received(self) -> bool:
        return bool(self.packets or self.commands or self.others or self.rejected)


@contextmanager
def vehicle(identities: Identities, vehicle_id: int, listen: str = "", connect: str = "") -> Iterator[Link]:
    rejected: Counter[str] = Counter()
    link = ZenohLink(
        vehicle_id,
        load_fleet(identities.folder / "fleet.yaml"),
        ZenohEndpoints(listen=(listen,) if listen else (), connect=(connect,) if connect else ()),
        lambda reason: rejected.update([reason]),
        identity=identities.of(f"vehicle-{vehicle_id}"),
    )
    with closing(link), hearing_poses(link) as heard:
        yield Link(link, rejected, heard)


@pytest.fixture(params=["tls", "quic"])
def endpoint(request: pytest.FixtureRequest) -> str:
    kind = socket.SOCK_STREAM if request.param == "tls" else socket.SOCK_DGRAM
    return f"{request.param}/127.0.0.1:{free_port(kind)}"


def everything(session: zenoh.Session, operators: tuple[str, ...] = ("ground-anna",)) -> Callable[[], None]:
    """Publishes, at each call, valid messages under every key of vehicles 1 to 3 and of all operators."""
    numbers = count(1)

    def publish() -> None:
        number = next(numbers)
        for i in (1, 2, 3):
            packet = with_fields(PACKET, vehicle_id=i, sequence=number, sent_s=time.monotonic())
            session.put(peer_key(FLEET_NAME, i), encode_peer(packet))
            session.put(status_key(FLEET_NAME, i), b"x")
            session.put(reply_key(FLEET_NAME, i), b"x")
            for operator in operators:
                command = Command(CommandName.HOLD, number, operator, 7)
                session.put(command_key(FLEET_NAME, i, operator), encode(command))
                abort = Command(CommandName.ABORT, number, operator, 7)
                session.put(abort_key(FLEET_NAME, i, operator), encode(abort))
            for source, own in (("hall", 1), ("attic", NOBODY)):
                session.put(pose_key(FLEET_NAME, source, i), encode(BodyPose(own, number, 0.0, ZERO, UNIT)))
        session.put(target_key(FLEET_NAME, "beacon"), encode(TargetSample(1, number, 0.0, ZERO, ZERO)))
        session.put(traffic_key(FLEET_NAME, "adsb", "4b18"), encode(TrafficSample(ZERO, ZERO, 0.0, 0.0)))

    return publish


def attacked(first: Link, attack: Callable[[], None]) -> None:
    """Lets the attack run for TRIES_S."""
    end_s = time.monotonic() + TRIES_S
    until(lambda: time.monotonic() > end_s, each=lambda: (attack(), first.tick()))


def connected(first: Link, second: Link) -> None:
    """Until the first receives the second; then it forgets what came."""
    packet = with_fields(PACKET, vehicle_id=2)
    until(lambda: first.packets, each=lambda: (second.link.publish_peer(packet), first.tick()))
    time.sleep(0.3)
    first.tick()
    first.packets.clear()


def test_a_term_that_a_vehicle_passes_on_counts_with_the_signature_of_its_leader(fleet: Identities) -> None:
    to_first, to_relay = (f"tls/127.0.0.1:{free_port(socket.SOCK_STREAM)}" for _ in range(2))
    claim = LeaderBeacon(2, 1, 100, 5.0, 1)
    of_relay, of_leader = (with_fields(PACKET, vehicle_id=i, beacon=claim) for i in (3, 2))
    with (
        vehicle(fleet, 1, listen=to_first) as first,
        vehicle(fleet, 3, listen=to_relay, connect=to_first) as relay,
        vehicle(fleet, 2, connect=to_relay) as leader,
    ):
        until(lambda: first.proven, each=lambda: (relay.link.publish_peer(of_relay), first.tick()))
        assert not any(first.proven)  # vehicle 2 has not said so
        assert set(first.rejected) == {f"{Code.PEER_TERM_UNPROVEN} 3"}

        def pass_on() -> None:
            leader.link.publish_peer(of_leader)
            relay.tick()
            relay.link.publish_peer(of_relay)
            first.tick()

        until(lambda: first.proven[-1], each=pass_on)
        assert {packet.sender.vehicle_id for packet in first.packets} == {3}


def test_admitted_participants_reach_each_other(fleet: Identities, endpoint: str) -> None:
    with (
        vehicle(fleet, 1, listen=endpoint) as first,
        vehicle(fleet, 2, connect=endpoint) as second,
        FleetSession("*", [endpoint], identity=fleet.of("ground-anna")) as ground,
        TargetPublisher(FLEET_NAME, [endpoint], identity=fleet.of("target-beacon")) as target,
        TrafficPublisher(FLEET_NAME, [endpoint], identity=fleet.of("traffic-adsb")) as traffic,
        PosePublisher(FLEET_NAME, [endpoint], identity=fleet.of("mocap-hall")) as cameras,
    ):
        connected(first, second)
        until(lambda: second.packets, each=lambda: (first.link.publish_peer(PACKET), second.tick()))
        until(lambda: first.commands, each=lambda: (ground.command([1], CommandName.ABORT, 0.1), first.tick()))
        assert {(command.name, command.operator) for command in first.commands} == {(CommandName.ABORT, "ground-anna")}
        until(
            lambda: {type(one).__name__ for one in first.others} == {"ReceivedTarget", "ReceivedTraffic", "BodyPose"},
            each=lambda: (
                target.publish(ZERO, ZERO),
                traffic.publish("4b18", ZERO, ZERO),
                cameras.publish(1, ZERO, UNIT),
                first.tick(),
            ),
        )
        assert not first.rejected


@pytest.mark.parametrize("who", ["no certificate", "foreign authority", "expired", "plain TCP"])
def test_a_stranger_is_not_connected(fleet: Identities, endpoint: str, who: str, tmp_path: Path) -> None:
    authority, tls, reached = fleet.folder / "authority" / "authority.pem", None, endpoint
    if who == "no certificate":
        tls = {"root_ca_certificate": str(authority), "verify_name_on_connect": False}
    elif who == "foreign authority":
        tls = tls_of(provisioned(tmp_path / "foreign").folder_of("vehicle-2"), authority)
    elif who == "expired":
        tls = tls_of(provisioned(tmp_path / "old", timedelta(days=10), 1).folder_of("vehicle-2"), authority)
    else:
        reached = "tcp/" + endpoint.partition("/")[2]
    with (
        vehicle(fleet, 1, listen=endpoint) as first,
        vehicle(fleet, 2, connect=endpoint) as second,
        closing(stranger(reached, tls)) as session,
    ):
        connected(first, second)
        attacked(first, everything(session, ("ground-anna", "mallory")))
        assert not first.received
        connected(first, second)


@pytest.mark.parametrize(
    ("who", "packets_of", "operators", "others"),
    [
        ("vehicle-2", {2}, set(), set()),
        ("ground-ben", set(), {"ground-ben"}, set()),
        ("monitor-tower", set(), set(), set()),
        ("target-beacon", set(), set(), {"ReceivedTarget"}),
        ("traffic-adsb", set(), set(), {"ReceivedTraffic"}),
        ("mocap-hall", set(), set(), {"BodyPose"}),
    ],
)
def test_a_participant_publishes_only_under_its_own_keys(
    fleet: Identities, who: str, packets_of: set[int], operators: set[str], others: set[str]
) -> None:
    endpoint = f"tls/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    with (
        vehicle(fleet, 1, listen=endpoint) as first,
        FleetSession(FLEET_NAME, [endpoint], identity=fleet.of("ground-anna")) as ground,
        closing(stranger(endpoint, tls_of(fleet.folder_of(who)))) as session,
    ):
        attacked(first, everything(session, ("ground-anna", "ground-ben", "vehicle-2")))
        assert {packet.sender.vehicle_id for packet in first.packets} == packets_of
        assert {command.operator for command in first.commands} == operators
        assert {type(one).__name__ for one in first.others} == others
        assert not [one for one in first.others if isinstance(one, BodyPose) and one.session == NOBODY]
        assert not first.rejected
        ground.drain()
        assert not ground.rejected


def test_who_is_revoked_is_not_used_from_the_next_list_on(tmp_path: Path) -> None:
    fleet = provisioned(tmp_path / "fleet")
    endpoint = f"tls/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    revoked = ("vehicle-2", "ground-anna", "target-beacon", "traffic-adsb", "mocap-hall")
    with vehicle(fleet, 1, listen=endpoint) as first:
        sessions = [stranger(endpoint, tls_of(fleet.folder_of(name))) for name in (*revoked, "vehicle-3", "ground-ben")]
        attacks = [everything(session, ("ground-anna", "ground-ben")) for session in sessions]
        until(
            lambda: min(map(len, (first.packets, first.commands))) > 10 and len(set(map(type, first.others))) == 3,
            each=lambda: ([attack() for attack in attacks], first.tick()),
        )
        authority = read_certificate((fleet.folder / "authority" / "authority.pem").read_bytes())
        held = fleet.of("vehicle-1").admitted
        first.link.admit(accept(fleet.revoke(*revoked).read_bytes(), authority, held))
        first.tick()
        for seen in (first.packets, first.commands, first.others):
            seen.clear()
        attacked(first, lambda: [attack() for attack in attacks] and None)
        assert {packet.sender.vehicle_id for packet in first.packets} == {3}
        assert {command.operator for command in first.commands} == {"ground-ben"}
        assert not first.others
        assert first.rejected.keys() == {Code.NOT_ADMITTED}
        assert first.link.network.admission == held.number + 1
        for session in sessions:
            session.close()


def test_an_endpoint_is_protected_exactly_where_there_is_an_identity(fleet: Identities) -> None:
    with pytest.raises(EndpointError, match="not protected; with an identity expected tls/HOST:PORT"):
        open_session([], ["tcp/127.0.0.1:7447"], fleet.of("ground-anna"))
    with pytest.raises(EndpointError, match="needs an identity"):
        open_session([], ["quic/127.0.0.1:7447"])
