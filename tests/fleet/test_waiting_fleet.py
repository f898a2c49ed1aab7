"""`sitl fleet`: real processes on the ground, an operator who flies them, and Ctrl-C, which lands them."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from common import ROOT
from processes import free_fleet_offset

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"


def companion(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """`companion fleet` with its fleet file from the environment, which has the addresses."""
    fleet = {"COMPANION_FLEET": str(folder / "fleet.yaml")}
    command = [sys.executable, "-m", "companion", "fleet", *arguments, "--wait-s", "10"]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=False, env={**os.environ, **fleet})


def phases(folder: Path) -> set[str]:
    report = json.loads(companion("status", "--json", folder=folder).stdout)
    return {vehicle["phase"] for vehicle in report["vehicles"]}


def test_ctrl_c_lands_a_fleet_that_an_operator_flies(tmp_path: Path) -> None:
    port_offset = free_fleet_offset()
    command = [sys.executable, "-m", "sitl", "fleet", str(PLATOON), "--out", str(tmp_path), "--quiet"]
    fleet = subprocess.Popen([*command, "--port-offset", str(port_offset)], stdout=subprocess.PIPE, text=True)
    try:
        assert fleet.stdout is not None
        assert fleet.stdout.readline().startswith("fleet platoon, vehicles 1, 2, 3, 4. In a second terminal")
        end_s = time.monotonic() + 60.0
        while companion("doctor", folder=tmp_path).returncode != 0:
            assert time.monotonic() < end_s
        for action, phase in (("arm", "armed"), ("takeoff", "hold"), ("form", "formation")):
            done = companion(action, folder=tmp_path)
            assert done.returncode == 0, done.stdout + done.stderr
            assert f"fleet file {tmp_path / 'fleet.yaml'} (COMPANION_FLEET)" in done.stderr
            assert phases(tmp_path) == {phase}  # the command has waited for it
        fleet.send_signal(signal.SIGINT)
        output, _ = fleet.communicate(timeout=60.0)
    finally:
        fleet.kill()
    assert fleet.returncode == 0, output
    assert output.splitlines()[-1] == f"all landed; files and logs in {tmp_path}"
    heights_m = [float((tmp_path / f"truth_{i}.csv").read_text().splitlines()[-1].split(",")[3]) for i in (1, 2, 3, 4)]
    assert max(map(abs, heights_m)) < 0.1
