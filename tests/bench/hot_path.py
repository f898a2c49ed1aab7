"""What lies between a position and its setpoint: calls and bytes that a follower's process needs, counted.

python -m tests.bench.hot_path    the figures as JSON

The platoon flies in lockstep until follower 2 is in steady formation. From then on that agent is in the real control loop, and
its link and the packets are bytes: the stand-in's MAVLink, one datagram for each message, and the peers' packets as they are
on the wire. Counted is from the first datagram of a position's wake-up to the setpoint at the socket; sockets are left out.
Each figure is the median of the ticks.
"""

from __future__ import annotations

import json
import statistics
import sys
import tracemalloc
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass
from math import inf
from types import FrameType
from typing import TYPE_CHECKING, cast
from unittest.mock import patch

from companion.link import autopilot_link
from companion.link.autopilot_link import AutopilotLink
from companion.link.byte_links import AllRead, Received, ReceivedBeside, UdpLink
from companion.link.control_loop import ControlLoop
from companion.link.systemd import Notifier
from companion.link.tick import Ticking, TickTrigger
from companion.mavlink.translator import Translator
from companion.types.commands import Command, CommandReply
from companion.types.peers import PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import NetworkState
from companion.wire.messages import StatusReport, decode_peer, encode, encode_peer
from sitl.flight.director import Director
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_vehicle import VirtualAgent, VirtualStandIn, VirtualTimer
from sitl.flight.watch import watch_of
from sitl.links.direct_link import rates_hz
from sitl.report.progress import FlightProgress
from tests.bench.tick import COMPREHENSIONS, COUNTED_S, FOLLOWER_ID, PLATOON, SETTLING_S

if TYPE_CHECKING:
    from companion.link.fleet.zenoh_link import ZenohLink


@dataclass(frozen=True, slots=True)
class HotPath:
    """Medians over the ticks. `copied_bytes`: all that a whole tick receives, sends and publishes."""

    calls: int
    allocated_bytes: int
    copied_bytes: int


