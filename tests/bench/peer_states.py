"""Age of peer states over Zenoh beside plain UDP sockets: four vehicles with both, in the same ticks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from threading import Timer

import msgspec

from sitl.flight.files import ids_of, write_files
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import ports_of
from tests.bench.figures import REPEATS, Row, Section
from tests.bench.programs.peer_vehicle import Ages, Result
from tests.bench.scenarios import line

VEHICLES = 4
WINDOW_S = 4.0
HEARD_WITHIN_S = 60.0
HOW = """\
Four processes with the agent's own Zenoh link (TCP on this machine, without identities) and with plain UDP sockets \
publish the same packet over both in every tick at 50 Hz. Each packet has its own time of sending, and the way that \
goes first changes from tick to tick. At every tick each process notes the age of the newest state of each other \
vehicle, for both ways. Each of five windows of 4 s is a repeat, and the figure is that of the median vehicle. The \
periods of the vehicles differ a little, so that their ticks pass each other within a window: waiting for the next \
tick is up to 20 ms of the age, 10 ms on average, and the transport is the rest."""


def measure(folder: Path) -> Section:
    """Raises RuntimeError where the vehicles do not hear each other."""
    folder.mkdir()
    scenario = line(VEHICLES, form_s=1.0)
    ids = [int(i) for i in ids_of(scenario)]
    with reserved_ports(ids, scenario.stand_in.autopilot, None) as offset, ExitStack() as stack:
        write_files(scenario, folder, offset)
        ports = {i: ports_of(i, offset).zenoh for i in ids}  # for UDP they are free with TCP as Zenoh's transport
        vehicles = [
            _start(stack, folder / f"vehicle_{i}.yaml", [ports[i], *(ports[j] for j in ids if j != i)]) for i in ids
        ]
        _wait_until_heard(vehicles)
        for vehicle in vehicles:
            assert vehicle.stdin is not None
            vehicle.stdin.write("\n")
            vehicle.stdin.flush()
        results = [_result(vehicle) for vehicle in vehicles]
    return section(results)


def section(results: Sequence[Result]) -> Section:
    """From the results of all vehicles."""
    rows = tuple(
        Row(
            what=f"age of a peer's state over Zenoh, {share}",
            unit="ms",
            values=_of_median_vehicle([result.zenoh for result in results], share),
            beside="UDP sockets",
            beside_values=_of_median_vehicle([result.udp for result in results], share),
        )
        for share in ("p50", "p99")
    )
    return Section(title="Age of peer states", how=HOW, rows=rows)


def _of_median_vehicle(of_vehicles: Sequence[Sequence[Ages]], share: str) -> tuple[float, ...]:
    return tuple(median(getattr(ages, f"{share}_ms") for ages in window) for window in zip(*of_vehicles, strict=True))


def _start(stack: ExitStack, file: Path, ports: Sequence[int]) -> subprocess.Popen[str]:
    bound = [sys.executable, "-m", "sitl.flight.bound", str(os.getpid())]
    arguments = [str(file), str(REPEATS), str(WINDOW_S), *map(str, ports)]
    vehicle = subprocess.Popen(
        [*bound, sys.executable, "-m", "tests.bench.programs.peer_vehicle", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    stack.callback(_end, vehicle)
    return vehicle


def _end(vehicle: subprocess.Popen[str]) -> None:
    vehicle.kill()
    vehicle.communicate()


def _kill(vehicles: Sequence[subprocess.Popen[str]]) -> None:
    for vehicle in vehicles:
        vehicle.kill()


def _wait_until_heard(vehicles: Sequence[subprocess.Popen[str]]) -> None:
    limit = Timer(HEARD_WITHIN_S, _kill, [vehicles])
    limit.start()
    try:
        if not all(vehicle.stdout and vehicle.stdout.readline() == "heard\n" for vehicle in vehicles):
            raise RuntimeError(f"the vehicles did not hear each other within {HEARD_WITHIN_S:g} s")
    finally:
        limit.cancel()


def _result(vehicle: subprocess.Popen[str]) -> Result:
    assert vehicle.stdout is not None
    return msgspec.json.decode(vehicle.stdout.readline(), type=Result)
