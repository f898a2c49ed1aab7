"""`companion mocap run` as a process between NatNet bytes and the network of the fleet, and how it ends."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from math import dist
from pathlib import Path

import pytest
import yaml

from camera_server import PLACES, serving
from companion.geometry.frames import euler_from_quaternion
from companion.link.fleet.zenoh_session import open_session
from companion.wire.keys import pose_key
from companion.wire.messages import decode_pose
from processes import free_port

FLEET = """
name: lab
origin: indoor
vehicles:
  - {id: 1, role: leader, slot_enu_m: [0, 0, 0]}
  - {id: 2, role: follower, slot_enu_m: [-2, 0, 0]}
neighbours: {kind: edges, edges: [[1, 2]]}
"""
ENDS_WITHIN_S = 60.0
needs_natnet = pytest.mark.skipif(not find_spec("natnet"), reason="the package natnet is not installed")


def mocap_file(folder: Path, port: int) -> Path:
    (folder / "fleet.yaml").write_text(FLEET, encoding="utf-8")
    content = {"fleet": "fleet.yaml", "system": "natnet", "host": "127.0.0.1", "port": port, "up": "y", "forward": "-z"}
    file = folder / "lab.yaml"
    file.write_text(yaml.safe_dump({**content, "bodies": {"vehicle_1": 1, "vehicle_2": 2}}), encoding="utf-8")
    return file


def started(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "companion", "mocap", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@needs_natnet
def test_poses_reach_the_keys_of_their_vehicles_and_sigterm_ends_it(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    with serving("y", "-z") as cameras, open_session(listen=(endpoint,), connect=()) as session:
        received = {i: session.declare_subscriber(pose_key("lab", "main", i)) for i in PLACES}
        program = started("run", str(mocap_file(tmp_path, cameras.port)), "--connect", endpoint)
        try:
            deadline_s = time.monotonic() + ENDS_WITHIN_S
            poses = {}
            while len(poses) < len(PLACES):
                assert time.monotonic() < deadline_s, program.poll()
                samples = {i: subscriber.try_recv() for i, subscriber in received.items()}
                poses |= {i: decode_pose(sample.payload.to_bytes()) for i, sample in samples.items() if sample}
                time.sleep(0.01)
            time.sleep(1.5)  # a summary
        finally:
            program.send_signal(signal.SIGTERM)
            said, errors = program.communicate(timeout=ENDS_WITHIN_S)
    for vehicle_id, (position_enu_m, quaternion) in PLACES.items():
        pose = poses[vehicle_id]
        assert dist(pose.position_enu_m, position_enu_m) < 0.02
        assert euler_from_quaternion(pose.quaternion) == pytest.approx(euler_from_quaternion(quaternion), abs=0.03)
        assert 0.0 < pose.age_s < 1.0
    assert "2 of 2 bodies tracked" in said
    assert (errors, program.returncode) == ("", 0)


@needs_natnet
def test_the_guided_check_asks_for_the_first_motion(tmp_path: Path) -> None:
    with serving("y", "-z") as cameras:
        program = started("check", str(mocap_file(tmp_path, cameras.port)))
        assert program.stdout
        asked = program.stdout.readline()
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=ENDS_WITHIN_S)
    assert asked.startswith("vehicle_1: put its nose to the east, then move it")
    assert (errors, program.returncode) == ("interrupted\n", 130)


def test_a_missing_library_is_one_line_with_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from companion.cli.main import main

    monkeypatch.setattr("companion.ground.mocap.systems.find_spec", lambda _name: None)
    assert main(["mocap", "run", str(mocap_file(tmp_path, 1510))]) == 2
    line = capsys.readouterr().err
    assert line.startswith("natnet is not installed; ")
    assert line.endswith("[mocap]'\n")
