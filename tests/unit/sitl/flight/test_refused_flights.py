"""`sitl fly` with a scenario, ports or a folder that cannot be used: one line, and no process is started."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from common import ROOT
from processes import free_fleet_offset
from sitl.cli.main import main
from sitl.links.ports import ports_of

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
Refused = Callable[..., str]


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Refused:
    """The one line on stderr of a `sitl fly` that starts no process. On stdout only notes about the scenario and the ports."""

    def run(*arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", ["sitl", "fly", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        shown = capsys.readouterr()
        assert ended.value.code == 2
        assert all(line.startswith(("expected of ", "all ports are offset by ")) for line in shown.out.splitlines())
        assert len(shown.err.splitlines()) == 1
        return shown.err.strip()

    return run


@pytest.mark.parametrize(
    ("kind", "vehicle_id", "which", "user"),
    [
        (socket.SOCK_DGRAM, 2, "onboard", "wanted by autopilot 2 towards its agent"),
        (socket.SOCK_DGRAM, 1, "companion", "wanted by agent 1 towards its autopilot"),
        (socket.SOCK_DGRAM, 4, "ground_link", "wanted by autopilot 4 towards a ground station"),
        (socket.SOCK_STREAM, 3, "zenoh", "wanted by Zenoh of agent 3"),
    ],
)
def test_a_port_in_use_is_refused(
    tmp_path: Path, refused: Refused, kind: socket.SocketKind, vehicle_id: int, which: str, user: str
) -> None:
    offset = free_fleet_offset()
    port = getattr(ports_of(vehicle_id, offset), which)
    with socket.socket(socket.AF_INET, kind) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # an earlier fleet's connections may linger
        other.bind(("127.0.0.1", port))
        if kind is socket.SOCK_STREAM:
            other.listen()
        line = refused(str(PLATOON), "--out", str(tmp_path / "out"), "--port-offset", str(offset))
    assert line.startswith(f"{'UDP' if kind is socket.SOCK_DGRAM else 'TCP'} port {port}, {user}")
    assert f"--port-offset {offset + 100}" in line
    assert not (tmp_path / "out").exists()


def test_a_bad_scenario_and_a_bad_override_are_refused_in_one_line(tmp_path: Path, refused: Refused) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(PLATOON.read_text(encoding="utf-8").replace("role: leader", "role: follower"), encoding="utf-8")
    assert refused(str(bad)).startswith(f"{bad}: fleet.vehicles: no vehicle leads")
    assert refused(str(tmp_path / "none.yaml")).endswith("cannot be read: No such file or directory; check the path")
    assert refused(str(tmp_path)).endswith("cannot be read: Is a directory; expected a file")
    flown = tmp_path / "scenario.yaml"
    flown.touch()
    assert refused(str(tmp_path)).endswith(f"cannot be read: Is a directory; use {flown}")
    law = ROOT / "config" / "examples" / "integral.py"
    assert refused(str(law)).endswith("is Python; expected a YAML file, and a law of your own after --law")
    assert refused(str(PLATOON), "--law", "none.py").endswith("No such file or directory; check the path")
    assert (
        refused(str(PLATOON), "--set", "fleet.law.nam=x") == '--set: fleet.law.nam: unknown key; did you mean "name"?'
    )


def test_a_wrong_kind_of_external_autopilot_and_a_program_that_nobody_starts_are_refused(refused: Refused) -> None:
    assert refused(str(PLATOON), "--external", "PX4") == "--external: PX4 is neither px4 nor ardupilot nor a file"
    assert refused(str(PLATOON), "--binary", "px4").startswith("--binary: goes with --external px4 or ")


def test_a_comparison_without_a_formation_is_refused(refused: Refused) -> None:
    line = refused(str(PLATOON), "--compare", "--set", "timeline=[{command: prepare}]")
    assert "timeline: has no step with command: form" in line


def test_a_folder_that_cannot_be_made_is_refused_in_one_line(tmp_path: Path, refused: Refused) -> None:
    file = tmp_path / "file"
    file.touch()
    assert refused(str(PLATOON), "--port-offset", str(free_fleet_offset()), "--out", str(file)) == (
        f"{file}: File exists; choose another folder with --out"
    )
