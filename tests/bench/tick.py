"""What one tick of a follower runs: files, classes, calls and depth of `Agent.prepare`, `decide` and `report`.

python -m tests.bench.tick             the diagram of the docs with the calls of each stage, then the figures as JSON
python -m tests.bench.tick --json      the figures alone
python -m tests.bench.tick --stages    the stages with their inputs and outputs, without a flight

The platoon of config/scenarios flies in lockstep. Follower 2 has three peers, two of them neighbours, and is in steady
formation. Two fleets in which all are neighbours of all give the calls for each further neighbour. Each figure is the
median of the ticks without a status. `Agent.step`, which calls all, counts as one call and as depth 1. Frames of
comprehensions do not count, so that the figures are those of every Python: since 3.12 most of them have no frame.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import CodeType, FrameType

from companion.core.agent import Agent
from companion.types.tick import Outbox
from sitl.flight.director import Director
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import watch_of
from sitl.report.progress import FlightProgress
from tests.bench import stages
from tests.bench.scenarios import complete

TOP = Path(__file__).parents[2]
PLATOON = TOP / "config" / "scenarios" / "platoon.yaml"
FOLLOWER_ID = 2
FEW, MANY = 4, 8  # vehicles of the fleets in which all are neighbours of all
SETTLING_S = 6.0  # in formation, before ticks are counted
COUNTED_S = 1.0  # virtual time; every tick of steady formation is alike
COMPREHENSIONS = frozenset({"<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>"})
PREPARE, REPORT = Agent.prepare.__code__, Agent.report.__code__
PARTS = (PREPARE, Agent.decide.__code__, REPORT)


@dataclass(slots=True)
class Tick:
    """What Python code ran in one tick of `vehicle_id`. `stages` has the calls below each function that `Agent` calls."""

    vehicle_id: int = 0
    has_status: bool = False
    files: set[str] = field(default_factory=set)
    classes: set[str] = field(default_factory=set)
    calls: int = 1
    depth: int = 1
    stages: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True, slots=True)
class Figures:
    """Medians over the counted ticks of one vehicle."""

    files: int
    classes: int
    calls: int
    depth: int
    calls_each_further_neighbour: float


class TickCounter:
    """Counts what runs below the parts of a tick, as the interpreter reports it. `ticks` are complete.

    Between the parts of one agent's tick run those of other agents.
    """

    def __init__(self) -> None:
        self.ticks: list[Tick] = []
        self._of_agent: dict[int, Tick] = {}
        self._tick = Tick()
        self._depth = 0  # 0 outside of the parts
        self._stage = ""

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count while the block runs."""
        sys.setprofile(self._observe)
        try:
            yield
        finally:
            sys.setprofile(None)

    def _observe(self, frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if code.co_name in COMPREHENSIONS:
            return
        if event == "call" and not self._depth and code in PARTS:
            self._begin(id(frame.f_locals["self"]), code)
            self._enter(code)
        elif event == "call" and self._depth:
            self._enter(code)
        elif event == "return" and self._depth:
            self._depth -= 1
            if code is REPORT and isinstance(argument, Outbox):
                self._complete(argument)

    def _begin(self, agent: int, code: CodeType) -> None:
        if code is PREPARE or agent not in self._of_agent:
            self._of_agent[agent] = Tick()
        self._tick = self._of_agent[agent]

    def _enter(self, code: CodeType) -> None:
        tick = self._tick
        self._depth += 1
        tick.calls, tick.depth = tick.calls + 1, max(tick.depth, 1 + self._depth)
        tick.files.add(code.co_filename)
        if "." in code.co_qualname and "<locals>" not in code.co_qualname:
            tick.classes.add(code.co_qualname.rpartition(".")[0])
        if self._depth == 2:
            self._stage = code.co_qualname
        if self._depth >= 2:
            tick.stages[self._stage] += 1

    def _complete(self, outbox: Outbox) -> None:
        if outbox.peer_packet:
            self._tick.vehicle_id = outbox.peer_packet.sender.vehicle_id
            self._tick.has_status = outbox.status is not None
            self.ticks.append(self._tick)


def count_ticks(scenario: Scenario) -> list[Tick]:
    """The ticks without a status of the follower in steady formation.

    Raises RuntimeError where it is not in formation.
    """
    lockstep = Lockstep(scenario)
    watch = watch_of(scenario, lockstep.now_s())
    to_formation = scenario.timeline[:-1]
    Director(lockstep, watch, FlightProgress("", True, 0.0), lambda: None, tuple, lockstep).fly(to_formation)
    counter = TickCounter()
    with counter.counting():
        lockstep.sleep(COUNTED_S)
    lockstep.close()
    ticks = [tick for tick in counter.ticks if tick.vehicle_id == FOLLOWER_ID and not tick.has_status]
    if not ticks:
        raise RuntimeError(f"vehicle {FOLLOWER_ID} had no tick")
    return ticks


def median_calls(ticks: list[Tick]) -> int:
    return statistics.median_low([tick.calls for tick in ticks])


def figures_of(ticks: list[Tick]) -> Figures:
    """Those of the platoon's ticks. Flies the two fleets in which all are neighbours of all."""
    few, many = (median_calls(count_ticks(complete(count, SETTLING_S))) for count in (FEW, MANY))
    return Figures(
        files=statistics.median_low([len(tick.files) for tick in ticks]),
        classes=statistics.median_low([len(tick.classes) for tick in ticks]),
        calls=median_calls(ticks),
        depth=statistics.median_low([tick.depth for tick in ticks]),
        calls_each_further_neighbour=(many - few) / (MANY - FEW),
    )


def platoon_ticks() -> list[Tick]:
    """The counted ticks of the platoon's follower."""
    return count_ticks(load_scenario(PLATOON, [f"timeline[3].for_s={SETTLING_S}"]))


def main(arguments: list[str]) -> int:
    """The exit code."""
    if "--stages" in arguments:
        print(stages.text())
        return 0
    ticks = platoon_ticks()
    if "--json" not in arguments:
        print(stages.diagram(ticks[0].stages))
    print(json.dumps(asdict(figures_of(ticks)), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
