"""`companion monitor --tui` as a process, beside a real agent."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from common import until
from processes import AgentFiles, agent, agent_files, companion
from wire_autopilots import HoveringAutopilot


@pytest.fixture
def files(tmp_path: Path) -> AgentFiles:
    return agent_files(tmp_path)


def test_the_monitor_lists_the_vehicle(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port), agent(files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        table = companion("monitor", "--connect", files.zenoh, "--once")
        rows = json.loads(companion("monitor", "--connect", files.zenoh, "--once", "--json").stdout)
    assert table.returncode == 0, table.stderr
    heading, header, line, *_ = table.stdout.splitlines()
    assert heading == "fleet processtest: 1 vehicle, leader 1"
    assert header.split()[:3] == ["id", "phase", "mode"]
    assert line.split()[:4] == ["1", "observe", "AUTO.LOITER", "armed"]
    assert rows[0]["position_enu_m"] == pytest.approx([0.0, 0.0, 2.0], abs=0.05)
    assert rows[0]["vehicle_id"] == 1
    assert rows[0]["error_to_slot_m"] == pytest.approx(0.0, abs=1e-3)
    assert rows[0]["silent"] is False


def test_the_monitor_shows_a_killed_vehicle_as_silent(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port), agent(files) as process:
        monitor = subprocess.Popen(
            [sys.executable, "-m", "companion", "monitor", "--tui", "--connect", files.zenoh],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert monitor.stdout
            lines = iter(monitor.stdout)
            assert "observe" in next(line for line in lines if line.startswith("  1 "))
            process.process.kill()
            assert "SILENT" in next(line for line in lines if line.startswith("  1 ") and "observe   " not in line)
            heading = next(line for line in lines if line.startswith("fleet "))
            assert heading == "fleet processtest: 1 vehicle, SILENT: vehicle 1, NO LEADER\n"
            assert "SILENT" in next(line for line in lines if line.startswith("  1 "))  # and it stays
            monitor.send_signal(signal.SIGINT)
            assert monitor.wait(10.0) == 0
            assert monitor.stderr
            assert monitor.stderr.read() == ""
        finally:
            monitor.kill()
            monitor.communicate()


def test_the_monitor_names_endpoints_that_cannot_be_reached(files: AgentFiles) -> None:
    result = companion("monitor", "--connect", files.zenoh, "--fleet", "other", "--once")
    assert result.returncode == 1
    assert f"no report for 3 s ({files.zenoh}: connection refused; no agent listens there)" in result.stderr


@pytest.mark.parametrize("columns", ["80", "160"])
def test_a_terminal_gets_a_live_table(files: AgentFiles, columns: str) -> None:
    terminal, terminal_of_the_monitor = pty.openpty()
    os.set_blocking(terminal, False)
    shown = b""

    def look() -> str:
        nonlocal shown
        with contextlib.suppress(BlockingIOError):
            shown += os.read(terminal, 65536)
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode(errors="replace"))

    with HoveringAutopilot(1, files.udp_port), agent(files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        monitor = subprocess.Popen(
            [sys.executable, "-m", "companion", "monitor", "--tui", "--connect", files.zenoh],
            stdout=terminal_of_the_monitor,
            stderr=terminal_of_the_monitor,
            env={**os.environ, "TERM": "xterm", "COLUMNS": columns, "LINES": "40"},
        )
        os.close(terminal_of_the_monitor)
        try:
            until(lambda: "AUTO.LOITER" in look())
            process.process.kill()
            until(lambda: "SILENT: vehicle 1" in look())
            monitor.send_signal(signal.SIGINT)
            assert monitor.wait(10.0) == 0
            assert "Traceback" not in shown.decode(errors="replace")
        finally:
            monitor.kill()
            monitor.wait()
            os.close(terminal)


def test_a_live_table_without_its_package_names_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "rich.py").write_text("raise ImportError('not here')", encoding="utf-8")
    terminal, terminal_of_the_monitor = pty.openpty()
    try:
        result = subprocess.run(
            [sys.executable, "-m", "companion", "monitor", "--tui"],
            stdout=terminal_of_the_monitor,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TERM": "xterm", "PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"},
            timeout=30,
            check=False,
        )
    finally:
        os.close(terminal)
        os.close(terminal_of_the_monitor)
    assert result.returncode == 2
    assert "[ground]'" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_closed_pipe_is_no_error(files: AgentFiles) -> None:
    monitor = subprocess.Popen(
        [sys.executable, "-m", "companion", "monitor", "--tui", "--connect", files.zenoh],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert monitor.stdout
    assert monitor.stderr
    assert monitor.stdout.readline() == "no vehicle has reported yet\n"
    monitor.stdout.close()
    assert monitor.wait(20.0) == 141
    assert monitor.stderr.read() == ""
    monitor.stderr.close()
