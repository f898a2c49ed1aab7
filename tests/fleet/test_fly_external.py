"""`sitl fly --external`: only agents, for autopilots that the test has started, one of each make."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from common import until
from companion.mavlink.codec import MavlinkCodec, mavlink
from processes import free_fleet_offset
from sitl.links.ports import ports_of
from sitl.report.metrics import read_track
from sitl.report.summary import RunSummary, read_summary

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(300)]

SCENARIO = """\
fleet:
  name: pair
  origin: {latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}
  altitude_source: takeoff
  vehicles:
    - {id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}
    - {id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0]}
  neighbours: {kind: edges, edges: [[1, 2]]}
  takeoff_height_m: 2.0
starts_enu_m: {1: [0.0, 0.0, 0.0], 2: [-3.0, 0.0, 0.0]}
reference: {kind: point, point_enu_m: [1.0, 0.0, 2.0]}
timeline:
  - {command: prepare}
  - {command: arm}
  - {command: takeoff}
  - {command: form, for_s: 12.0}
  - {command: land}
"""
AUTOPILOT = """\
id: {id}
start_enu_m: [{x}, 0.0, 0.0]
stand_in: {{autopilot: {kind}, armable_after_s: 2, parameters: {{{parameters}}}}}
"""


@pytest.fixture
def offset() -> int:
    return free_fleet_offset()


@pytest.fixture
def autopilots(tmp_path: Path, offset: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    with running_autopilots(tmp_path, offset) as started:
        yield started


@contextmanager
def running_autopilots(folder: Path, offset: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Vehicle 1 behaves like PX4, vehicle 2 like ArduCopter. They run until the test ends them."""
    of_one, of_two = ports_of(1, offset), ports_of(2, offset)
    (folder / "pair.yaml").write_text(SCENARIO, encoding="utf-8")
    (folder / "external.yaml").write_text(
        "external_vehicles:\n"
        f"  - {{id: 1, mavlink: udpin:127.0.0.1:{of_one.companion}, autopilot: px4, hover_thrust_norm: 0.49}}\n"
        f"  - {{id: 2, mavlink: tcp:127.0.0.1:{of_two.tcp}, autopilot: ardupilot, hover_thrust_norm: 0.365}}\n",
        encoding="utf-8",
    )
    started = []
    for vehicle_id, x, kind, parameters in (
        (1, 0.0, "px4", "COM_OBL_RC_ACT: 5"),
        (2, -3.0, "ardupilot", "GUID_OPTIONS: 8"),
    ):
        file = folder / f"own_{vehicle_id}.yaml"
        file.write_text(AUTOPILOT.format(id=vehicle_id, x=x, kind=kind, parameters=parameters), encoding="utf-8")
        command = [sys.executable, "-m", "sitl", "autopilot", "--config", str(file), "--port-offset", str(offset)]
        truth = ["--truth", str(folder / f"true_{vehicle_id}.csv")]
        with (folder / f"own_{vehicle_id}.log").open("wb") as log:
            started.append(subprocess.Popen([*command, *truth], stdout=log))
    try:
        until(lambda: all((folder / f"own_{i}.log").stat().st_size for i in (1, 2)))  # they have their ports
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


