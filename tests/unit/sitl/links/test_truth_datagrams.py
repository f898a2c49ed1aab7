"""A stand-in in a process of its own sends its true pose to the cameras."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from math import dist
from pathlib import Path

from processes import free_vehicle_offset
from sitl.links.cameras import TRUTH

START_ENU_M = (3.0, -4.0, 0.0)


def test_a_stand_in_sends_its_true_pose(tmp_path: Path) -> None:
    file = tmp_path / "autopilot.yaml"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as cameras:
        cameras.bind(("127.0.0.1", 0))
        cameras.settimeout(60.0)
        port = cameras.getsockname()[1]
        file.write_text(f"{{id: 3, start_enu_m: {list(START_ENU_M)}, truth_port: {port}}}", encoding="utf-8")
        command = [sys.executable, "-m", "sitl", "autopilot", "--config", str(file)]
        program = subprocess.Popen([*command, "--port-offset", str(free_vehicle_offset())], stdout=subprocess.DEVNULL)
        try:
            datagrams = [TRUTH.unpack(cameras.recv(2048)) for _ in range(20)]
        finally:
            program.send_signal(signal.SIGTERM)
            program.wait(60.0)
    assert {one[0] for one in datagrams} == {3}
    assert dist(datagrams[-1][2:5], START_ENU_M) < 0.1
    times_s = [one[1] for one in datagrams]
    assert times_s == sorted(set(times_s))
