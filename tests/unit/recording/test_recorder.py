"""An agent's recording holds every tick exactly, whatever its disk does, and no tick waits for it."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.reader import make_reader

from agent_on_bytes import PERIOD_S, FailingFlight
from common import until
from companion.link.tick import PREPARED_S
from companion.recording.codec import decode_inbox, decode_outbox, encode
from companion.recording.files import PartFiles
from companion.recording.mcap_part import MOST_BYTES, TOO_MUCH, MessageChunk
from companion.recording.reader import recordings
from companion.recording.records import DECISION, EVENT, INBOX, OUTBOX, TIMING, decision_record
from companion.recording.writing import WAITING, WritingAtOnce, WritingThread
from companion.types.autopilot import AutopilotKind
from companion.types.commands import Command, CommandName, ReferenceChange
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.tick import Inbox, Outbox
from companion.wire.rounding import round_outbox
from recordings import BEGAN_UNIX_S, Disk, recorder
from tests.helpers.laws import cooperative

P = FlightPhase
SECOND = round(1.0 / PERIOD_S)  # ticks


def flight_with(recording: object) -> FailingFlight:
    return FailingFlight(AutopilotKind.PX4, recording)  # type: ignore[arg-type]


def ticks_of(folder: Path) -> list[int]:
    """Numbers of the recorded ticks."""
    (recorded,) = recordings(folder, print)
    return [message.sequence for message in recorded.undecoded([INBOX], print)]


def test_every_tick_is_recorded_exactly(tmp_path: Path) -> None:
    taken: list[tuple[float, Inbox, Outbox]] = []
    decided: list[bytes] = []
    recording = recorder(tmp_path, WritingAtOnce())
    flight = flight_with(recording)
    decide, report = flight.agent.decide, flight.agent.report

    def deciding(now_s: float, inbox: Inbox):  # type: ignore[no-untyped-def]
        decision = decide(now_s, inbox)
        decided.append(encode(decision_record(decision, cooperative())))
        taken.append((now_s, inbox, round_outbox(report(decision))))
        return decision

    flight.agent.decide = deciding  # type: ignore[method-assign]
    flight.agent.report = lambda _decision: taken[-1][2]  # type: ignore[method-assign]
    flight.fly_to(P.FORMATION).ticks(1.0)
    recording.close()
    (file,) = tmp_path.glob("*.mcap")
    assert file.name == "vehicle_3_0001_001.mcap"
    with file.open("rb") as stream:
        messages = [
            (channel.topic, message) for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]
    inboxes = [decode_inbox(message.data) for topic, message in messages if topic == INBOX]
    outboxes = [decode_outbox(message.data) for topic, message in messages if topic == OUTBOX]
    assert inboxes == [(now_s, inbox) for now_s, inbox, _ in taken]
    assert outboxes == [(now_s, outbox) for now_s, _, outbox in taken]
    assert [message.data for topic, message in messages if topic == DECISION] == decided
    counts = Counter(topic for topic, _ in messages)
    assert counts[INBOX] == counts[OUTBOX] == counts[DECISION] == counts[TIMING] == len(taken)
    assert counts["/command"] == counts["/reply"] == 4
    assert len(flight.peers.reports) / 2 <= counts["/status"] < 0.75 * len(flight.peers.reports)
    at_events = {m.log_time for topic, m in messages if topic == OUTBOX and decode_outbox(m.data)[1].events}
    assert len(at_events) > 3
    assert at_events <= {m.log_time for topic, m in messages if topic == "/status"}
    first = next(message for topic, message in messages if topic == INBOX)
    assert first.log_time == round(BEGAN_UNIX_S * 1e9) + 20_000_000


def test_a_decision_has_no_position_before_the_first_one(tmp_path: Path) -> None:
    recording = recorder(tmp_path, WritingAtOnce())
    flight = flight_with(recording)
    flight.loop.tick(flight.now_s)  # without telemetry
    flight.fly_to(P.FORMATION)
    recording.close()
    (recorded,) = recordings(tmp_path, print)
    decisions = [record.value for record in recorded.read([DECISION], print)]
    assert (decisions[0].position_enu_m, decisions[0].velocity_enu_m_s) == (None, None)
    assert decisions[-1].position_enu_m[2] > 1.0


def test_a_full_disk_costs_records_and_no_tick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    flight: FailingFlight
    writing = WritingThread(clock_s=lambda: flight.now_s)
    recording = recorder(tmp_path, writing)
    flight = flight_with(recording)
    flight.fly_to(P.FORMATION)
    until(lambda: any(tmp_path.iterdir()))
    disk.room = 0
    sent = len(flight.autopilot.targets)
    for _ in range(10):
        flight.ticks(1.0)
        until(lambda: not writing.waiting)
    assert len(flight.autopilot.targets) - sent == 10 * SECOND
    assert flight.failed_s is None
    state = flight.peers.reports[-1].status.recording
    assert state.state == "dropping"
    assert state.dropped > 0
    assert "No space left" in writing.problem
    disk.room = 1 << 40
    for _ in range(20):
        flight.ticks(1.0)
        until(lambda: not writing.waiting)
    assert flight.peers.reports[-1].status.recording.state == "on"
    recording.close()
    recorded = ticks_of(tmp_path)
    assert recorded[-1] == recording.ticks
    assert 0 < recording.ticks - len(recorded) <= 17 * SECOND
    (whole,) = recordings(tmp_path, print)
    codes = [record.value.code for record in whole.read([EVENT], print)]
    assert codes.count(Code.RECORDING_RESUMED) == 1  # that of the beginning found the disk full


def test_a_disk_that_hangs_costs_records_and_no_tick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    writing = WritingThread()
    recording = recorder(tmp_path, writing)
    flight = flight_with(recording).fly_to(P.FORMATION)
    disk.works.clear()
    sent = len(flight.autopilot.targets)
    flight.ticks(1.0)
    assert disk.waiting.wait(60.0)
    flight.ticks(WAITING + 8.0)
    assert len(flight.autopilot.targets) - sent == round((WAITING + 9.0) * SECOND)
    assert flight.failed_s is None
    assert flight.peers.reports[-1].status.recording.state == "dropping"
    disk.works.set()
    until(lambda: not writing.waiting)
    flight.ticks(8.0)
    assert flight.peers.reports[-1].status.recording.state == "on"
    recording.close()
    recorded = ticks_of(tmp_path)
    assert recorded[-1] == recording.ticks
    assert 0 < recording.ticks - len(recorded) < 10 * SECOND


def largest_commands() -> tuple[Command, ...]:
    """As many as an agent takes in a tick, for an earlier start of it: each is refused."""
    points = [[i + 1.0 / 3.0, -i - 1.0 / 7.0, 1.0 / 9.0] for i in range(200)]
    content = ReferenceChange(1, {"kind": "waypoints", "points_enu_m": points}, 1.0)
    return tuple(Command(CommandName.REFERENCE, number, "mallory", 99, content) for number in range(1, 33))


def test_a_flood_of_commands_fills_neither_the_memory_nor_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writing, sizes = WritingAtOnce(), []
    recording = recorder(tmp_path, writing)
    flight = flight_with(recording).fly_to(P.FORMATION)
    put, flood, sent = writing.put, largest_commands(), len(flight.autopilot.targets)

    def sized(files: PartFiles[MessageChunk], chunk: MessageChunk, records: int) -> None:
        sizes.append(sum(map(len, chunk.frames)))
        put(files, chunk, records)

    monkeypatch.setattr(writing, "put", sized)
    receive = flight.peers.receive
    flight.peers.receive = lambda now_s: (receive(now_s)[0], flood)  # type: ignore[method-assign]
    flight.ticks(3.0)
    flight.peers.receive = receive  # type: ignore[method-assign]
    assert max(sizes) < 1.2 * MOST_BYTES
    assert flight.peers.reports[-1].status.recording.state == "dropping"
    assert writing.problem == TOO_MUCH
    assert len(flight.autopilot.targets) - sent == 3 * SECOND
    flight.ticks(10.0)
    assert flight.peers.reports[-1].status.recording.state == "on"
    recording.close()
    recorded = ticks_of(tmp_path)
    assert recorded[-1] == recording.ticks
    assert SECOND < recording.ticks - len(recorded) < 3 * SECOND  # a part of each second is kept


def test_a_process_ends_though_its_disk_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    monkeypatch.setattr("companion.recording.writing.CLOSE_WITHIN_S", 0.05)
    recording = recorder(tmp_path, WritingThread())
    flight = flight_with(recording)
    disk.works.clear()
    flight.ticks(WAITING + 5.0)
    recording.close()
    disk.works.set()


def test_a_removed_folder_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    writing = WritingThread(clock_s=lambda: flight.now_s)
    recording = recorder(folder, writing)
    flight = flight_with(recording)
    flight.ticks(2.0)
    until(lambda: not writing.waiting and folder.exists())
    shutil.rmtree(folder)
    for _ in range(10):
        flight.ticks(1.0)
        until(lambda: not writing.waiting)
    assert flight.peers.reports[-1].status.recording.state == "dropping"
    recording.close()
    assert ticks_of(folder)[-1] == recording.ticks


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into any folder")
def test_a_folder_without_permission_costs_no_tick(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir(mode=0o500)
    check_without_a_file(folder)


def test_a_folder_that_cannot_be_made_costs_no_tick(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    check_without_a_file(tmp_path / "file" / "recordings")


def check_without_a_file(folder: Path) -> None:
    writing = WritingThread()
    recording = recorder(folder, writing)
    flight = flight_with(recording)
    flight.ticks(3.0)
    until(lambda: writing.dropped > 0)
    flight.ticks(3.0)
    assert flight.failed_s is None
    assert flight.peers.reports[-1].status.recording.state == "dropping"
    recording.close()


def test_a_clock_that_steps_back_changes_no_time_of_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = recorder(tmp_path, WritingThread())
    flight = flight_with(recording)
    flight.ticks(2.0)
    monkeypatch.setattr("time.time", lambda: 1.0)
    monkeypatch.setattr("time.time_ns", lambda: 10**9)
    flight.ticks(2.0)
    recording.close()
    (recorded,) = recordings(tmp_path, print)
    times_ns = [message.log_time_ns for message in recorded.undecoded([INBOX], print)]
    period_ns = round(PERIOD_S * 1e9)
    assert [b - a for a, b in pairwise(times_ns)] == pytest.approx([period_ns] * (4 * SECOND - 1))


def test_a_defect_of_the_recorder_ends_the_recording_and_not_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    recording = recorder(tmp_path, WritingAtOnce())
    flight = flight_with(recording).fly_to(P.FORMATION)
    monkeypatch.setattr("companion.recording.recorder.encode_inbox", lambda *_: 1 / 0)
    sent = len(flight.autopilot.targets)
    flight.ticks(1.0)
    assert len(flight.autopilot.targets) - sent == SECOND
    assert flight.failed_s is None
    assert flight.peers.reports[-1].status.recording.state == "dropping"
    assert sum("recording ends after a defect" in record.message for record in caplog.records) == 1
    recording.close()


def test_the_failure_of_an_agent_is_recorded(tmp_path: Path) -> None:
    recording = recorder(tmp_path, WritingAtOnce())
    flight = flight_with(recording).fly_to(P.FORMATION)
    flight.inject(flight.agent.perception, "step")
    flight.ticks(1.0)
    recording.close()
    (recorded,) = recordings(tmp_path, print)
    assert [record.value.code for record in recorded.read([EVENT], print)][-1] is Code.AGENT_FAILED
    *_, before, failed = recorded.ticks(print)
    assert before.output and not failed.output  # the input that the agent failed at
    assert failed.now_s > before.now_s


def test_a_tick_is_recorded_with_what_its_first_part_saw_and_when(tmp_path: Path) -> None:
    recording = recorder(tmp_path, WritingAtOnce())
    flight = flight_with(recording).fly_to(P.FORMATION)
    flight.inject(flight.agent.consensus, "receive")
    flight.ticks(1.0)
    recording.close()
    (recorded,) = recordings(tmp_path, print)
    *_, before, failed = recorded.ticks(print)
    assert before.inbox.prepared_s == pytest.approx(before.now_s - PREPARED_S)
    assert failed.now_s == failed.inbox.prepared_s == flight.failed_s - PREPARED_S
    assert not failed.output
