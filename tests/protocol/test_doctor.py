"""`companion doctor` against a real stand-in process: real sockets, mavsdk's parameters, one line for each finding."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

from agent_process import AgentFiles, agent_files, companion, until
from hovering_autopilot import HoveringAutopilot
from stand_in_process import StandInProcess, stand_in

IN_ORDER = {"COM_OBL_RC_ACT": 5, "COM_RC_OVERRIDE": 3, "GF_MAX_HOR_DIST": 90.0, "GF_MAX_VER_DIST": 40.0}


ARMABLE_S = 4.0  # after its start its checks pass


@contextmanager
def patient(folder: Path, **parameters: float) -> Iterator[tuple[StandInProcess, AgentFiles]]:
    """A stand-in that is in order but for these parameters, and vehicle 1's files for it."""
    configuration = {"id": 1, "stand_in": {"parameters": IN_ORDER | parameters}}
    with stand_in(folder, json.dumps(configuration)) as process:
        until(lambda: len(process.truth()) > ARMABLE_S * 50)
        yield process, agent_files(folder, f"udpin:127.0.0.1:{process.ports.companion}")


def doctor(files: AgentFiles, *options: str) -> CompletedProcess[str]:
    return companion("doctor", "--config", str(files.file), *options, timeout_s=60.0)


def found(result: CompletedProcess[str]) -> dict[str, str]:
    """Verdicts by subject, from the lines as printed; of those after --fix where there are two."""
    words = [line.split() for line in result.stdout.splitlines()]
    return {w[1]: w[0] for w in words if w and w[0] in ("ok", "warning", "REFUSAL")}


def diagnosis(result: CompletedProcess[str]) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(result.stdout)
    return told


def test_a_vehicle_in_order_is_fit(tmp_path: Path) -> None:
    with patient(tmp_path) as (process, files):
        result = doctor(files)
    assert result.returncode == 0, result.stdout + result.stderr
    assert set(found(result).values()) == {"ok"}
    assert {"positions", "attitudes", "modes", "origin", "battery", "mode", "COM_OF_LOSS_T", "MPC_THR_HOVER"} <= set(
        found(result)
    )
    assert result.stdout.startswith(f"vehicle 1, PX4 at udpin:127.0.0.1:{process.ports.companion}\n")
    assert result.stdout.endswith("fit to fly in formation: 0 refusals, 0 warnings\n")
    assert result.stderr == ""


def test_bad_parameters_are_refused_in_words_and_fixed(tmp_path: Path) -> None:
    with patient(tmp_path, COM_OF_LOSS_T=30.0, COM_OBL_RC_ACT=7, COM_RC_OVERRIDE=1, GF_MAX_VER_DIST=0.0) as (
        _process,
        files,
    ):
        first = doctor(files)
        assert first.returncode == 1
        assert found(first)["COM_OF_LOSS_T"] == "REFUSAL"
        assert "30 s (so long it flies its last setpoint on)" in first.stdout
        assert "set COM_OF_LOSS_T to 1" in first.stdout
        assert "--fix would set COM_OF_LOSS_T to 1, COM_OBL_RC_ACT to 5, COM_RC_OVERRIDE to 3" in first.stdout

        fixed = doctor(files, "--fix")
        assert fixed.returncode == 0, fixed.stdout
        assert "COM_OF_LOSS_T: 30 s (so long it flies its last setpoint on) -> 1: set, and read again" in fixed.stdout
        shown, _, left = fixed.stdout.partition("COM_RC_OVERRIDE: 1")  # all is shown before anything is set
        assert "REFUSAL  COM_OF_LOSS_T" in shown
        assert "REFUSAL" not in left
        assert found(fixed)["GF_MAX_VER_DIST"] == "warning"  # where a fence belongs is not the doctor's to say

        after = diagnosis(doctor(files, "--json"))
        values = {finding["subject"]: finding["found"] for finding in after["findings"]}
        assert values["COM_OBL_RC_ACT"] == "5 (hold)"
        assert values["COM_RC_OVERRIDE"].startswith("3 ")
        assert after["verdict"] == "warning"
        assert after["changes"] == []


def test_nothing_is_set_while_armed_and_what_is_not_there_is_not_found(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with HoveringAutopilot(1, files.udp_port, parameters={}) as autopilot:  # armed, and deaf to parameters
        result = doctor(files, "--fix", "--json")
    told = diagnosis(result)
    subjects = {finding["subject"]: finding for finding in told["findings"]}
    assert subjects["mode"]["verdict"] == "warning"
    assert subjects["COM_OF_LOSS_T"] == {
        "subject": "COM_OF_LOSS_T",
        "verdict": "warning",
        "found": "not found",
        "wanted": "0.6 to 2 s",
        "remedy": "older firmware, or a link that loses much",
        "fix": None,
    }
    assert told["changes"] == []
    assert "PARAM_SET" not in {m.get_type() for m in autopilot.received}
    beats = [m for m in autopilot.received if m.get_type() == "HEARTBEAT"]
    assert 6 not in {m.type for m in beats}  # no ground station was invented
    assert result.returncode == 0


def test_no_autopilot(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    result = doctor(files, "--wait-s", "1")
    assert result.returncode == 3
    assert "no HEARTBEAT of system 1 in 1 s; nothing came at all" in result.stderr
    assert result.stdout == ""


def test_another_vehicles_autopilot(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with HoveringAutopilot(9, files.udp_port):
        result = doctor(files, "--wait-s", "2")
    assert result.returncode == 3
    assert "heard system 9 instead" in result.stderr


def test_a_link_in_use(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as agent:
        agent.bind(("127.0.0.1", files.udp_port))
        result = doctor(files)
    assert result.returncode == 2
    assert "is in use; stop what has it (another agent or ground station?)" in result.stderr


def test_a_file_that_cannot_be_used(tmp_path: Path) -> None:
    result = companion("doctor", "--config", str(tmp_path / "none.yaml"))
    assert result.returncode == 2
    assert "none.yaml" in result.stderr


def test_the_autopilots_own_checks(tmp_path: Path) -> None:
    with patient(tmp_path, NAV_DLL_ACT=2) as (_process, files):  # it lets nobody arm it without a ground station
        result = doctor(files)
    assert result.returncode == 1
    assert "REFUSAL  estimator and checks  its checks before arming do not pass" in result.stdout
    assert found(result)["NAV_DLL_ACT"] == "warning"


def test_a_stock_arducopter_is_refused_and_fixed(tmp_path: Path) -> None:
    with stand_in(tmp_path, "id: 1\n", "--autopilot", "ardupilot") as process:
        files = agent_files(tmp_path, f"udpin:127.0.0.1:{process.ports.companion}")
        fixed = doctor(files, "--fix")
    assert fixed.stdout.startswith("vehicle 1, ArduCopter at ")
    assert "REFUSAL  GUID_OPTIONS" in fixed.stdout
    assert "GUID_OPTIONS: 0 (thrust would be taken as a climb rate) -> 8: set, and read again" in fixed.stdout
    assert {found(fixed)[name] for name in ("GUID_OPTIONS", "GUID_TIMEOUT", "ATC_ANGLE_BOOST")} == {"ok"}
