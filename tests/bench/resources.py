"""CPU and memory of real agents with 3, 7 and 15 peers, and whether sixteen of them keep 50 Hz."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from sitl.flight.files import autopilots_of
from sitl.links.free_ports import reserved_ports
from tests.bench.control_loop import median_memory_mb, rate_of_slowest_hz
from tests.bench.figures import Row, Section, Target, cpu_percent
from tests.bench.real_flight import FORM_S, Flown, fly
from tests.bench.scenarios import line

FEW, SOME, MANY = 3, 7, 15  # peers
HOW = """\
Real agents fly in a line with their stand-ins on this machine, on default settings (they record). CPU is the time \
that all threads of an agent's process ran, by the kernel's account, as a share of one core: the mean of the agents in \
each of five windows of 7 s in formation. Memory is the resident memory of the median agent at the end of each window. \
The flight with 3 peers is the one of the first tables. With 15 peers sixteen agents and their stand-ins share this \
machine: where the cores are full, a tick has to wait, and the rate of the slowest agent falls. Agents below 50 Hz use \
less CPU than they would at 50 Hz."""


def measure(few: Flown, folder: Path) -> Section:
    """`few` is the flight with three peers."""
    flown = {FEW: few}
    for peers in (SOME, MANY):
        flown[peers] = _fly(peers + 1, folder / str(peers))
    return section(flown)


def _fly(count: int, folder: Path) -> Flown:
    folder.mkdir()
    scenario = line(count, FORM_S)
    with reserved_ports(autopilots_of(scenario), None) as offset:
        return fly(scenario, folder, offset)


def section(flown: dict[int, Flown]) -> Section:
    """From the flights by number of peers."""
    cpu = {peers: _cpu_percent(one) for peers, one in flown.items()}
    rows = []
    for peers, one in flown.items():
        target = Target("value", most=5.5) if peers == FEW else None
        what, remark = f"CPU of an agent, {peers} peers", one.failure
        rows.append(Row(what=what, unit="% of a core", values=cpu[peers], target=target, remark=remark))
    for peers, one in flown.items():
        target = Target("value", most=45.0) if peers == FEW else None
        what = f"memory of an agent, {peers} peers"
        rows.append(Row(what=what, unit="MB", values=median_memory_mb(one), target=target))
    rows += [
        Row(
            what=f"ticks of the slowest of {peers + 1} agents",
            unit="Hz",
            values=rate_of_slowest_hz(one),
            target=Target("value", least=49.8, most=50.2) if peers == MANY else None,
            remark=_formation(one) if peers == MANY else "",
        )
        for peers, one in flown.items()
    ]
    return Section(title="CPU and memory of an agent", how=HOW, rows=tuple(rows))


def _cpu_percent(flown: Flown) -> tuple[float, ...]:
    return tuple(cpu_percent(a, b) for a, b in pairwise(flown.uses))


def _formation(flown: Flown) -> str:
    return f"the flight failed: {flown.failure}" if flown.failure else "the formation was kept to the end"
