"""`companion doctor` against a real stand-in process: real sockets, parameters by mavsdk, one line for each finding."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

from common import until
from companion.types.notices import Code
from processes import AgentFiles, StandInProcess, agent_files, companion, stand_in
from wire_autopilots import IN_ORDER, HoveringAutopilot

CONFIGURED = {"COM_OBL_RC_ACT": 5, "COM_RC_OVERRIDE": 3, "GF_MAX_HOR_DIST": 200.0, "GF_MAX_VER_DIST": 60.0}


ARMABLE_S = 0.5  # its checks pass this long after its start


@contextmanager
def vehicle_with(folder: Path, **parameters: float) -> Iterator[tuple[StandInProcess, AgentFiles]]:
    """A correctly configured stand-in, except for these parameters, and the files of vehicle 1 for it."""
    configuration = {"id": 1, "stand_in": {"armable_after_s": ARMABLE_S, "parameters": CONFIGURED | parameters}}
    with stand_in(folder, json.dumps(configuration)) as process:
        until(lambda: len(process.truth()) > ARMABLE_S * 50)
        yield process, agent_files(folder, f"udpin:127.0.0.1:{process.ports.companion}")


def doctor(files: AgentFiles, *options: str) -> CompletedProcess[str]:
    return companion("doctor", "--config", str(files.file), *options, timeout_s=60.0)


def found(result: CompletedProcess[str]) -> dict[str, str]:
    """Verdicts by subject, from the printed lines; with --fix the later ones."""
    words = [line.split() for line in result.stdout.splitlines()]
    return {w[1]: w[0] for w in words if w and w[0] in ("ok", "warning", "REFUSAL")}


def diagnosis(result: CompletedProcess[str]) -> dict[str, Any]:
    printed: dict[str, Any] = json.loads(result.stdout)
    return printed


def test_a_correctly_configured_vehicle_is_fit(tmp_path: Path) -> None:
    with vehicle_with(tmp_path) as (process, files):
        result = doctor(files)
    assert result.returncode == 0, result.stdout + result.stderr
    assert set(found(result).values()) == {"ok"}
    assert {
        "positions",
        "attitudes",
        "modes",
        "round",
        "origin",
        "battery",
        "mode",
        "COM_OF_LOSS_T",
        "MPC_THR_HOVER",
    } <= set(found(result))
    assert result.stdout.startswith(f"vehicle 1, PX4 at udpin:127.0.0.1:{process.ports.companion}\n")
    assert result.stdout.endswith("fit to fly in formation: 0 refusals, 0 warnings\n")
    assert result.stderr == ""


def test_bad_parameters_are_refused_and_fixed(tmp_path: Path) -> None:
    with vehicle_with(tmp_path, COM_OF_LOSS_T=30.0, COM_OBL_RC_ACT=7, COM_RC_OVERRIDE=1, GF_MAX_VER_DIST=0.0) as (
        _process,
        files,
    ):
        first = doctor(files)
        assert first.returncode == 1
        assert found(first)["COM_OF_LOSS_T"] == "REFUSAL"
        assert "30 s (keeps the last setpoint for this time)" in first.stdout
        assert "set COM_OF_LOSS_T to 1" in first.stdout
        assert "--fix would set COM_OF_LOSS_T to 1, COM_OBL_RC_ACT to 5, COM_RC_OVERRIDE to 3" in first.stdout

        fixed = doctor(files, "--fix")
        assert fixed.returncode == 0, fixed.stdout
        assert "COM_OF_LOSS_T: 30 s (keeps the last setpoint for this time) -> 1: set and read back" in fixed.stdout
        shown, _, left = fixed.stdout.partition("COM_RC_OVERRIDE: 1")  # all findings come before any change
        assert "REFUSAL  COM_OF_LOSS_T" in shown
        assert "REFUSAL" not in left
        assert found(fixed)["GF_MAX_VER_DIST"] == "warning"  # the doctor does not choose a fence

        after = diagnosis(doctor(files, "--json"))
        values = {finding["subject"]: finding["found"] for finding in after["findings"]}
        assert values["COM_OBL_RC_ACT"] == "5 (hold)"
        assert values["COM_RC_OVERRIDE"].startswith("3 ")
        assert after["verdict"] == "warning"
        assert after["changes"] == []


def test_no_parameter_is_set_while_armed_and_missing_ones_are_not_found(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    known = {name: value for name, value in IN_ORDER.items() if name != "COM_OF_LOSS_T"}
    with HoveringAutopilot(1, files.udp_port, parameters=known) as autopilot:  # armed
        result = doctor(files, "--fix", "--json")
    printed = diagnosis(result)
    subjects = {finding["subject"]: finding for finding in printed["findings"]}
    assert subjects["mode"]["verdict"] == "warning"
    assert subjects["COM_OF_LOSS_T"] == {
        "subject": "COM_OF_LOSS_T",
        "verdict": "warning",
        "code": Code.PARAMETER_MISSING,
        "found": "not found",
        "wanted": "0.6 to 2 s",
        "remedy": "update the firmware, or check the link for packet loss",
        "fix": None,
    }
    assert printed["changes"] == []
    assert "PARAM_SET" not in {m.get_type() for m in autopilot.received}
    beats = [m for m in autopilot.received if m.get_type() == "HEARTBEAT"]
    assert 6 not in {m.type for m in beats}  # the doctor is no ground station
    assert result.returncode == 0


def test_no_autopilot_ends_the_doctor_with_3(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    result = doctor(files, "--wait-s", "1")
    assert result.returncode == 3
    assert "no HEARTBEAT of system 1 in 1 s; nothing arrived" in result.stderr
    assert result.stdout == ""


def test_the_autopilot_of_another_vehicle_is_named(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with HoveringAutopilot(9, files.udp_port):
        result = doctor(files, "--wait-s", "2")
    assert result.returncode == 3
    assert "received system 9 instead" in result.stderr


def test_a_link_in_use_is_refused(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as agent:
        agent.bind(("127.0.0.1", files.udp_port))
        result = doctor(files)
    assert result.returncode == 2
    assert "is in use; stop the other program" in result.stderr


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    result = companion("doctor", "--config", str(tmp_path / "none.yaml"))
    assert result.returncode == 2
    assert "none.yaml" in result.stderr


def test_failing_checks_of_the_autopilot_are_refused(tmp_path: Path) -> None:
    with vehicle_with(tmp_path, NAV_DLL_ACT=2) as (_process, files):  # it cannot be armed without a ground station
        result = doctor(files)
    assert result.returncode == 1
    assert "REFUSAL  estimator and checks  the autopilot's preflight checks do not pass" in result.stdout
    assert found(result)["NAV_DLL_ACT"] == "warning"


def test_a_stock_arducopter_is_refused_and_fixed(tmp_path: Path) -> None:
    with stand_in(tmp_path, "id: 1\n", "--autopilot", "ardupilot") as process:
        files = agent_files(tmp_path, f"udpin:127.0.0.1:{process.ports.companion}")
        fixed = doctor(files, "--fix")
    assert fixed.stdout.startswith("vehicle 1, ArduCopter at ")
    assert "REFUSAL  GUID_OPTIONS" in fixed.stdout
    assert "GUID_OPTIONS: 0 (thrust is taken as a climb rate) -> 8: set and read back" in fixed.stdout
    assert {found(fixed)[name] for name in ("GUID_OPTIONS", "GUID_TIMEOUT", "ATC_ANGLE_BOOST")} == {"ok"}
