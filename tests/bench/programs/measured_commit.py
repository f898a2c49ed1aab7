"""Speed of the checkout that stands first on the path, which may be an older commit: `make bench AGAINST=COMMIT` starts it.

    PYTHONPATH=CHECKOUT python -P measured_commit.py SCENARIO_OF_STEP SCENARIO_OF_LOCKSTEP...

For each line of its input, `step` or `lockstep`, it measures once and prints one line of JSON: figures by name. It imports
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


def module_of(name: str, package: str) -> ModuleType:
    """The module below `package` that defines this name. Raises LookupError."""
    for found in walk_packages(import_module(package).__path__, f"{package}."):
        module = import_module(found.name)
        if getattr(getattr(module, name, None), "__module__", "") == module.__name__:
            return module
    raise LookupError(f"{package}: nothing defines {name}")


FLIGHT = module_of("fly_in_virtual_time", "sitl.flight")
LOCKSTEP = module_of("Lockstep", "sitl.flight")
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
        self._build, self._arguments = LOCKSTEP.build_agent, ((), {})  # type: ignore[var-annotated]
        self.ticks: list[tuple[float, Any]] = []
        LOCKSTEP.build_agent = self._built  # type: ignore[attr-defined]
        try:
            fly(scenario)
        finally:
            LOCKSTEP.build_agent = self._build  # type: ignore[attr-defined]

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
    step, *lockstep = map(Path, sys.argv[1:])
    inputs: Inputs | None = None
    for line in sys.stdin:
        if line.strip() == "step":
            inputs = inputs or Inputs(step)
            figures = {step.stem: step_us(inputs)}
        else:
            figures = {scenario.stem: rate_1_s(scenario) for scenario in lockstep}
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
