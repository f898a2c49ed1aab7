"""Every command of the field guide, in its order: real agents with identities, from `companion init` to the logs."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml

from common import ROOT
from companion.config.fleet_check import load_fleet
from deploy.boot.documented import PAGE as INSTALLATION
from processes import free_fleet_offset
from sitl.links.ports import LOOPBACK, ports_of

pytestmark = [pytest.mark.fleet, pytest.mark.long, pytest.mark.timeout(600)]

GUIDE = ROOT / "docs" / "field-guide.md"
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
IDS = (1, 2, 3, 4)


LONGEST_S = 120.0


PREPARED_WITHIN_S = 60.0


LOOKS_AGAIN_FOR_S = 10.0


ON_DEBIAN = ("sudo apt install ", "systemctl status ", "journalctl ")  # `make boot` runs these


@dataclass
class Field:
    """The computers of the guide on this machine: the operator's, and four boards beside stand-in autopilots.

    A command of the guide runs as it is printed, but for addresses, serial ports and the folder /etc/companion. All processes
    end with the block.
    """

    folder: Path
    port_offset: int
    on_debian: list[str] = field(default_factory=list)
    stack: ExitStack = field(default_factory=ExitStack)
    agents: dict[int, subprocess.Popen[bytes]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.operator = self.folder / "operator"
        self.operator.mkdir()
        self.rules: list[tuple[str, Callable[[re.Match[str]], None]]] = [
            (r"companion init field .*", self._init),
            (r"companion doctor --host .*", self._host_doctor),
            (r"companion logs .*", lambda line: self._run(self._on_board(line[0], 1))),
            (r"companion monitor", lambda line: self._run(f"{line[0]} --once")),
            (r"companion fleet doctor.*", lambda line: self._run_until_well(line[0])),
            (r"companion (analyze|provision|fleet) .*", lambda line: self._run(line[0])),
            (r"scp -r field/copy/vehicle-1 \S+:", lambda _: self._copy()),
            (r"sudo cp -r vehicle-1/\. /etc/companion/", lambda _: self._configure()),
            (r"sudo (companion doctor --config .*)", lambda line: self._doctor(line[1])),
            (r"sudo systemctl enable --now companion@1", lambda _: self._start_all()),
            (r"sudo systemctl start companion@(\d)", lambda line: self._start(int(line[1]))),
            (r"sudo systemctl stop companion@(\d)", lambda line: self._stop(int(line[1]))),
        ]

    def __enter__(self) -> Field:
        return self

    def __exit__(self, *_: object) -> None:
        self.stack.close()

    def perform(self, line: str) -> None:
        """Run one line of the guide. Raises AssertionError where it fails, and for a line without a rule."""
        command = line.partition("  #")[0].strip()
        if command.startswith(ON_DEBIAN):
            self.on_debian.append(command)
            return
        for pattern, action in self.rules:
            if matched := re.fullmatch(pattern, command):
                action(matched)
                return
        raise AssertionError(f"the tests do not know how to run: {line}")

    # ------------------------------------------------------------ the operator's computer

    def _run(self, command: str, timeout_s: float = LONGEST_S) -> None:
        done = self._tried(command, timeout_s)
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}{self._logs()}"

    def _run_until_well(self, command: str) -> None:
        """An operator looks again: agents that have just started need a moment to read the parameters."""
        end_s = time.monotonic() + LOOKS_AGAIN_FOR_S
        while time.monotonic() < end_s and self._tried(command).returncode != 0:
            time.sleep(1.0)
        self._run(command)

    def _tried(self, command: str, timeout_s: float = LONGEST_S) -> subprocess.CompletedProcess[str]:
        program, *arguments = shlex.split(command)
        assert program == "companion"
        return subprocess.run(
            [sys.executable, "-m", "companion", *arguments],
            cwd=self.operator,
            env={**os.environ, "XDG_CONFIG_HOME": str(self.folder / "settings")},
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def _init(self, line: re.Match[str]) -> None:
        links = " ".join(f"udpin:{LOOPBACK}:{ports_of(i, self.port_offset).companion}" for i in IDS)
        addresses = " ".join(f"{LOOPBACK}:{ports_of(i, self.port_offset).zenoh}" for i in IDS)
        command = re.sub(r"--mavlink \S+", f"--mavlink {links}", line[0])
        self._run(re.sub(r"--address [\d. ]+", f"--address {addresses}", command))
        fleet = load_fleet(self.operator / "field" / "fleet.yaml")
        for member in fleet.vehicles:
            self._autopilot(member.id, (member.slot_enu_m[0], member.slot_enu_m[1], 0.0))

    def _copy(self) -> None:
        for i in IDS:
            shutil.copytree(self.operator / "field" / "copy" / f"vehicle-{i}", self._board(i) / f"vehicle-{i}")

    # ------------------------------------------------------------ the boards

    def _board(self, vehicle_id: int) -> Path:
        return self.folder / f"board-{vehicle_id}"

    def _on_board(self, command: str, vehicle_id: int) -> str:
        """A command that the guide shows for vehicle 1."""
        own = command.replace("vehicle-1.yaml", f"vehicle-{vehicle_id}.yaml")
        return own.replace("/etc/companion", str(self._board(vehicle_id) / "etc"))

    def _host_doctor(self, line: re.Match[str]) -> None:
        done = self._tried(self._on_board(line[0], 1))
        assert " ok" in done.stdout, done.stdout + done.stderr  # this machine is no board: findings are no error

    def _configure(self) -> None:
        for i in IDS:
            shutil.copytree(self._board(i) / f"vehicle-{i}", self._board(i) / "etc")

    def _doctor(self, command: str) -> None:
        """The autopilots need some seconds until they can be armed."""
        end_s = time.monotonic() + PREPARED_WITHIN_S
        for i in IDS:
            while (done := self._tried(self._on_board(command, i))).returncode != 0:
                assert time.monotonic() < end_s, done.stdout + done.stderr

    def _autopilot(self, vehicle_id: int, start_enu_m: tuple[float, float, float]) -> None:
        file = self.folder / f"autopilot-{vehicle_id}.yaml"
        file.write_text(yaml.safe_dump({"id": vehicle_id, "start_enu_m": list(start_enu_m)}), encoding="utf-8")
        offset = str(self.port_offset)
        self._process(f"autopilot-{vehicle_id}", "sitl", "autopilot", "--config", str(file), "--port-offset", offset)

    def _start(self, vehicle_id: int) -> None:
        file = self._board(vehicle_id) / "etc" / f"vehicle-{vehicle_id}.yaml"
        self.agents[vehicle_id] = self._process(f"agent-{vehicle_id}", "companion", "agent", "--config", str(file))

    def _start_all(self) -> None:
        for i in IDS:
            self._start(i)

    def _stop(self, vehicle_id: int) -> None:
        self.agents[vehicle_id].send_signal(signal.SIGTERM)
        assert self.agents[vehicle_id].wait(10.0) == 0

    def _process(self, name: str, *command: str) -> subprocess.Popen[bytes]:
        log = self.stack.enter_context((self.folder / f"{name}.log").open("ab"))
        process = subprocess.Popen([sys.executable, "-m", *command], stdout=log, stderr=log)
        self.stack.callback(process.wait)
        self.stack.callback(process.kill)
        return process

    def _logs(self) -> str:
        tails = (file.read_text(encoding="utf-8")[-1500:] for file in sorted(self.folder.glob("agent-*.log")))
        return "\n".join(tails)


def commands() -> list[str]:
    return [line for block in BLOCK.findall(GUIDE.read_text(encoding="utf-8")) for line in block.splitlines()]


def test_every_command_of_the_field_guide_does_what_it_says(tmp_path: Path) -> None:
    with Field(tmp_path, free_fleet_offset()) as field:
        for line in commands():
            field.perform(line)
        assert list((tmp_path / "operator" / "logs").iterdir())
    installation = INSTALLATION.read_text(encoding="utf-8")
    for line in field.on_debian:
        program = " ".join(line.split()[:3])
        assert program in installation, line
