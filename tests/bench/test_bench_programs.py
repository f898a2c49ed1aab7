"""The programs that the bench starts: the C loop, the relay between autopilot and client, and the scenarios."""

from __future__ import annotations

import io
import shutil
import signal
import socket
import subprocess
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest

from companion.mavlink.codec import mavlink
from companion.mavlink.translator import Translator, pose_covariance
from companion.types.peers import BodyPose
from sitl.links.ports import LOOPBACK
from tests.bench import batch_models, scenarios
from tests.bench.programs import loops, pose_source, relay

pytestmark = pytest.mark.long


def encoded(*messages: mavlink.MAVLink_message) -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=1)
    return b"".join(message.pack(codec) for message in messages)


POSITION = mavlink.MAVLink_local_position_ned_message(0, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3)
TARGET = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3)


def test_all_messages_of_a_datagram_are_found() -> None:
    assert list(relay.message_ids(encoded(HEARTBEAT, POSITION, TARGET))) == [0, 32, 82]
    assert list(relay.message_ids(b"")) == []
    assert list(relay.message_ids(b"no MAVLink at all")) == []


def udp(stack: list[socket.socket]) -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.bind((LOOPBACK, 0))
    end.settimeout(5.0)
    stack.append(end)
    return end


def test_the_relay_notes_the_first_command_after_each_position() -> None:
    ends: list[socket.socket] = []
    autopilot, client, free = udp(ends), udp(ends), udp(ends)
    port = free.getsockname()[1]
    free.close()
    out = io.StringIO()
    wire = relay.Relay(port, client.getsockname()[1], out)
    threading.Thread(target=wire.run, daemon=True).start()
    for _ in range(2):
        autopilot.sendto(encoded(HEARTBEAT, POSITION), (LOOPBACK, port))
        _, address = client.recvfrom(1000)
        for message in (HEARTBEAT, TARGET, TARGET):
            client.sendto(encoded(message), address)
            assert autopilot.recv(1000) == encoded(message)
    lines = out.getvalue().splitlines()
    assert len(lines) == 2
    assert all(float(line.split()[1]) > 0.0 for line in lines)
    for end in ends:
        end.close()


def test_a_pose_is_known_by_its_north() -> None:
    out = io.StringIO()
    wire = pose_source.PoseRelay(200, 9_000, out)
    north_m = 1.23456789
    wire.put_ns[pose_source.FLOAT.pack(north_m)] = 1_000_000
    pose = BodyPose(7, 1, 0.0, (5.0, north_m, 1.0), (1.0, 0.0, 0.0, 0.0))
    packet = Translator(1).pose(pose, 0.0, pose_covariance(0.01, 0.01), 0)
    for data in (encoded(TARGET), packet, packet):  # each counts once
        wire.sent(data, 3_500_000)
    (line,) = out.getvalue().splitlines()
    assert line.split()[1] == "2500.0"


def test_incomplete_lines_are_left_out(tmp_path: Path) -> None:
    file = tmp_path / "relay.txt"
    file.write_text("1.500000 250.0\n2.5000", encoding="ascii")
    assert relay.commands_of(file) == [(1.5, 250.0)]
    file.write_text("1.50 1.51\n1.52", encoding="ascii")
    assert loops.cycles_of(file) == [loops.Cycle(1.50, 1.51)]
    assert loops.cycles_of(tmp_path / "none") == []


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_c_loop_wakes_on_its_grid_and_never_early(tmp_path: Path) -> None:
    program, out = loops.build_c_loop(tmp_path), tmp_path / "cycles.txt"
    assert program is not None
    process = subprocess.Popen([str(program), str(out)])
    while len(loops.cycles_of(out)) < 5:
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    process.wait()
    cycles = loops.cycles_of(out)
    assert all(cycle.woken_s >= cycle.due_s for cycle in cycles)
    steps_s = [b.due_s - a.due_s for a, b in pairwise(cycles)]
    assert steps_s == pytest.approx([0.02] * len(steps_s))


def test_without_a_compiler_there_is_no_c_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert loops.build_c_loop(tmp_path) is None


def test_scenarios_have_the_neighbours_that_they_name() -> None:
    line, grid, star = scenarios.line(4, 1.0), scenarios.grid(9, 1.0), scenarios.star(10, 1.0)
    assert line.fleet.neighbours.edges == ((1, 2), (2, 3), (3, 4))  # type: ignore[union-attr]
    assert len(grid.fleet.neighbours.edges) == 12  # type: ignore[union-attr]
    assert len(star.fleet.vehicles) == 11
    assert all(2 in edge for edge in star.fleet.neighbours.edges)  # type: ignore[union-attr]


def test_every_round_of_the_batch_benchmark_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_models, "ROUND_S", 0.001)
    rates = batch_models.rates_of_rounds_1_s({"one": lambda: None, "two": lambda: None})
    assert [len(rounds) for rounds in rates.values()] == [batch_models.ROUNDS, batch_models.ROUNDS]
