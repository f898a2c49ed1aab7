"""Age of peer states over Zenoh beside plain UDP sockets: four vehicles with both, in the same ticks."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from sitl.flight.files import autopilots_of, ids_of, write_files
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import ports_of
from tests.bench.figures import REPEATS, Row, Section
from tests.bench.processes import Program, module, wait_for
from tests.bench.programs.peer_vehicle import Ages, PeerAges
from tests.bench.scenarios import line

VEHICLES = 4
WINDOW_S = 4.0
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
    with reserved_ports(autopilots_of(scenario), None) as offset, ExitStack() as stack:
        write_files(scenario, folder, offset)
        ports = {i: ports_of(i, offset).zenoh for i in ids}  # for UDP they are free with TCP as Zenoh's transport
        vehicles = []
        for i in ids:
            arguments = [str(REPEATS), str(WINDOW_S), str(ports[i]), *(str(ports[j]) for j in ids if j != i)]
            command = module("tests.bench.programs.peer_vehicle", str(folder / f"vehicle_{i}.yaml"), *arguments)
            vehicles.append(Program(stack, command))
        wait_for(vehicles, "heard")
        for vehicle in vehicles:
            vehicle.begin()
        results = [vehicle.result(PeerAges) for vehicle in vehicles]
    return section(results)


def section(results: Sequence[PeerAges]) -> Section:
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
