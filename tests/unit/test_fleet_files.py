"""The files that a flight's processes are given, and what is asked of ports and of a bound process."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest

from companion.config.vehicle import load_agent
from companion.config_file import ConfigError, load
from companion.types import AutopilotKind, Role
from sitl.config import AutopilotFile
from sitl.fleet import Child, Fleet, autopilot_file, reached_stand_in, vehicle_file, write_files
from sitl.free_ports import PortInUseError, check_ports
from sitl.ports import ports_of
from sitl.scenario import Scenario, load_scenario

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    scenario = load_scenario(PLATOON, ["stand_in.sensors=default", "stand_in.airframe.hover_thrust_norm=0.4"])
    write_files(scenario, tmp_path, 50)
    return scenario


def test_every_agent_s_file_is_one_that_an_agent_takes(scenario: Scenario, tmp_path: Path) -> None:
    configs = [load_agent(tmp_path / f"vehicle_{vehicle_id}.yaml") for vehicle_id in (1, 2, 3, 4)]
    assert [config.fleet for config in configs] == [scenario.fleet] * 4
    assert len({config.fleet.formation_hash() for config in configs}) == 1
    assert all(config.vehicle.hover_thrust_norm == 0.4 for config in configs)


def test_the_reference_is_the_leader_s_alone(scenario: Scenario, tmp_path: Path) -> None:
    for vehicle_id in (1, 2, 3, 4):
        config = load_agent(tmp_path / f"vehicle_{vehicle_id}.yaml")
        leads = config.member.role is Role.LEADER
        assert config.vehicle.reference == (scenario.reference if leads else None)


def test_any_two_agents_are_connected_by_one_of_them(scenario: Scenario, tmp_path: Path) -> None:
    zenoh = {i: load_agent(tmp_path / f"vehicle_{i}.yaml").vehicle.zenoh for i in scenario.starts_enu_m}
    for i, own in zenoh.items():
        assert own.listen == (f"tcp/127.0.0.1:{ports_of(i, 50).zenoh}",)
        for j, other in zenoh.items():
            if i < j:
                assert (own.listen[0] in other.connect) != (other.listen[0] in own.connect)


def test_a_stand_in_stands_where_the_scenario_says(scenario: Scenario, tmp_path: Path) -> None:
    for vehicle_id, start_enu_m in scenario.starts_enu_m.items():
        file = load(tmp_path / f"autopilot_{vehicle_id}.yaml", AutopilotFile)
        assert (file.id, file.start_enu_m) == (vehicle_id, start_enu_m)
        assert file.stand_in == msgspec.structs.replace(scenario.stand_in, armable_after_s=4.0)
        assert file.world_origin == scenario.fleet.origin


def test_free_ports_are_free_and_stay_so() -> None:
    check_ports([1, 2], AutopilotKind.PX4, 2300)
    check_ports([1, 2], AutopilotKind.PX4, 2300)


def test_a_port_of_another_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", ports_of(2, 2300).companion))
        with pytest.raises(PortInUseError, match=r"^UDP port 16841, wanted by agent 2 .* --port-offset 2400$"):
            check_ports([1, 2], AutopilotKind.PX4, 2300)


@pytest.mark.parametrize(
    ("ids", "offset", "message"),
    [
        ([11], 0, r"^port 14550 is wanted by agent 11 towards its autopilot and by a ground station; .* 100,"),
        ([1], 10, r"^port 14550 is wanted by agent 1 towards its autopilot and by a ground station; .* 110,"),
        (
            [1, 41],
            2300,
            r"^port 16880 is wanted by agent 41 towards its autopilot and by autopilot 1 towards its agent;",
        ),
    ],
)
def test_a_port_that_two_want_is_refused_in_one_line(ids: list[int], offset: int, message: str) -> None:
    with pytest.raises(PortInUseError, match=message) as caught:
        check_ports(ids, AutopilotKind.PX4, offset)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- processes


def child(tmp_path: Path, name: str, code: str) -> Child:
    log = tmp_path / f"{name}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "sitl.bound", str(os.getpid()), sys.executable, "-c", code],
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    return Child(name, int(name.split()[-1]), log, process)


SLEEP = "import time; print('here', flush=True); time.sleep(60)"
DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('here', flush=True); time.sleep(60)"


def until_it_runs(*children: Child) -> None:
    deadline_s = time.monotonic() + 10.0
    while any(child.last_words() != "here" for child in children):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_an_unexpected_end_is_told_once_with_its_last_words(tmp_path: Path) -> None:
    ends = child(tmp_path, "agent 2", "import sys; print('a reason'); print(); sys.exit(3)")
    runs = child(tmp_path, "agent 1", SLEEP)
    with Fleet([ends, runs]) as fleet:
        ends.process.wait()
        until_it_runs(runs)
        assert fleet.unexpected_end() == "agent 2 ended with exit code 3: a reason"
        assert fleet.unexpected_end() is None
        assert fleet.lost_vehicles() == {2}
        assert fleet.stop() == []
    assert runs.process.returncode == -signal.SIGTERM


def test_what_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.fleet.STAND_IN_ENDS_WITHIN_S", 0.3)
    deaf = child(tmp_path, "autopilot 1", DEAF)
    until_it_runs(deaf)
    with Fleet([deaf]) as fleet:
        assert fleet.stop() == ["autopilot 1"]
    assert deaf.process.returncode == -signal.SIGKILL


def test_leaving_the_block_leaves_nothing(tmp_path: Path) -> None:
    runs = child(tmp_path, "agent 1", SLEEP)
    until_it_runs(runs)
    with pytest.raises(KeyboardInterrupt), Fleet([runs]):
        raise KeyboardInterrupt
    assert runs.process.returncode == -signal.SIGKILL


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process of its parent's end")
def test_a_bound_command_ends_with_its_parent() -> None:
    parent_code = (
        "import os, subprocess, sys, time\n"
        f"child = subprocess.Popen([sys.executable, '-m', 'sitl.bound', str(os.getpid()), sys.executable, '-c', {SLEEP!r}])\n"
        "print(child.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent_code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child_pid = int(parent.stdout.readline())
        assert parent.stdout.readline() == "here\n"
        parent.kill()
    deadline_s = time.monotonic() + 5.0
    while Path(f"/proc/{child_pid}").exists() and "Z" not in Path(f"/proc/{child_pid}/stat").read_text().split()[2]:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_a_bound_command_without_its_parent_does_not_start() -> None:
    done = subprocess.run([sys.executable, "-m", "sitl.bound", "1", "touch", "/never"], timeout=10, check=False)
    assert done.returncode == 1


def test_a_bound_command_that_does_not_exist_says_so() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sitl.bound", str(os.getpid()), "no-such-command"],
        capture_output=True,
        text=True,
        timeout=10,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr == "no-such-command: No such file or directory\n"


def test_arducopters_listen_on_tcp_take_thrust_as_thrust_and_let_nobody_wait() -> None:
    scenario = load_scenario(PLATOON, ["stand_in.autopilot=ardupilot"])
    file = vehicle_file(scenario, reached_stand_in(scenario, 2, 100), 100)
    assert (file.mavlink, file.hover_thrust_norm) == ("tcp:127.0.0.1:5870", 0.365)
    stand_in = autopilot_file(scenario, 2).stand_in
    assert (stand_in.ready_after_s, stand_in.parameters) == (4.0, {"GUID_OPTIONS": 8.0})
    said = load_scenario(
        PLATOON,
        ["stand_in.autopilot=ardupilot", "stand_in.armable_after_s=42", "stand_in.parameters={GUID_OPTIONS: 0}"],
    )
    assert (said.stand_in.ready_after_s, autopilot_file(said, 1).stand_in.parameters) == (42.0, {"GUID_OPTIONS": 0.0})


def test_the_tcp_port_of_an_arducopter_is_tried_as_well() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as other:
        other.bind(("127.0.0.1", ports_of(2, 2300).tcp))
        other.listen()
        with pytest.raises(PortInUseError, match=r"^TCP port 8070, wanted by autopilot 2"):
            check_ports([1, 2], AutopilotKind.ARDUPILOT, 2300)
        check_ports([1, 2], AutopilotKind.PX4, 2300)


def test_parameters_are_those_of_the_autopilot() -> None:
    load_scenario(PLATOON, ["stand_in.autopilot=ardupilot", "stand_in.parameters={FS_GCS_ENABLE: 1}"])
    with pytest.raises(ConfigError, match="GUID_TIMEOUT"):
        load_scenario(PLATOON, ["stand_in.autopilot=ardupilot", "stand_in.parameters={GUID_TIMEOUTS: 1}"])
    with pytest.raises(ConfigError, match="px4"):
        load_scenario(PLATOON, ["stand_in.parameters={FS_GCS_ENABLE: 1}"])
