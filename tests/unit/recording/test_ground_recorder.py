"""The ground records what it receives and what it commands."""

from __future__ import annotations

from pathlib import Path

from agent_on_bytes import FailingFlight
from common import until
from companion.monitor.recordings import read_flight
from companion.recording.reader import recordings
from companion.recording.recorder import ground_recorder
from companion.recording.records import GROUND_COMMAND, GROUND_STATUS
from companion.recording.writing import WritingThread
from companion.types.autopilot import AutopilotKind
from companion.types.commands import Command, CommandName


def test_statuses_and_commands_are_recorded(tmp_path: Path) -> None:
    flight = FailingFlight(AutopilotKind.PX4)
    flight.ticks(1.0)
    report = flight.peers.reports[-1]
    command = Command(CommandName.ARM, 1, "anna@ground", report.status.agent.session)
    writing = WritingThread()
    recorder = ground_recorder("one", None, tmp_path, 1_700_000_000.0, 50.0, writing)
    recorder.status(report, 51.0)
    recorder.command(command, 51.0)
    assert recorder.step(51.5) is None
    assert not any(tmp_path.iterdir())
    recorder.step(52.0)  # also without another message
    until(lambda: not writing.waiting)
    assert [path.name for path in tmp_path.iterdir()] == ["ground_0001_001.mcap"]
    recorder.close()
    (recorded,) = recordings(tmp_path, print)
    records = list(recorded.read([GROUND_STATUS, GROUND_COMMAND], print))
    assert [(record.topic, record.now_s, record.value) for record in records] == [
        (GROUND_STATUS, 51.0, report),
        (GROUND_COMMAND, 51.0, command),
    ]
    assert recorded.header.vehicle_id == 0
    source = read_flight(tmp_path, print, lambda: 0.0).source
    source.go_on(source.replay.end_s + 1.0)
    (happening,) = source.drain_happenings()
    assert (happening.vehicle_id, happening.kind, happening.code) == (report.status.agent.vehicle_id, "command", "arm")