def fly(folder: Path, offset: int, *more: str) -> subprocess.Popen[str]:
    files = [str(folder / "pair.yaml"), "--external", str(folder / "external.yaml"), "--out", str(folder / "out")]
    return subprocess.Popen(
        [sys.executable, "-m", "sitl", "fly", *files, "--port-offset", str(offset), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    printed, _ = process.communicate(timeout=240)
    return process.returncode, printed


def summary_of(folder: Path) -> RunSummary:
    return read_summary(folder / "out" / "summary.json")


def all_are_running(autopilots: list[subprocess.Popen[bytes]]) -> bool:
    return all(process.poll() is None for process in autopilots)


def wait_for_formation(folder: Path, flight: subprocess.Popen[str]) -> None:
    """Both vehicles are in formation."""
    logs, deadline_s = [folder / "out" / f"agent_{i}.log" for i in (1, 2)], time.monotonic() + 120.0
    while not all(log.exists() and "engage -> formation" in log.read_text(encoding="utf-8") for log in logs):
        assert time.monotonic() < deadline_s and flight.poll() is None
        time.sleep(0.1)


def agents(folder: Path, vehicle_id: int) -> list[int]:
    """Process ids of the agent of a vehicle."""
    file, found = str(folder / "out" / f"vehicle_{vehicle_id}.yaml").encode(), []
    for process in Path("/proc").iterdir():
        try:
            command = (process / "cmdline").read_bytes().split(b"\0") if process.name.isdecimal() else []
        except OSError:  # ended meanwhile
            continue
        if file in command:
            found.append(int(process.name))
    return found


def armed(folder: Path) -> list[int]:
    """Ids of the armed vehicles by the truth files of their stand-ins, which lag a second behind."""
    time.sleep(2.0)
    rows = {i: (folder / f"true_{i}.csv").read_text(encoding="ascii").splitlines()[-2] for i in (1, 2)}
    return [vehicle_id for vehicle_id, row in rows.items() if row.split(",")[-2] == "1"]


def test_a_mixed_pair_flies_and_its_autopilots_keep_running(
    tmp_path: Path, offset: int, autopilots: list[subprocess.Popen[bytes]]
) -> None:
    code, printed = ended(fly(tmp_path, offset))
    assert code == 0, printed
    assert "waiting for the vehicles to be ready" in printed
    summary = summary_of(tmp_path)
    assert (summary.tracks, summary.failure) == ("estimated", None)
    assert summary.final_error_m is not None and summary.final_error_m < 0.3
    assert all_are_running(autopilots)
    assert armed(tmp_path) == []
    for vehicle_id in (1, 2):  # the reported track is the true one but for estimation error and the altitude's zero
        reported, true = (
            read_track(tmp_path / "out" / f"estimated_{vehicle_id}.csv"),
            read_track(tmp_path / f"true_{vehicle_id}.csv"),
        )
        times_s = np.linspace(reported.time_s[0], reported.time_s[-1], 100)
        assert np.abs((reported.at(times_s) - true.at(times_s))[:, :2]).max() < 0.5
    assert not list((tmp_path / "out").glob("truth_*")) and not list((tmp_path / "out").glob("autopilot*"))


@pytest.mark.long
def test_ctrl_c_in_formation_lands_both_and_keeps_their_autopilots(
    tmp_path: Path, offset: int, autopilots: list[subprocess.Popen[bytes]]
) -> None:
    flight = fly(tmp_path, offset, "--set", "timeline[3].for_s=120", "--quiet")
    wait_for_formation(tmp_path, flight)
    flight.send_signal(signal.SIGINT)
    code, printed = ended(flight)
    assert code == 130, printed
    assert "interrupted by SIGINT" in printed
    assert armed(tmp_path) == []
    assert all_are_running(autopilots)


@pytest.mark.long
def test_a_vehicle_that_loses_its_agent_in_formation_is_reported_as_left_armed(
    tmp_path: Path, offset: int, autopilots: list[subprocess.Popen[bytes]]
) -> None:
    flight = fly(tmp_path, offset, "--set", "timeline[3].for_s=120", "--quiet")
    wait_for_formation(tmp_path, flight)
    (agent,) = agents(tmp_path, 2)
    os.kill(agent, signal.SIGKILL)
    code, printed = ended(flight)
    assert code == 1
    assert "vehicle 2 left armed, without an agent that could land it" in printed
    assert armed(tmp_path) == [2]
    assert all_are_running(autopilots)


@pytest.mark.long
def test_a_vehicle_taken_over_by_a_pilot_in_formation_is_left_to_the_pilot(
    tmp_path: Path, offset: int, autopilots: list[subprocess.Popen[bytes]]
) -> None:
    flight = fly(tmp_path, offset, "--set", "timeline[3].for_s=120", "--quiet")
    wait_for_formation(tmp_path, flight)
    hold = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 4, 3, 0, 0, 0, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground_station:
        ground_station.sendto(MavlinkCodec(255, 190).encode(hold), ("127.0.0.1", ports_of(1, offset).ground_link))
        code, printed = ended(flight)
    assert code == 1
    assert "mode AUTO.LOITER was not set by this agent" in printed
    assert "vehicle 1 left in the air: another operator or the autopilot set its mode" in printed
    assert armed(tmp_path) == [1]
    assert all_are_running(autopilots)


def test_a_missing_or_wrong_autopilot_is_named_and_nothing_flies(tmp_path: Path) -> None:
    """Both fleets at the same time: their agents wait ten seconds for the autopilot."""
    cases = {
        "another make": ("autopilot: px4", "autopilot: ardupilot", "ArduCopter"),
        "no autopilot": (
            "{id: 2, ",
            "{id: 2, hover_thrust_norm: 0.365, mavlink: tcp:127.0.0.1:9, autopilot: ardupilot} #",
            "127.0.0.1:9",
        ),
    }
    with ExitStack() as stack:
        started = {}
        for case, (right, wrong, _) in cases.items():
            folder, offset = tmp_path / case, free_fleet_offset()
            folder.mkdir()
            autopilots = stack.enter_context(running_autopilots(folder, offset))
            file = folder / "external.yaml"
            file.write_text(file.read_text(encoding="utf-8").replace(right, wrong), encoding="utf-8")
            started[case] = folder, autopilots, fly(folder, offset, "--quiet")
        for case, (folder, autopilots, flight) in started.items():
            code, printed = ended(flight)
            assert code == 1, (case, printed)
            assert cases[case][2] in summary_of(folder).failure, case  # type: ignore[operator]
            assert "ended with exit code" in printed
            assert all_are_running(autopilots)
            assert armed(folder) == []
