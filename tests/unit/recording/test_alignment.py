"""Recordings of vehicles whose clocks have nothing in common, on one clock by the packets between them."""

from collections.abc import Iterable
from pathlib import Path

import pytest
from msgspec.structs import replace

from common import with_fields
from companion.recording.alignment import RecordingClock, align
from companion.recording.reader import Recording, recordings
from companion.recording.records import INBOX, STATUS
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import LeaderReport, Motion, PeerPacket, ReceivedPeerPacket, Sender
from companion.types.tick import Inbox
from companion.types.values import ZERO3
from companion.wire.messages import StatusReport
from ground_fleet import DIRECTED_TIMING
from ground_fleet import directed_status as status_of
from recordings import HEADER, RecordingFile

TICK_S, DELAY_S, FLIGHT_S = 0.02, 0.004, 60.0


class Computer:
    """A vehicle whose monotonic clock began at `booted_s` of true time, runs fast by `rate`, and has a wrong date."""

    def __init__(self, vehicle_id: int, booted_s: float, rate: float = 0.0, unix_s: float = 1.7e9) -> None:
        self.vehicle_id, self.booted_s, self.rate = vehicle_id, booted_s, rate
        self.header = replace(
            HEADER, vehicle_id=vehicle_id, session=vehicle_id * 11, unix_s=unix_s, monotonic_s=self.now_s(0.0)
        )

    def now_s(self, true_s: float) -> float:
        return (true_s - self.booted_s) * (1.0 + self.rate)

    def packet(self, true_s: float) -> PeerPacket:
        return PeerPacket(
            sender=Sender(vehicle_id=self.vehicle_id, session=self.header.session, sequence=1, formation_hash=1),
            phase=FlightPhase.HOLD,
            role=Role.FOLLOWER,
            motion=Motion(
                position_enu_m=ZERO3,
                velocity_enu_m_s=ZERO3,
                acceleration_enu_m_s2=ZERO3,
                state_age_s=0.0,
                sent_s=self.now_s(true_s),
            ),
            leader=LeaderReport(prc=1, beacon=None),
            slot=FlownSlot(ZERO3),
        )

    def record(self, folder: Path, senders: Iterable["Computer"]) -> None:
        """Its inputs: a packet of each of the others at every tick."""
        file = RecordingFile(folder / f"{self.vehicle_id}.mcap", self.header)
        for number in range(1, round(FLIGHT_S / TICK_S)):
            true_s = number * TICK_S
            now_s = self.now_s(true_s)
            packets = [ReceivedPeerPacket(now_s, other.packet(true_s - DELAY_S)) for other in senders]
            file.tick(number, now_s, Inbox(peers=tuple(packets)), None)
            if number % 50 == 0:
                file.write(STATUS, now_s, StatusReport(status_of(self.vehicle_id), DIRECTED_TIMING))
        file.close()


def recorded(folder: Path, senders: dict[Computer, list[Computer]]) -> list[Recording]:
    for computer, others in senders.items():
        computer.record(folder, others)
    return recordings(folder, print)


def apart_s(a: tuple[Computer, RecordingClock], b: tuple[Computer, RecordingClock], true_s: float) -> float:
    """How far apart one true moment is for two recordings."""
    return abs(a[1].common_s(a[0].now_s(true_s)) - b[1].common_s(b[0].now_s(true_s)))


def test_vehicles_with_drifting_clocks_and_wrong_dates(tmp_path: Path) -> None:
    fleet = [
        Computer(1, -500.0, 50e-6),
        Computer(2, -9.0, -50e-6, unix_s=0.0),
        Computer(3, -70_000.0, 10e-6, unix_s=5e9),
    ]
    clocks = align(recorded(tmp_path, {one: [other for other in fleet if other is not one] for one in fleet}), print)
    placed = list(zip(fleet, clocks, strict=True))
    assert all(clock.is_aligned for clock in clocks)
    for true_s in (0.0, 30.0, 60.0):
        assert apart_s(placed[0], placed[1], true_s) < 0.001
        assert apart_s(placed[0], placed[2], true_s) < 0.001
    assert clocks[0].common_s(fleet[0].header.monotonic_s) == pytest.approx(1.7e9)


def test_a_vehicle_is_aligned_over_another(tmp_path: Path) -> None:
    """1 and 3 never receive each other."""
    one, two, three = Computer(1, -500.0), Computer(2, -9.0), Computer(3, -80.0)
    clocks = align(recorded(tmp_path, {one: [two], two: [one, three], three: [two]}), print)
    assert apart_s((one, clocks[0]), (three, clocks[2]), 30.0) < 0.001
    assert clocks[2].width_s == pytest.approx(4 * DELAY_S, abs=1e-4)


def test_without_packets_each_keeps_its_date(tmp_path: Path) -> None:
    one, two = Computer(1, -500.0), Computer(2, -9.0, unix_s=1.7e9 + 3.0)
    clocks = align(recorded(tmp_path, {one: [], two: [one]}), print)
    assert not any(clock.is_aligned for clock in clocks)
    assert clocks[1].common_s(two.header.monotonic_s + 5.0) == pytest.approx(1.7e9 + 8.0)


def test_the_reference_is_connected_with_the_most(tmp_path: Path) -> None:
    one, two, three = Computer(1, -500.0, unix_s=1e9), Computer(2, -9.0), Computer(3, -80.0)
    clocks = align(recorded(tmp_path, {one: [], two: [three], three: [two]}), print)
    assert [clock.is_aligned for clock in clocks] == [False, True, True]
    assert clocks[1].common_s(two.header.monotonic_s) == pytest.approx(1.7e9)
    assert clocks[0].common_s(one.header.monotonic_s) == pytest.approx(1e9)


def test_a_restarted_agent_has_the_clock_of_its_computer(tmp_path: Path) -> None:
    one, two, again = Computer(1, -500.0), Computer(2, -9.0), Computer(2, -9.0, unix_s=1.7e9 + 0.5)
    again.header = replace(again.header, session=99)
    one.record(tmp_path, [two])
    two.record(tmp_path, [one])
    again.record(tmp_path / "later", [])
    clocks = align(recordings(tmp_path, print), print)
    assert all(clock.is_aligned for clock in clocks)
    assert apart_s((two, clocks[1]), (again, clocks[2]), 30.0) < 1e-6


def test_numbers_without_sense_are_not_used(tmp_path: Path) -> None:
    one, two = Computer(1, -500.0), Computer(2, -9.0)
    two.record(tmp_path, [one])
    file = RecordingFile(tmp_path / "1.mcap", one.header)
    for number in range(1, 3000):
        now_s = one.now_s(number * TICK_S)
        packet = two.packet(number * TICK_S - DELAY_S)
        wild = with_fields(packet, sent_s=(1e300, float("nan"), float("-inf"))[number % 3])
        inbox = Inbox(peers=(ReceivedPeerPacket(now_s, wild), ReceivedPeerPacket(now_s, packet)))
        file.tick(number, now_s, inbox, None)
    file.raw(INBOX, 1.0, b"garbage", 3000)
    file.close()
    clocks = align(recordings(tmp_path, print), print)
    assert apart_s((one, clocks[0]), (two, clocks[1]), 30.0) < 0.001
