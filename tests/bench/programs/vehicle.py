"""What the programs share that publish and receive peer states as a vehicle does, without its flight."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterable

from companion.link.tick import PERIOD_S
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import ZERO3


class Input:
    """Standard input, read in a thread: `begun` is set by its first line, `ended` by its end."""

    def __init__(self) -> None:
        self.begun, self.ended = threading.Event(), threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        sys.stdin.readline()
        self.begun.set()
        sys.stdin.read()
        self.ended.set()


class TickGrid:
    """Ticks at 50 Hz. With `drift` the ticks of two vehicles pass each other in time, so that no result depends on luck."""

    def __init__(self, drift: float = 0.0) -> None:
        self._period_s = PERIOD_S * (1.0 + drift)
        self._due_s = time.monotonic()

    def wait(self) -> float:
        """Until the next tick; the time then."""
        self._due_s += self._period_s
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        return time.monotonic()


class NewestStates:
    """`sent_s` of the newest packet of each vehicle: one machine has one clock."""

    def __init__(self) -> None:
        self.sent_s: dict[int, float] = {}

    def take(self, packets: Iterable[PeerPacket]) -> None:
        for packet in packets:
            self.sent_s[packet.sender.vehicle_id] = max(
                packet.motion.sent_s, self.sent_s.get(packet.sender.vehicle_id, packet.motion.sent_s)
            )

    def ages_s(self, now_s: float) -> list[float]:
        return [now_s - sent_s for sent_s in self.sent_s.values()]


def example_packet(vehicle_id: int) -> PeerPacket:
    """A packet in formation, of the usual size."""
    return PeerPacket(
        sender=Sender(vehicle_id=vehicle_id, session=2**61, sequence=0, formation_hash=2**61),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(1.5, 2.5, 10.5),
            velocity_enu_m_s=(0.5, 0.5, 0.5),
            acceleration_enu_m_s2=(0.1, 0.1, 0.1),
            state_age_s=0.01,
            sent_s=0.0,
        ),
        leader=LeaderReport(prc=2, beacon=LeaderBeacon(1, 1, 100_000, 100.5)),
        slot=FlownSlot(ZERO3),
    )


def ignore_refused(_rejected: str) -> None:
    """A refused packet shows in the age."""
