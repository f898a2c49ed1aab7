"""Motion-capture poses from a publisher to the event loop of an agent, over real sessions."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from math import inf, nan
from threading import Event, Thread

import msgspec
import pytest
import zenoh

from common import until
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.vehicle import ZenohEndpoints
from companion.ground.publishers import PosePublisher
from companion.link.fleet.zenoh_link import POSES_KEPT, ZenohLink
from companion.link.fleet.zenoh_session import drain, open_session
from companion.types.flight import Role
from companion.types.notices import Code
from companion.types.peers import BodyPose
from companion.types.values import Vector3
from companion.wire.keys import pose_key
from companion.wire.messages import WIRE_VERSION, decode_pose, encode
from heard_poses import UNIT, HeardPoses, hearing_poses
from processes import free_port

FLEET = FleetConfig(
    name="hall",
    origin="indoor",
    vehicles=(FormationMember(id=1, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),),
    neighbours=EdgeNeighbours(edges=()),
)
KEY = pose_key(FLEET.name, "main", 1)
FLOOD = 20_000
POSE = BodyPose(7, 1, 0.0, (1.0, 2.0, 3.0), UNIT)
GOOD = msgspec.to_builtins(POSE)
LAST: Vector3 = (9.0, 9.0, 9.0)


@dataclass
class Agent:
    """Vehicle 1, a publisher and a stranger, all connected."""

    link: ZenohLink
    heard: HeardPoses
    rejected: Counter[str]
    cameras: PosePublisher
    stranger: zenoh.Session

    def flood(self, count: int = FLOOD) -> None:
        """Poses as fast as they can be sent."""
        for number in range(count):
            pose = encode(BodyPose(7, number, 0.0, (0.001 * (number % 1000), 0.0, 0.0), UNIT))
            self.stranger.put(KEY, pose, congestion_control=zenoh.CongestionControl.DROP, express=True)

    def send_last(self) -> None:
        """One more. Repeated: it is dropped while the network is congested."""
        self.cameras.publish(1, LAST, UNIT)

    def has_last(self) -> bool:
        return bool(self.heard.poses) and self.heard.poses[-1][0].position_enu_m == LAST


@pytest.fixture
def agent() -> Iterator[Agent]:
    endpoint, rejected = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}", Counter[str]()
    link = ZenohLink(1, FLEET, ZenohEndpoints(listen=(endpoint,)), lambda reason: rejected.update([reason]))
    with (
        closing(link),
        hearing_poses(link) as heard,
        PosePublisher(FLEET.name, (endpoint,)) as cameras,
        closing(open_session((), (endpoint,))) as stranger,
    ):
        until(lambda: heard.poses, each=lambda: cameras.publish(1, (0.0, 0.0, 0.0), UNIT))
        heard.poses.clear()
        until(lambda: heard.poses, each=lambda: stranger.put(KEY, encode(POSE)))
        time.sleep(0.05)  # what is still under way
        heard.settle()
        heard.poses.clear()
        yield Agent(link, heard, rejected, cameras, stranger)
        assert not heard.errors


def test_poses_arrive_once_and_in_order_with_their_times(agent: Agent) -> None:
    """Single ones may be dropped where the machine is busy."""
    sent_s: list[float] = []

    def publish() -> None:
        for _ in range(2):
            sent_s.append(time.monotonic())
            agent.cameras.publish(1, (float(len(sent_s)), 2.0, 3.0), (0.0, 0.6, 0.0, 0.8), age_s=0.004)

    until(lambda: len(agent.heard.poses) >= 50, each=publish)
    agent.heard.settle()
    poses, arrived_s = zip(*agent.heard.poses, strict=True)
    numbers = [int(pose.position_enu_m[0]) for pose in poses]
    assert numbers == sorted(set(numbers))
    assert len({pose.sequence - number for number, pose in zip(numbers, poses, strict=True)}) == 1
    assert {(pose.session, pose.position_enu_m[1:], pose.quaternion, pose.age_s) for pose in poses} == {
        (poses[0].session, (2.0, 3.0), (0.0, 0.6, 0.0, 0.8), 0.004)
    }
    for number, pose, at_s in zip(numbers, poses, arrived_s, strict=True):
        assert sent_s[number - 1] <= pose.sent_s <= at_s <= time.monotonic()
    assert list(arrived_s) == sorted(arrived_s)
    assert not agent.rejected


BAD = {
    "nonsense": b"nonsense",
    "not finite": msgspec.msgpack.encode(GOOD | {"position_enu_m": (nan, 0.0, 0.0)}),
    "quaternion not finite": msgspec.msgpack.encode(GOOD | {"quaternion": (nan, 0.0, 0.0, 0.0)}),
    "time not finite": msgspec.msgpack.encode(GOOD | {"sent_s": inf}),
    "quaternion too long": msgspec.msgpack.encode(GOOD | {"quaternion": (1.5, 0.0, 0.0, 0.0)}),
    "too far": msgspec.msgpack.encode(GOOD | {"position_enu_m": (1e9, 0.0, 0.0)}),
    "older than possible": msgspec.msgpack.encode(GOOD | {"age_s": 1e3}),
    "from the future": msgspec.msgpack.encode(GOOD | {"age_s": -0.1}),
    "a field more": msgspec.msgpack.encode(GOOD | {"more": 1}),
    "a field less": msgspec.msgpack.encode({name: value for name, value in GOOD.items() if name != "quaternion"}),
    "oversized": msgspec.msgpack.encode(GOOD) + bytes(60_000),
    "a long text": msgspec.msgpack.encode("x" * 60_000),
}
WRONG_KEYS = (
    "**",
    "formation/**",
    f"formation/{FLEET.name}/pose/*/1",
    "formation/*/pose/main/1",
    KEY.replace("main", "ü"),
)


def test_what_is_no_pose_is_counted_and_nothing_else_happens(agent: Agent) -> None:
    puts = [(KEY, bytes((WIRE_VERSION,)) + payload) for payload in BAD.values()]
    puts += [(key, encode(POSE)) for key in WRONG_KEYS]
    for key, payload in puts:
        before = agent.rejected.copy()
        until(lambda before=before: agent.rejected != before, each=lambda put=(key, payload): agent.stranger.put(*put))  # type: ignore[misc]
        time.sleep(0.02)  # one that was sent again meanwhile
    agent.heard.settle()
    assert set(agent.rejected) == {Code.POSE_MALFORMED}
    assert not agent.heard.poses
    until(lambda: agent.heard.poses, each=lambda: agent.cameras.publish(1, LAST, UNIT))


def test_poses_of_others_are_not_delivered(agent: Agent) -> None:
    for key in (pose_key(FLEET.name, "main", 2), pose_key(FLEET.name, "main", 11), pose_key("other", "main", 1)):
        for _ in range(5):
            agent.stranger.put(key, encode(POSE))
    until(agent.has_last, each=agent.send_last)
    assert {pose.position_enu_m for pose, _ in agent.heard.poses} == {LAST}
    assert not agent.rejected


def test_a_loop_that_hangs_in_a_flood_finds_the_newest_poses_alone(agent: Agent) -> None:
    witness = agent.link.session.declare_subscriber(KEY, zenoh.handlers.RingChannel(FLOOD))
    with agent.heard.blocked():
        agent.flood()
        arrived = list[zenoh.Sample]()
        until(
            lambda: LAST in [decode_pose(one.payload.to_bytes()).position_enu_m for one in arrived[-1:]],
            each=lambda: (agent.send_last(), arrived.extend(drain(witness, FLOOD))),
        )
        time.sleep(0.1)  # it arrives in the link as well
    assert len(arrived) > 10 * POSES_KEPT
    assert 0 < len(agent.heard.poses) <= POSES_KEPT
    assert agent.has_last()
    assert not agent.rejected


def test_a_flood_takes_a_few_poses_of_each_pass_of_the_loop(agent: Agent) -> None:
    """So whatever else waits in the loop runs among them."""
    of_each, ended = list[int](), Event()
    agent.heard.takes_s = 0.001

    def look(before: int) -> None:
        of_each.append((count := len(agent.heard.poses)) - before)
        if not ended.is_set():
            agent.heard.loop.call_soon(look, count)

    agent.heard.loop.call_soon_threadsafe(look, 0)
    agent.flood(FLOOD // 2)
    until(agent.has_last, each=agent.send_last)
    ended.set()
    agent.heard.settle()
    assert sum(of_each) == len(agent.heard.poses)
    assert max(of_each) <= 2 * POSES_KEPT


def test_a_link_is_closed_while_poses_arrive(agent: Agent) -> None:
    ended = Event()

    def publish() -> None:
        while not ended.is_set():
            agent.cameras.publish(1, (0.0, 0.0, 0.0), UNIT)

    publishing = Thread(target=publish)
    publishing.start()
    try:
        until(lambda: len(agent.heard.poses) > 100)
        with agent.heard.blocked():  # poses wait
            time.sleep(0.05)
            agent.link.close()
            heard = len(agent.heard.poses)
        time.sleep(0.1)
        agent.heard.settle()
    finally:
        ended.set()
        publishing.join()
    assert len(agent.heard.poses) == heard  # nothing is passed on to what is closed after the link
    assert agent.link.session.is_closed()
    assert not agent.rejected
