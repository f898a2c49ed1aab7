"""Processes of one flight: an agent per vehicle and, without external autopilots, the stand-ins; their start and end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from companion.ground.publishers import TargetPublisher
from companion.types.values import Vector3
from sitl.flight.director import MovingTargets
from sitl.flight.external import ReachedVehicle
from sitl.flight.files import autopilot_path, cameras_path, ids_of, mocap_path, network_path, truth_path, write_files
from sitl.flight.scenario import Scenario
from sitl.links.ports import zenoh_endpoint

AGENT_ENDS_WITHIN_S = 5.0  # it first hands over to the autopilot
STAND_IN_ENDS_WITHIN_S = 3.0
POLL_S = 0.02
STAND_INS_PER_PROCESS = 16  # a third of a core; alone each of them would take three to four times its share


@dataclass(frozen=True, slots=True)
class Child:
    """One process of a fleet. `name` is "agent 3", "autopilot 3", "autopilots 1 to 4", or without a vehicle "network"."""

    name: str
    vehicle_ids: tuple[int, ...]
    log: Path
    process: subprocess.Popen[bytes]

    def last_output(self) -> str:
        """The last line of its log."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "no output")

    def ending(self) -> str:
        """How it ended, with the last line of its log, which says why unless it was killed; "" while it runs."""
        code = self.process.poll()
        if code is None:
            return ""
        if code < 0:
            was = "were" if len(self.vehicle_ids) > 1 else "was"
            return f"{self.name} {was} killed by {signal.Signals(-code).name}; log: {self.log}"
        return f"{self.name} ended with exit code {code}: {self.last_output()}; log: {self.log}"