class PeerBytes:
    """The network's end of the loop: packets of the other vehicles are decoded, and its own is encoded."""

    network, is_open = NetworkState(), True

    def __init__(self, vehicle: VirtualAgent) -> None:
        self._vehicle = vehicle
        self.copied_bytes = 0

    def receive(self, now_s: float) -> tuple[tuple[ReceivedPeerPacket, ...], tuple[Command, ...]]:
        return self.receive_late(now_s), ()

    def receive_late(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        packets = [encode_peer(one.packet) for one in self._vehicle.network.receive(FOLLOWER_ID, now_s)]
        self.copied_bytes += sum(map(len, packets))
        return tuple([ReceivedPeerPacket(now_s, decode_peer(packet)) for packet in packets])

    def traffic(self, _now_s: float) -> tuple[ReceivedTraffic, ...]:
        return ()

    def targets(self, _now_s: float) -> tuple[ReceivedTarget, ...]:
        return ()

    def checks(self) -> tuple[Command, ...]:
        return ()

    def publish_peer(self, packet: PeerPacket) -> None:
        data = encode_peer(packet)
        self.copied_bytes += len(data)
        self._vehicle.network.send(decode_peer(data), packet.motion.sent_s)

    def set_low_rate_peers(self, distant_ids: Collection[int]) -> None:
        assert not distant_ids

    def publish_status(self, report: StatusReport) -> None:
        self.copied_bytes += len(encode(report))

    def reply(self, replies: Iterable[CommandReply]) -> None:
        assert not list(replies)


class MeasuredVehicle:
    """In place of the follower and its stand-in in lockstep: the agent in the real control loop, on bytes."""

    def __init__(self, stand_in: VirtualStandIn, vehicle: VirtualAgent, now_s: float) -> None:
        self.calls: list[int] = []  # of every second tick; of the others the bytes
        self.allocated_bytes: list[int] = []
        self.copied_bytes: list[int] = []
        self._stand_in, self._end = stand_in, stand_in.link.end
        self._datagrams: list[bytes] = []
        self._peers = PeerBytes(vehicle)
        self._copied, self._found = 0, 0
        self._counts_calls = False
        self._timer = VirtualTimer()
        self._timer.now_s = self._stepped_s = now_s
        ticking = Ticking(self._timer, self._tick, self._prepare)
        with patch.object(autopilot_link, "open_link", self._opened):
            translator, arrived = Translator(FOLLOWER_ID, stand_in.autopilot.kind), ticking.position_arrived
            link = AutopilotLink(FOLLOWER_ID, "", translator, arrived, _refused)
        peers = cast("ZenohLink", self._peers)
        self._loop = ControlLoop(vehicle.agent, link, peers, TickTrigger(), Notifier({}))
        self._end.schedule.reset(rates_hz(stand_in.autopilot.kind), stand_in.autopilot.time_s)
        stand_in.step = self._step  # type: ignore[method-assign]

    def _opened(self, _endpoint: str, received: Received, all_read: AllRead, _beside: ReceivedBeside) -> UdpLink:
        """Its socket is this object."""
        self._received, self._all_read = received, all_read
        return cast("UdpLink", self)

    def send(self, data: bytes) -> None:
        """A packet of the agent: in the tick of a position the setpoint is the first."""
        if sys.getprofile() or tracemalloc.is_tracing():
            self._end_count()
            (self.calls if self._counts_calls else self.allocated_bytes).append(self._found)
        self._copied += len(data)
        self._datagrams += self._end.receive(data)

    def _step(self, now_s: float) -> None:
        """As `VirtualStandIn.step`."""
        self._stand_in.autopilot.step()
        self._datagrams += self._end.due()
        self._stepped_s = now_s

    @property
    def next_s(self) -> float:
        """As `VirtualAgent.next_s`."""
        return min(self._stepped_s if self._datagrams else inf, self._timer.at_s)

    def go_on(self, now_s: float) -> None:
        """As `VirtualAgent.go_on`: one wake-up of the process, by datagrams or by the timer of the ticks."""
        self._timer.now_s = now_s
        if not self._datagrams:
            self._timer.fire()
            return
        datagrams, self._datagrams = self._datagrams, []
        self._copied += sum(map(len, datagrams))
        self._begin()
        for datagram in datagrams:
            self._received(datagram, now_s)
        self._all_read()
        self._end_count()

    def _tick(self) -> None:
        self._loop.tick(self._timer.now_s)
        self._counts_calls = not self._counts_calls
        self.copied_bytes.append(self._copied + self._peers.copied_bytes)
        self._copied = self._peers.copied_bytes = 0

    def _prepare(self) -> None:
        self._loop.prepare(self._timer.now_s)

    # ------------------------------------------------------------ counting

    def _begin(self) -> None:
        self._found = 0
        if self._counts_calls:
            sys.setprofile(self._observe)
        else:
            tracemalloc.start()

    def _observe(self, frame: FrameType, event: str, _argument: object) -> None:
        if event == "call" and frame.f_code.co_name not in COMPREHENSIONS:
            self._found += 1

    def _end_count(self) -> None:
        """At the first packet that is sent, or without one at the end of the wake-up."""
        sys.setprofile(None)
        if tracemalloc.is_tracing():
            self._found = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()


def _refused(code: str) -> None:
    raise RuntimeError(f"refused: {code}")


def figures() -> HotPath:
    """Flies the platoon. Raises RuntimeError where the follower sends no setpoints."""
    scenario = load_scenario(PLATOON, [f"timeline[3].for_s={SETTLING_S}"])
    lockstep = Lockstep(scenario)
    watch = watch_of(scenario, lockstep.now_s())
    director = Director(lockstep, watch, FlightProgress("", True, 0.0), lambda: None, tuple, lockstep)
    director.fly(scenario.timeline[:-1])
    at = list(lockstep.vehicles).index(FOLLOWER_ID)
    measured = MeasuredVehicle(lockstep.stand_ins[at], lockstep.vehicles[FOLLOWER_ID], lockstep.now_s())
    lockstep.in_order[at] = cast("VirtualAgent", measured)
    lockstep.sleep(COUNTED_S)
    if not measured.calls:
        raise RuntimeError(f"vehicle {FOLLOWER_ID} sent no setpoint")
    return HotPath(
        calls=statistics.median_low(measured.calls),
        allocated_bytes=statistics.median_low(measured.allocated_bytes),
        copied_bytes=statistics.median_low(measured.copied_bytes),
    )


def main() -> int:
    """The exit code."""
    print(json.dumps(asdict(figures()), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
