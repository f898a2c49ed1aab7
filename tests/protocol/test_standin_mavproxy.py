"""MAVProxy, without windows, flies a real stand-in process by typed commands."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import pytest

from common import until
from processes import StandInProcess, stand_in
from sitl.autopilots.px4.autopilot import Px4


@dataclass
class MavProxy:
    """A running MAVProxy; its output goes to `log_file`."""

    keyboard: IO[bytes]
    log_file: Path

    @property
    def log(self) -> str:
        return self.log_file.read_text(encoding="utf-8", errors="replace")

    def type(self, line: str) -> None:
        self.keyboard.write(line.encode() + b"\n")
        self.keyboard.flush()

    def wait_for(self, words: str, timeout_s: float = 30.0) -> None:
        until(lambda: words in self.log, timeout_s)

    def type_until(self, line: str, words: str) -> None:
        """Type a command again every two seconds, as a pilot does after a refusal."""
        for _ in range(10):
            self.type(line)
            try:
                self.wait_for(words, 2.0)
            except AssertionError:
                continue
            return
        pytest.fail(self.log)


@contextmanager
def mavproxy(folder: Path, process: StandInProcess) -> Iterator[MavProxy]:
    log_file = folder / "mavproxy.log"
    script = Path(sys.executable).with_name("mavproxy.py")
    command = [sys.executable, str(script), f"--master=udpin:127.0.0.1:{process.ports.companion}"]
    with log_file.open("wb") as log:
        running = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            cwd=folder,  # it writes its logs into its working folder
            env={**os.environ, "HOME": str(folder), "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )
    assert running.stdin
    try:
        yield MavProxy(running.stdin, log_file)
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        running.stdin.close()


def test_a_flight_by_typed_commands(tmp_path: Path) -> None:
    with stand_in(tmp_path) as process, mavproxy(tmp_path, process) as proxy:
        proxy.wait_for("Detected vehicle 1:1")
        proxy.wait_for("Mode LOITER")
        proxy.wait_for(f"Received {len(Px4.data.parameters)} parameters")
        assert "request timed out" not in proxy.log  # the stand-in refuses file requests at once

        proxy.type("param set MIS_TAKEOFF_ALT 1.5")
        proxy.type("param set COM_OBL_RC_ACT 5")
        proxy.type_until("param fetch MIS_TAKEOFF_ALT", "MIS_TAKEOFF_ALT = 1.5")
        proxy.type_until("param fetch COM_OBL_RC_ACT", "COM_OBL_RC_ACT = 5")

        # The command `mode NAME` is for ArduPilot and fails on the modes of PX4, which are triples.
        proxy.type("long DO_SET_MODE 1 4 2")
        proxy.wait_for("Mode TAKEOFF")
        proxy.type_until("arm throttle", "ARMED")
        proxy.wait_for("AP: Takeoff detected")
        process.wait_for_mode("LOITER")
        top_m = max(row.z_m for row in process.truth())
        proxy.type("long NAV_LAND 0 0 0 nan nan nan nan")
        proxy.wait_for("Mode LAND")
        proxy.wait_for("DISARMED")
        process.wait_until_disarmed()
        assert process.newest.z_m == 0.0
    assert top_m == pytest.approx(1.5, abs=0.3)
    assert not re.search(r"Traceback|ERROR in command", proxy.log)
    assert re.search(r"COMPONENT_ARM_DISARM: ACCEPTED", proxy.log)