class FleetProcesses(AbstractContextManager["FleetProcesses"]):
    """The processes of one flight, a context manager: all processes are killed at its end."""

    def __init__(self, children: Sequence[Child]) -> None:
        self._children = tuple(children)
        self._reported: set[str] = set()

    @classmethod
    def start(
        cls, scenario: Scenario, folder: Path, port_offset: int, external: Mapping[int, ReachedVehicle] | None = None
    ) -> FleetProcesses:
        """Write every process's file into `folder` and start it, stand-ins first; `external` autopilots need no stand-in."""
        write_files(scenario, folder, port_offset, external)
        together = stand_ins_together(scenario) if external is None else []
        return cls.start_written(scenario, folder, port_offset, together)

    @classmethod
    def start_written(
        cls, scenario: Scenario, folder: Path, port_offset: int, stand_ins: Sequence[Sequence[int]]
    ) -> FleetProcesses:
        """Start the processes of the files in `folder`. Each item of `stand_ins` is the ids of those in one process."""
        with cls.whole_or_none() as fleet:
            for ids in stand_ins:
                fleet._start_stand_ins(folder, ids, port_offset)
            fleet.start_agents(scenario, folder, port_offset)
        return fleet

    @classmethod
    @contextmanager
    def whole_or_none(cls) -> Iterator[FleetProcesses]:
        """Processes are started in the block; where it fails or is interrupted, none of them remains."""
        fleet = cls([])
        try:
            yield fleet
        except BaseException:
            fleet.kill()
            raise

    def _start_stand_ins(self, folder: Path, ids: Sequence[int], port_offset: int) -> None:
        name = f"autopilot {ids[0]}" if len(ids) == 1 else f"autopilots {ids[0]} to {ids[-1]}"
        configs = [str(autopilot_path(folder, i)) for i in ids]
        truths = [str(truth_path(folder, i)) for i in ids]
        arguments = ["--config", *configs, "--truth", *truths, "--port-offset", str(port_offset)]
        self.start_module(name, ids, folder, "sitl", "autopilot", *arguments)

    def start_agents(self, scenario: Scenario, folder: Path, port_offset: int) -> None:
        """The agents of the files in `folder`, the cameras that see them, and the network between them if it is disturbed."""
        if cameras_path(folder).exists():
            self._start_cameras(scenario, folder, port_offset)
        if network_path(folder).exists():
            self.start_module("network", (), folder, "sitl.links.emulated_network", str(network_path(folder)))
        for vehicle_id in ids_of(scenario):
            config = str(folder / f"vehicle_{vehicle_id}.yaml")
            self.start_module(f"agent {vehicle_id}", [vehicle_id], folder, "companion", "agent", "--config", config)

    def _start_cameras(self, scenario: Scenario, folder: Path, port_offset: int) -> None:
        """The motion-capture system, and `companion mocap`, which reads it."""
        self.start_module("cameras", (), folder, "sitl.links.cameras", str(cameras_path(folder)))
        endpoints = [zenoh_endpoint(i, port_offset) for i in ids_of(scenario)]
        reading = ("mocap", "run", str(mocap_path(folder)), "--connect", *endpoints)
        self.start_module("mocap", (), folder, "companion", *reading)

    def start_module(self, name: str, ids: Sequence[int], folder: Path, module: str, *arguments: str) -> None:
        """A Python module as a program; its log is in `folder`."""
        self.start_program(name, ids, folder, [sys.executable, "-m", module, *arguments])

    def start_program(
        self,
        name: str,
        ids: Sequence[int],
        folder: Path,
        command: Sequence[str],
        own_folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Another program, with its own working folder and what is added to the environment."""
        log = folder / f"{name.replace(' ', '_')}.log"
        with log.open("wb") as output:
            # In a session of its own: Ctrl-C in the terminal reaches the parent alone, which lands first.
            process = subprocess.Popen(
                [sys.executable, "-m", "sitl.flight.bound", str(os.getpid()), *command],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                cwd=own_folder,
                env={**os.environ, **(environment or {})},
            )
        self._children = (*self._children, Child(name, tuple(ids), log, process))

    def pid_of(self, name: str) -> int:
        """Process id of the process with this name, like "agent 3"."""
        return next(child.process.pid for child in self._children if child.name == name)

    def unexpected_end(self) -> str | None:
        """How a process ended that was not stopped, in one line; each is reported once."""
        for child in self._children:
            if child.name not in self._reported and (ending := child.ending()):
                self._reported.add(child.name)
                return ending
        return None

    def lost_vehicles(self) -> set[int]:
        """Vehicles whose agent or stand-in has ended: they cannot be landed from here."""
        ended = (child for child in self._children if child.process.poll() is not None)
        return {vehicle_id for child in ended for vehicle_id in child.vehicle_ids}

    def ended_by_themselves(self) -> set[int]:
        """Of these vehicles an agent or stand-in has ended though nobody stopped or killed it."""
        ended = (child for child in self._children if (child.process.poll() or 0) > 0)
        return {vehicle_id for child in ended for vehicle_id in child.vehicle_ids}

    def stop(self) -> list[str]:
        """End the agents, then the others; kill a process that does not end. Returns the names of the killed."""
        agents = [child for child in self._children if child.name.startswith("agent")]
        others = [child for child in self._children if child not in agents]
        killed = _end(agents, AGENT_ENDS_WITHIN_S) + _end(others, STAND_IN_ENDS_WITHIN_S)
        self._reported.update(child.name for child in self._children)
        return killed

    def stop_all(self) -> list[str]:
        """As `stop`. Returns a line that names the killed processes, if there are any."""
        killed = self.stop()
        return [f"{', '.join(killed)} did not end within its time and was killed"] if killed else []

    def kill(self) -> None:
        """Kill all processes."""
        _kill(self._children)

    def __exit__(self, *_exception: object) -> None:
        self.kill()


def stand_ins_together(scenario: Scenario) -> list[list[int]]:
    """Ids of all stand-ins, in as few processes as one core each can run."""
    ids = [int(vehicle_id) for vehicle_id in ids_of(scenario)]
    return [ids[at : at + STAND_INS_PER_PROCESS] for at in range(0, len(ids), STAND_INS_PER_PROCESS)]


def _end(children: Sequence[Child], within_s: float) -> list[str]:
    for child in children:
        _signal(child, signal.SIGTERM)
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s and any(child.process.poll() is None for child in children):
        time.sleep(POLL_S)
    late = [child for child in children if child.process.poll() is None]
    _kill(late)
    return [child.name for child in late]


def _kill(children: Iterable[Child]) -> None:
    running = [child for child in children if child.process.poll() is None]
    for child in running:
        _signal(child, signal.SIGKILL)
    for child in running:
        child.process.wait()


def _signal(child: Child, number: signal.Signals) -> None:
    """Signal the process's whole session; poll() tells whether its process id is still its own."""
    if child.process.poll() is None:
        os.killpg(child.process.pid, number)


def publish_targets(scenario: Scenario, endpoints: Sequence[str], began_s: float, stack: ExitStack) -> MovingTargets:
    """One publisher per target, closed with `stack`."""
    publishers = {
        target.name: stack.enter_context(TargetPublisher(scenario.fleet.name, endpoints, target.name))
        for target in scenario.targets
    }

    def publish(name: str, velocity_enu_m_s: Vector3, position_enu_m: Vector3) -> None:
        publishers[name].publish(velocity_enu_m_s, position_enu_m)

    return MovingTargets(scenario.targets, publish, began_s)
