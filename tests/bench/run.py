"""The whole run: one measurement after the other, then JSON and page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
from msgspec.structs import replace

from tests.bench import agent_step, batch, control_loop, further_peer, lockstep, peer_states, poses, resources
from tests.bench.figures import Section
from tests.bench.machine import Machine, Meanwhile
from tests.bench.page import others_in_words, page, row_in_words
from tests.bench.real_flight import Flown

Step = tuple[str, Callable[[], list[Section]]]


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """The JSON file."""

    machine: Machine
    sections: tuple[Section, ...]


def run(out: Path, page_file: Path) -> None:
    """Measures everything, prints each figure when it is there, and writes both files at the end."""
    meanwhile = Meanwhile()
    sections: list[Section] = []
    with TemporaryDirectory(prefix="bench-") as name:
        steps = list(_steps(Path(name)))
        for number, (what, measure) in enumerate(steps, start=1):
            print(f"[{number} of {len(steps)}, {meanwhile.lasted_s:.0f} s] {what}", flush=True)
            for section in _with_others(measure):
                sections.append(section)
                for row in section.rows:
                    print(f"  {row_in_words(row)}", flush=True)
                print(f"  {others_in_words(section)}", flush=True)
    machine = meanwhile.machine()
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(msgspec.json.format(msgspec.json.encode(Run(machine=machine, sections=tuple(sections))), indent=2))
    page_file.write_text(page(machine, sections), encoding="utf-8")
    print(f"{machine.in_words()}\nwrote {out} and {page_file}")


def _steps(folder: Path) -> Iterator[Step]:
    """In the order in which they run; real agents first, while the machine is coolest and quietest."""

    few: list[Flown] = []  # the flight with three peers serves two tables

    def beside_others() -> list[Section]:
        first = folder / "control_loop"
        first.mkdir()
        sections, flown = control_loop.measure(first)
        few.append(flown)
        return sections

    yield "four real agents beside C, asyncio and mavsdk (a minute)", beside_others
    yield "real agents with 7 and 15 peers (two minutes)", lambda: [resources.measure(few[0], folder)]
    yield "motion-capture poses into MAVLink (a minute)", lambda: [poses.measure(folder / "poses")]
    yield "age of peer states over Zenoh and UDP", lambda: [peer_states.measure(folder / "peers")]
    yield "Agent.step with 3, 10 and 50 neighbours", lambda: [agent_step.measure(folder)]
    yield "each further peer (a minute)", lambda: [further_peer.measure(folder)]
    yield "lockstep with 4, 16 and 100 vehicles (minutes)", lambda: [lockstep.measure()]
    yield "batches beside RotorPy (two minutes)", lambda: [batch.measure()]


def _with_others(measure: Callable[[], list[Section]]) -> list[Section]:
    """The sections, with the use of the cores by other processes during their measurement."""
    meanwhile = Meanwhile()
    return [replace(section, others_cores=meanwhile.others_cores()) for section in measure()]
