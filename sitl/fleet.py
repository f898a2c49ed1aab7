"""N agents, and N stand-in autopilots where nobody else flies them, as processes: their files, their start and their end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
import yaml

from companion.config.fleet import GeodeticOrigin
from companion.config.values import MAX_DRAG_1_S, VehicleId
from companion.config.vehicle import VehicleConfig, ZenohEndpoints
from companion.types import AutopilotKind
from sitl.config import AutopilotFile
from sitl.external import ReachedVehicle
from sitl.ports import LOOPBACK, ports_of
from sitl.scenario import Scenario

AGENT_ENDS_WITHIN_S = 5.0  # it may first hand over to the autopilot
STAND_IN_ENDS_WITHIN_S = 3.0
POLL_S = 0.02
ARMABLE_IN_SCENARIOS_S = 4.0
HOVER_PARAMETER = {AutopilotKind.PX4: "MPC_THR_HOVER", AutopilotKind.ARDUPILOT: "MOT_THST_HOVER"}
SET_UP: dict[AutopilotKind, dict[str, float]] = {
    AutopilotKind.PX4: {},
    AutopilotKind.ARDUPILOT: {"GUID_OPTIONS": 8.0},  # thrust is thrust
}


@dataclass(frozen=True, slots=True)
class Child:
    """One process of a fleet. `name` is "agent 3" or "autopilot 3"."""

    name: str
    vehicle_id: int
    log: Path
    process: subprocess.Popen[bytes]

    def last_words(self) -> str:
        """The last line of its log."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")

    def ending(self) -> str:
        """How it ended, with its last words; "" while it runs."""
        code = self.process.poll()
        if code is None:
            return ""
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        return f"{self.name} {how}: {self.last_words()}"


class Fleet:
    """The processes of one flight. Use it in a `with`: none outlives it."""

    def __init__(self, children: Sequence[Child]) -> None:
        self._children = tuple(children)
        self._gone: set[str] = set()

    @classmethod
    def start(
        cls,
        scenario: Scenario,
        folder: Path,
        port_offset: int,
        external: Mapping[int, ReachedVehicle] | None = None,
    ) -> Fleet:
        """Write every process's file into `folder` and start it. The stand-ins come first; `external` vehicles need none."""
        write_files(scenario, folder, port_offset, external)
        fleet = cls([])
        try:
            for vehicle_id in ids_of(scenario) if external is None else []:
                arguments = ["--port-offset", str(port_offset), "--truth", str(truth_path(folder, vehicle_id))]
                fleet._start(folder, "sitl", "autopilot", vehicle_id, arguments)
            for vehicle_id in ids_of(scenario):
                fleet._start(folder, "companion", "agent", vehicle_id, [])
        except BaseException:  # also an interruption: what has been started must not stay
            fleet.kill()
            raise
        return fleet

    def _start(self, folder: Path, program: str, role: str, vehicle_id: int, more: Sequence[str]) -> None:
        config = folder / f"{'vehicle' if role == 'agent' else role}_{vehicle_id}.yaml"
        command = [sys.executable, "-m", program, role, "--config", str(config), *more]
        log = folder / f"{role}_{vehicle_id}.log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "sitl.bound", str(os.getpid()), *command],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a Ctrl-C in the terminal is the parent's: it lands first
            )
        self._children = (*self._children, Child(f"{role} {vehicle_id}", vehicle_id, log, process))

    def pid_of(self, name: str) -> int:
        """Of a process by its name, like "agent 3"."""
        return next(child.process.pid for child in self._children if child.name == name)

    def unexpected_end(self) -> str | None:
        """What the first process that ended by itself has to say; each is told once."""
        for child in self._children:
            if child.name not in self._gone and (ending := child.ending()):
                self._gone.add(child.name)
                return ending
        return None

    def lost_vehicles(self) -> set[int]:
        """Vehicles without their agent or their autopilot: nobody can land them any more."""
        return {child.vehicle_id for child in self._children if child.process.poll() is not None}

    def stop(self) -> list[str]:
        """End the agents, then the stand-ins; kill what does not end. Returns the names of those that were killed."""
        agents = [child for child in self._children if child.name.startswith("agent")]
        stand_ins = [child for child in self._children if child not in agents]
        killed = _end(agents, AGENT_ENDS_WITHIN_S) + _end(stand_ins, STAND_IN_ENDS_WITHIN_S)
        self._gone.update(child.name for child in self._children)
        return killed

    def kill(self) -> None:
        """End everything at once."""
        _kill(self._children)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()


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
    """To the process's whole session; Popen knows whether its process id is still its own."""
    if child.process.poll() is None:
        os.killpg(child.process.pid, number)


# ---------------------------------------------------------------- files and ports


def ids_of(scenario: Scenario) -> list[VehicleId]:
    return sorted(member.id for member in scenario.fleet.vehicles)


