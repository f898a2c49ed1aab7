"""The wheel and the source distribution, each installed into an environment of its own and run without the source tree.

Downloads every dependency: `make test-package`.
"""

import os
import shutil
import signal
import socket
import subprocess
import venv
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from common import ROOT, until
from processes import FLEET, VEHICLE, free_port, free_vehicle_offset
from sitl.links.ports import ports_of

pytestmark = pytest.mark.timeout(900)

NOT_SOURCE = (".git", ".venv*", "build", "dist", "runs", "*.egg-info", "__pycache__", ".*_cache", ".hypothesis")
BUILD = "import sys; from setuptools.build_meta import *; out = sys.argv[1]; build_sdist(out); build_wheel(out)"


@dataclass(frozen=True)
class Environment:
    """A virtual environment with the project in it, and a working folder that is not the source tree."""

    root: Path
    folder: Path

    def start(self, *arguments: str, **streams: object) -> subprocess.Popen[str]:
        program, *rest = arguments
        clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "COMPANION"))}
        command = [str(self.root / "bin" / program), *rest]
        return subprocess.Popen(command, cwd=self.folder, env=clean, text=True, **streams)  # type: ignore[call-overload,no-any-return]

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        out, err = process.communicate(timeout=600)
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)

    def install(self, what: str) -> None:
        done = self.run("python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", what)
        assert done.returncode == 0, done.stderr


def environment(folder: Path) -> Environment:
    venv.create(folder / "venv", with_pip=True)
    (folder / "elsewhere").mkdir()
    return Environment(folder / "venv", folder / "elsewhere")


@pytest.fixture(scope="session")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The built files by kind. The tree is copied first: a build leaves folders, and old ones would change the result."""
    folder = tmp_path_factory.mktemp("build")
    shutil.copytree(ROOT, folder / "source", symlinks=True, ignore=shutil.ignore_patterns(*NOT_SOURCE))
    builder = environment(folder)
    builder.install("setuptools>=65")
    builder.install("wheel")
    (folder / "dist").mkdir()
    subprocess.run(
        [builder.root / "bin" / "python", "-c", BUILD, folder / "dist"],
        cwd=folder / "source",
        check=True,
        capture_output=True,
    )
    files = sorted((folder / "dist").iterdir())
    return {"wheel" if file.suffix == ".whl" else "sdist": file for file in files}


@pytest.fixture(scope="session", params=["wheel", "sdist"])
def installed(
    request: pytest.FixtureRequest, distributions: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> Environment:
    """The base install: without the ground tools."""
    made = environment(tmp_path_factory.mktemp(request.param))
    made.install(str(distributions[request.param]))
    return made


@pytest.fixture
def vehicle(installed: Environment) -> Iterator[Path]:
    """The file of a vehicle whose autopilot is a running stand-in of the installed project."""
    offset = free_vehicle_offset()
    zenoh = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    mavlink = f"udpin:127.0.0.1:{ports_of(1, offset).companion}"
    (installed.folder / "fleet.yaml").write_text(FLEET, encoding="utf-8")
    file = installed.folder / "vehicle.yaml"
    file.write_text(VEHICLE.format(mavlink=mavlink, zenoh=zenoh), encoding="utf-8")
    stand_in = installed.start("sitl", "autopilot", "--port-offset", str(offset), stdout=subprocess.DEVNULL)
    try:
        yield file
    finally:
        stand_in.kill()
        stand_in.wait()


def test_the_wheel_holds_the_programs_and_nothing_else(distributions: dict[str, Path]) -> None:
    with zipfile.ZipFile(distributions["wheel"]) as wheel:
        names = wheel.namelist()
    assert {name.partition("/")[0] for name in names if ".dist-info/" not in name} == {"companion", "sitl"}
    sources = {
        str(path.relative_to(ROOT)) for program in ("companion", "sitl") for path in (ROOT / program).rglob("*.py")
    }
    assert {name for name in names if name.endswith(".py")} == sources
    assert {"sitl/scenarios/platoon.yaml", "sitl/paper/templates/report.html.j2"} <= set(names)
    page = {str(path.relative_to(ROOT)) for path in (ROOT / "companion/monitor/page").rglob("*") if path.is_file()}
    assert page <= set(names)


def test_the_programs_report_their_version(installed: Environment) -> None:
    for program in ("companion", "sitl"):
        done = installed.run(program, "--version")
        assert (done.returncode, done.stdout.split()[0]) == (0, program), done.stderr


def test_a_scenario_is_analyzed(installed: Environment) -> None:
    scenario = next(installed.root.glob("lib/python3*/site-packages/sitl/scenarios/platoon.yaml"))
    done = installed.run("companion", "analyze", str(scenario))
    assert done.returncode == 0, done.stderr
    assert "verdict:" in done.stdout


def test_the_shipped_scenarios_are_listed(installed: Environment) -> None:
    done = installed.run("sitl", "scenarios")
    assert done.returncode == 0, done.stderr
    shipped = sorted(path.stem for path in (ROOT / "config" / "scenarios").glob("*.yaml"))
    assert [line.split()[0] for line in done.stdout.splitlines()] == shipped


def test_the_doctor_examines_a_stand_in(installed: Environment, vehicle: Path) -> None:
    done = installed.run("companion", "doctor", "--config", str(vehicle))
    assert done.returncode in (0, 1), done.stderr
    assert done.stdout.startswith("vehicle 1, PX4 at udpin:")


def test_an_agent_flies_beside_a_stand_in(installed: Environment, vehicle: Path) -> None:
    log = installed.folder / "agent.log"
    with log.open("w", encoding="utf-8") as output:
        agent = installed.start("companion", "agent", "--config", str(vehicle), stderr=output)
    try:
        until(lambda: "heartbeat of autopilot 1" in log.read_text(encoding="utf-8") or agent.poll() is not None)
        agent.send_signal(signal.SIGTERM)
        assert agent.wait(20.0) == 0, log.read_text(encoding="utf-8")
    finally:
        agent.kill()
        agent.wait()


@pytest.mark.parametrize("command", ["run", "fly", "paper", "compare"])
def test_a_command_without_its_packages_names_what_to_install(installed: Environment, command: str) -> None:
    scenario = ["x.yaml"] if command in ("run", "fly") else []
    done = installed.run("sitl", command, *scenario)
    assert done.returncode == 2
    assert "not installed; this installation is without the extra [ground]" in done.stderr
    assert done.stderr.count("\n") == 1


def test_with_the_ground_tools_the_paper_s_scenarios_are_found(distributions: dict[str, Path], tmp_path: Path) -> None:
    made = environment(tmp_path)
    made.install(f"{distributions['wheel']}[ground]")
    plans = "from sitl.paper.flights import paper_plans; print(len([plan.scenario() for plan in paper_plans(False)]))"
    done = made.run("python", "-c", plans)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 0
    flight = "from sitl.api import fly; print(fly('platoon', overrides={'timeline[3].for_s': 2}).summary.failure)"
    done = made.run("python", "-c", flight)
    assert (done.returncode, done.stdout) == (0, "None\n"), done.stderr
    done = made.run("sitl", "run", "platoon", "--quiet", "--set", "timeline[3].for_s=2")
    assert done.returncode == 0, done.stderr + done.stdout
