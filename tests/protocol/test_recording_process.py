"""A real agent records. Its process is killed, and the file is read up to its last second."""

from __future__ import annotations

import signal
import time
from pathlib import Path

from pymavlink import mavutil

from common import until
from companion.recording.mcap_part import CHUNK_S
from companion.recording.reader import recordings
from companion.recording.records import INBOX, STATUS
from processes import agent, agent_files
from wire_autopilots import HoveringAutopilot

CHUNK_BYTES = 5000  # a second of this flight has some more
WRITTEN_WITHIN_S = 2.0  # on a busy machine


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob("*.mcap"))


def test_a_killed_agent_leaves_all_but_its_last_second(tmp_path: Path) -> None:
    files, state = agent_files(tmp_path), tmp_path / "state"
    with files.file.open("a", encoding="utf-8") as text:
        text.write("recording: {tlog: true}\n")
    folder = state / "recordings"
    with HoveringAutopilot(1, files.udp_port), agent(files, environment={"STATE_DIRECTORY": str(state)}) as process:
        process.wait_for_log(f"records into {folder}")
        process.wait_for_log("heartbeat of autopilot 1")
        until(lambda: size(folder) > 4 * CHUNK_BYTES)
        killed_s = time.monotonic()
        process.stop(signal.SIGKILL)
    (recorded,) = recordings(folder, print)
    ticks = list(recorded.ticks(print))
    assert [tick.number for tick in ticks] == list(range(1, len(ticks) + 1))
    assert all(tick.output for tick in ticks)
    assert killed_s - ticks[-1].now_s < CHUNK_S + WRITTEN_WITHIN_S
    assert any(tick.inbox.telemetry for tick in ticks)
    *_, status = recorded.read([STATUS], print)
    assert status.value.status.recording.state == "on"
    assert "private" not in recorded.header.vehicle_file
    (tlog,) = folder.glob("*.tlog")
    log = mavutil.mavlink_connection(str(tlog))
    kinds = set()
    while message := log.recv_match():
        kinds.add((message.get_type(), message.get_srcComponent()))
    assert {("HEARTBEAT", 1), ("HEARTBEAT", 191), ("LOCAL_POSITION_NED", 1), ("COMMAND_LONG", 191)} <= kinds


def test_an_agent_that_is_stopped_ends_its_file(tmp_path: Path) -> None:
    files, folder = agent_files(tmp_path), tmp_path / "here"
    with files.file.open("a", encoding="utf-8") as text:
        text.write("recording: {folder: here}\n")
    with HoveringAutopilot(1, files.udp_port), agent(files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        assert process.stop() == 0
    damaged: list[str] = []
    (recorded,) = recordings(folder, damaged.append)
    assert list(recorded.undecoded([INBOX], damaged.append))
    assert damaged == []