def endpoint_of(vehicle_id: int, port_offset: int) -> str:
    """Where a vehicle's agent listens for Zenoh."""
    return f"tcp/{LOOPBACK}:{ports_of(vehicle_id, port_offset).zenoh}"


def truth_path(folder: Path, vehicle_id: int) -> Path:
    return folder / f"truth_{vehicle_id}.csv"


def estimated_path(folder: Path, vehicle_id: int) -> Path:
    return folder / f"estimated_{vehicle_id}.csv"


def write_files(
    scenario: Scenario, folder: Path, port_offset: int, external: Mapping[int, ReachedVehicle] | None = None
) -> None:
    """scenario.yaml as flown, fleet.yaml, vehicle_N.yaml and, for stand-ins, autopilot_N.yaml."""
    write_scenario(scenario, folder)
    _write_yaml(folder / "fleet.yaml", scenario.fleet)
    for vehicle_id in ids_of(scenario):
        reached = reached_stand_in(scenario, vehicle_id, port_offset) if external is None else external[vehicle_id]
        _write_yaml(folder / f"vehicle_{vehicle_id}.yaml", vehicle_file(scenario, reached, port_offset))
        if external is None:
            _write_yaml(folder / f"autopilot_{vehicle_id}.yaml", autopilot_file(scenario, vehicle_id))


def write_scenario(scenario: Scenario, folder: Path) -> None:
    """scenario.yaml as flown."""
    _write_yaml(folder / "scenario.yaml", scenario)


def reached_stand_in(scenario: Scenario, vehicle_id: int, port_offset: int) -> ReachedVehicle:
    """How the scenario's stand-in is reached, and what it is like."""
    kind, ports, airframe = scenario.stand_in.autopilot, ports_of(vehicle_id, port_offset), scenario.stand_in.airframe
    endpoints = {  # as the simulation of each has it by itself
        AutopilotKind.PX4: f"udpin:{LOOPBACK}:{ports.companion}",
        AutopilotKind.ARDUPILOT: f"tcp:{LOOPBACK}:{ports.tcp}",
    }
    return ReachedVehicle(
        id=vehicle_id,
        mavlink=endpoints[kind],
        hover_thrust_norm=scenario.stand_in.hover_thrust_norm,
        drag_1_s=min(airframe.drag_n_per_m_s / airframe.mass_kg, MAX_DRAG_1_S),
    )


def vehicle_file(scenario: Scenario, reached: ReachedVehicle, port_offset: int) -> VehicleConfig:
    """An agent's file. Of two vehicles the one with the larger id connects; the reference is for those that may lead."""
    member, believed, vehicle_id = scenario.fleet.member(reached.id), scenario.believed, reached.id
    assert member is not None  # it is of this fleet
    return VehicleConfig(
        id=vehicle_id,
        fleet="fleet.yaml",
        mavlink=reached.mavlink,
        autopilot=reached.autopilot,
        hover_thrust_norm=_first(believed.hover_thrust_norm, reached.hover_thrust_norm),
        drag_1_s=_first(believed.drag_1_s, reached.drag_1_s),
        zenoh=ZenohEndpoints(
            listen=(endpoint_of(vehicle_id, port_offset),),
            connect=tuple(endpoint_of(i, port_offset) for i in ids_of(scenario) if i < vehicle_id),
        ),
        reference=scenario.reference if member.can_lead else None,
    )


def _first(believed: float | None, true: float) -> float:
    return true if believed is None else believed


def autopilot_file(scenario: Scenario, vehicle_id: int) -> AutopilotFile:
    """A stand-in's file. The world's frame is the fleet's.

    It is set up as an agent wants it where the scenario says nothing else, and nobody waits 42 s for it.
    """
    origin = scenario.fleet.origin
    assert isinstance(origin, GeodeticOrigin)  # scenario_from refuses any other
    stand_in = scenario.stand_in
    hover_thrust_norm = scenario.believed.hover_thrust_norm
    believed = {} if hover_thrust_norm is None else {HOVER_PARAMETER[stand_in.autopilot]: hover_thrust_norm}
    ready_s = ARMABLE_IN_SCENARIOS_S if stand_in.armable_after_s is None else stand_in.armable_after_s
    return AutopilotFile(
        id=vehicle_id,
        world_origin=origin,
        start_enu_m=scenario.starts_enu_m[vehicle_id],
        origin_enu_m=scenario.origins_enu_m.get(vehicle_id),
        stand_in=msgspec.structs.replace(
            stand_in, armable_after_s=ready_s, parameters=SET_UP[stand_in.autopilot] | believed | stand_in.parameters
        ),
    )


def _write_yaml(path: Path, content: msgspec.Struct) -> None:
    path.write_text(yaml.safe_dump(msgspec.to_builtins(content), sort_keys=False), encoding="utf-8")
