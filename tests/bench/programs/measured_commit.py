"""Speed of the checkout that stands first on the path, which may be an older commit: `make bench AGAINST=COMMIT` starts it.

    PYTHONPATH=CHECKOUT python -P measured_commit.py

For each line of its input, `step SCENARIO` or `lockstep SCENARIO`, it measures once and prints the figure on a line. It imports
nothing of the laboratory, and finds by name what older commits have in other modules.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from statistics import median
from types import ModuleType
from typing import Any, get_type_hints

FOLLOWER_ID = 2
PASSES = 5  # over the inputs of one flight


def module_of(name: str, package: str, defined_in: str = "") -> ModuleType:
    """The module below `package` that has this name, by default the one that defines it. Raises LookupError."""
    for found in walk_packages(import_module(package).__path__, f"{package}."):
        module = import_module(found.name)
        if getattr(getattr(module, name, None), "__module__", "") == (defined_in or module.__name__):
            return module
    raise LookupError(f"{package}: nothing has {name}")


FLIGHT = module_of("fly_in_virtual_time", "sitl.flight")
BUILDER = module_of("build_agent", "sitl.flight", "companion.assembly")
SCENARIO = module_of("load_scenario", "sitl.flight")


def fly(scenario: Path) -> Any:
    """The whole flight in virtual time. Raises RuntimeError where it fails."""
    progress = get_type_hints(FLIGHT.fly_in_virtual_time)["progress"]
    flown = FLIGHT.fly_in_virtual_time(SCENARIO.load_scenario(scenario), progress("", True, 0.0))
    if flown.failure:
        raise RuntimeError(f"{scenario}: {flown.failure}")
    return flown


class Inputs:
    """Time and inbox of each tick of the follower in one flight, and how to build its agent again."""

    def __init__(self, scenario: Path) -> None:
        self._build, self._arguments = BUILDER.build_agent, ((), {})  # type: ignore[var-annotated]
        self.ticks: list[tuple[float, Any]] = []
        BUILDER.build_agent = self._built  # type: ignore[attr-defined]
        try:
            fly(scenario)
        finally:
            BUILDER.build_agent = self._build  # type: ignore[attr-defined]

    def agent(self) -> Any:
        """A new agent of the follower, as the flight began."""
        arguments, named = self._arguments
        return self._build(*arguments, **named)

    def _built(self, config: Any, *arguments: Any, **named: Any) -> Any:
        agent = self._build(config, *arguments, **named)
        if config.vehicle.id != FOLLOWER_ID:
            return agent
        self._arguments = ((config, *arguments), named)
        return Tapped(agent, self.ticks)


class Tapped:
    """An agent whose inputs are kept."""

    def __init__(self, agent: Any, ticks: list[tuple[float, Any]]) -> None:
        self._agent, self._ticks = agent, ticks

    def __getattr__(self, name: str) -> Any:
        return getattr(self._agent, name)

    def decide(self, now_s: float, inbox: Any) -> Any:
        self._ticks.append((now_s, inbox))
        return self._agent.decide(now_s, inbox)


def step_us(inputs: Inputs) -> float:
    """The median of the ticks in formation, the least of PASSES: what else runs only adds to it."""
    return min(median(_times_us(inputs)) for _ in range(PASSES))


def _times_us(inputs: Inputs) -> list[float]:
    agent, times_us = inputs.agent(), []
    gc.collect()
    gc.freeze()  # as the agent's process does
    for now_s, inbox in inputs.ticks:
        in_formation = agent.phase.name == "FORMATION"
        began_ns = time.perf_counter_ns()
        agent.step(now_s, inbox)
        took_ns = time.perf_counter_ns() - began_ns
        if in_formation:
            times_us.append(took_ns / 1e3)
    gc.unfreeze()
    return times_us


def rate_1_s(scenario: Path) -> float:
    """Vehicle-seconds per second of CPU time over a whole flight: time in which other processes run does not count."""
    began_s = time.process_time()
    flown = fly(scenario)
    return float(len(flown.tracks()) * flown.flight_s / (time.process_time() - began_s))


def main() -> None:
    inputs: dict[str, Inputs] = {}
    for line in sys.stdin:
        what, _, scenario = line.strip().partition(" ")
        if what == "lockstep":
            figure = rate_1_s(Path(scenario))
        else:
            inputs[scenario] = inputs.get(scenario) or Inputs(Path(scenario))
            figure = step_us(inputs[scenario])
        print(json.dumps(figure), flush=True)


if __name__ == "__main__":
    main()
