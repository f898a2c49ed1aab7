"""`sitl fleet`: real processes that stand and wait, an operator who flies them, and Ctrl-C that lands them all the same."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sitl.fleet import endpoint_of

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

PAIR = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
PORT_OFFSET = 2850


def companion(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    to_fleet = ["--fleet", str(folder / "fleet.yaml"), "--connect", endpoint_of(1, PORT_OFFSET), "--wait-s", "10"]
    command = [sys.executable, "-m", "companion", "fleet", *arguments, *to_fleet]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def until(folder: Path, phase: str, within_s: float = 60.0) -> None:
    end_s = time.monotonic() + within_s
    while True:
        told = json.loads(companion("status", "--json", folder=folder).stdout)
        if all(vehicle["phase"] == phase for vehicle in told["vehicles"]):
            return
        assert time.monotonic() < end_s, told
        time.sleep(0.5)


def test_an_operator_flies_it_and_ctrl_c_lands_it(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sitl", "fleet", str(PAIR), "--out", str(tmp_path), "--quiet"]
    fleet = subprocess.Popen([*command, "--port-offset", str(PORT_OFFSET)], stdout=subprocess.PIPE, text=True)
    try:
        assert fleet.stdout is not None
        assert fleet.stdout.readline().startswith("fleet platoon, vehicles 1, 2, 3, 4. In a second terminal")
        end_s = time.monotonic() + 60.0
        while companion("ready", folder=tmp_path).returncode != 0:
            assert time.monotonic() < end_s
        for action, phase in (("arm", "armed"), ("takeoff", "hold")):
            done = companion(action, folder=tmp_path)
            assert done.returncode == 0, done.stdout + done.stderr
            until(tmp_path, phase)
        fleet.send_signal(signal.SIGINT)
        said, _ = fleet.communicate(timeout=60.0)
    finally:
        fleet.kill()
    assert fleet.returncode == 0, said
    assert said.splitlines()[-1] == f"all landed; files and logs in {tmp_path}"
    heights_m = [float((tmp_path / f"truth_{i}.csv").read_text().splitlines()[-1].split(",")[3]) for i in (1, 2, 3, 4)]
    assert max(map(abs, heights_m)) < 0.1
