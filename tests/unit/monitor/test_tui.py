"""The picture on a real pseudo-terminal, on a terminal without a cursor or a pipe, and once as JSON."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys

import pytest
from rich.console import Console

from companion.monitor.tui import json_once
from ground_fleet import NOW, leader, picture_of, reported
from tests.bench.monitor_load import steady_fleet

TO_SECOND_SCREEN, BACK, SHOW_CURSOR = b"\x1b[?1049h", b"\x1b[?1049l", b"\x1b[?25h"
# On a closed port: no vehicle is there, and none is needed.
PROGRAM = """
import sys
from companion.monitor.tui import run_monitor
sys.exit(run_monitor("*", ["tcp/127.0.0.1:1"], None, once=False, as_json=False))
"""


def until(master: int, awaited: bytes, seen: bytes = b"") -> bytes:
    while awaited not in seen:
        try:
            read = os.read(master, 65536)
        except OSError:  # Linux: the other end is closed
            break
        seen += read
    return seen


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_end_leaves_the_terminal_as_it_was(number: signal.Signals) -> None:
    master, slave = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color"}
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=slave, stdout=slave, stderr=slave, env=environment
    ) as process:
        os.close(slave)
        seen = until(master, b"no report yet from tcp/127.0.0.1:1")
        assert TO_SECOND_SCREEN in seen
        process.send_signal(number)
        seen = until(master, b"never printed", seen)
        assert process.wait() == 0
    os.close(master)
    assert seen.rfind(BACK) > seen.rfind(TO_SECOND_SCREEN)
    assert seen.rfind(SHOW_CURSOR) > seen.rfind(b"\x1b[?25l")
    assert b"Traceback" not in seen


def test_the_picture_has_its_time_and_the_endpoints_that_are_not_reached() -> None:
    from companion.monitor.tui import top_lines

    assert [line.text for line in top_lines("12:00:01", (), 80)] == ["12:00:01"]
    lines = top_lines("12:00:01", ["tcp/10.0.0.2:7447: connection refused; no agent listens there"], 40)
    assert lines[1].text == "not reached: tcp/10.0.0.2:7447: connect…"


@pytest.mark.parametrize("term", ["dumb", ""])
def test_a_terminal_without_a_cursor_gets_lines(term: str) -> None:
    master, slave = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=slave, stdout=slave, stderr=slave, env=os.environ | {"TERM": term}
    ) as process:
        os.close(slave)
        seen = until(master, b"no vehicle has reported yet")
        process.send_signal(signal.SIGINT)
        seen = until(master, b"never printed", seen)
        assert process.wait() == 0
    os.close(master)
    assert b"\x1b" not in seen


def test_without_colour_the_text_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    from companion.monitor.tui import as_text
    from companion.monitor.tui_page import page
    from ground_fleet import troubled_fleet

    lines = page(troubled_fleet(), 80)
    monkeypatch.setenv("NO_COLOR", "1")
    console = Console(force_terminal=True, width=80, color_system="truecolor")
    with console.capture() as printed:
        console.print(as_text(lines))
    assert "\x1b[33m" not in printed.get()
    assert "\x1b[31m" not in printed.get()
    for line in lines:
        assert line.text in printed.get()


# ---------------------------------------------------------------- once, as JSON


def test_a_vehicle_that_never_reported_is_named_beside_the_array(capsys: pytest.CaptureFixture[str]) -> None:
    json_once(picture_of(leader(), reported(2), fleets={"platoon": steady_fleet("platoon", 3).fleet}), NOW)
    shown = capsys.readouterr()
    assert [row["vehicle_id"] for row in json.loads(shown.out)] == [1, 2]
    assert shown.err == "companion monitor: fleet platoon: NEVER HEARD: vehicle 3 of its fleet file\n"


def test_a_whole_fleet_has_the_array_alone(capsys: pytest.CaptureFixture[str]) -> None:
    json_once(picture_of(leader(), reported(2), fleets={"platoon": steady_fleet("platoon", 2).fleet}), NOW)
    assert capsys.readouterr().err == ""
