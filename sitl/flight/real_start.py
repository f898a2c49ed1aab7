"""Starts a fleet of real autopilots: one after the other, then, once each has sent a true position, the agents."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import yaml

from companion.ground.answers import id_list
from sitl.flight.files import captured_ids, ids_of, truth_path, write_cameras, write_files
from sitl.flight.orders import FlightFailure
from sitl.flight.processes import FleetProcesses
from sitl.flight.real_autopilots import REAL, RealFleet
from sitl.flight.true_positions import TruePositionsFile, TrueVehicle
from sitl.links.ports import capture_ports, ports_of

POSITION_WITHIN_S = 30.0  # of the last start. PX4 needs 3 s, ArduCopter 2 s; the rest is for slow machines
RECORDER = "true positions"

Step = Callable[[str], None]
"""Takes what is being done. Waits a moment, and raises FlightFailure where the flight is to end."""


def start_real(fleet: RealFleet, folder: Path, port_offset: int, step: Step) -> FleetProcesses:
    """Start all processes, whose files are written into `folder`. Raises FlightFailure."""
    write_files(fleet.scenario, folder, port_offset, fleet.reached(port_offset))
    if captured_ids(fleet.scenario):
        write_cameras(fleet.scenario, folder, port_offset)
    file = folder / "true_positions.yaml"
    plain = msgspec.to_builtins(true_positions_of(fleet, port_offset))
    file.write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
    with FleetProcesses.whole_or_none() as processes:

        def go_on(doing: str) -> None:
            step(doing)
            if ending := processes.unexpected_end():
                raise FlightFailure(ending)

        processes.start_module(RECORDER, (), folder, "sitl.flight.true_positions", str(file))
        _start_autopilots(fleet, processes, folder, port_offset, go_on)
        _wait_for_positions(fleet, folder, go_on)
        processes.start_agents(fleet.scenario, folder, port_offset)
    return processes


def true_positions_of(fleet: RealFleet, port_offset: int) -> TruePositionsFile:
    origin = fleet.scenario.fleet.place
    assert origin is not None  # scenario_from accepts no other
    vehicles = (TrueVehicle(i, REAL[kind].true_endpoint(ports_of(i, port_offset))) for i, kind in fleet.kinds.items())
    seen_by = capture_ports(port_offset).truth if captured_ids(fleet.scenario) else None
    return TruePositionsFile(origin, tuple(vehicles), truth_port=seen_by)


def _start_autopilots(fleet: RealFleet, processes: FleetProcesses, folder: Path, port_offset: int, go_on: Step) -> None:
    for vehicle_id, pause_s in fleet.pauses_s().items():
        real = REAL[fleet.kinds[vehicle_id]]
        begins_s = time.monotonic() + pause_s
        while time.monotonic() < begins_s:
            go_on(f"starting {real.name} {vehicle_id}")
        own = (folder / f"autopilot_{vehicle_id}").absolute()
        shutil.rmtree(own, ignore_errors=True)  # parameters and logs of an older run
        own.mkdir()
        launch = real.launch(fleet.started(vehicle_id, own, port_offset))
        for name, text in launch.files.items():
            (own / name).write_text(text, encoding="utf-8")
        name = f"autopilot {vehicle_id}"
        processes.start_program(name, [vehicle_id], folder, launch.command, own, launch.environment)


def _wait_for_positions(fleet: RealFleet, folder: Path, go_on: Step) -> None:
    until_s = time.monotonic() + POSITION_WITHIN_S
    while silent := [i for i in ids_of(fleet.scenario) if not _has_position(truth_path(folder, i))]:
        if time.monotonic() > until_s:
            logs = ", ".join(str(folder / f"autopilot_{i}.log") for i in silent)
            raise FlightFailure(
                f"{id_list(silent)} sent no true position within {POSITION_WITHIN_S:g} s of the start; log: {logs}"
            )
        go_on(f"waiting for the first position of {id_list(silent)}")


def _has_position(track: Path) -> bool:
    """Whether there is a line after the header."""
    return track.exists() and track.read_bytes().count(b"\n") > 1
