"""Vehicle-steps per second of the batch and of RotorPy: python -m sitl.batch.benchmark.

One core, one thread, the same step, states in double precision. Each figure is the best of a few rounds. The models take turns,
so that other load on the machine affects all of them. With --json the rates of all rounds are printed, by model.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

PLATOON = Path("config/scenarios/platoon.yaml")
ROUNDS, ROUND_S = 5, 0.5
INSTALL = "RotorPy is not installed; pip install '.[bench]' in the project's folder, or 'rotorpy[batched]==3.0.0'"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m sitl.batch.benchmark", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000, metavar="N")
    parser.add_argument("--scenario", type=Path, default=PLATOON, help="scenario of the whole formations")
    parser.add_argument("--json", action="store_true", help="vehicle-steps per second of every round, by model")
    options = parser.parse_args()
    _take_one_core()
    from sitl.batch.contestants import formations, ours, rotorpy  # numpy reads the number of threads when it is loaded
    from sitl.flight.scenario import load_scenario

    count: int = options.vehicles
    scenario = load_scenario(options.scenario)
    try:
        contestants = {
            "vehicle model, Euler": ours(count, runge_kutta=False),
            "vehicle model, RK4": ours(count, runge_kutta=True),
            "whole formations": formations(scenario, count),
            "RotorPy, Euler, no drag": rotorpy(count, "euler", aero=False),
            "RotorPy, Euler": rotorpy(count, "euler", aero=True),
            "RotorPy, RK4, no drag": rotorpy(count, "rk4", aero=False),
            "RotorPy, RK4": rotorpy(count, "rk4", aero=True),
        }
    except ImportError:
        print(INSTALL, file=sys.stderr)
        return 2
    rates_1_s = rates_of_rounds_1_s(contestants)
    if options.json:
        print(json.dumps({name: [rate * count for rate in rates] for name, rates in rates_1_s.items()}))
    else:
        print(_table(count, {name: max(rates) for name, rates in rates_1_s.items()}))
    return 0


def rates_of_rounds_1_s(contestants: dict[str, Callable[[], None]]) -> dict[str, list[float]]:
    """Steps per second in each of ROUNDS rounds in which all take turns."""
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(ROUNDS):
        for name, step in contestants.items():
            rates[name].append(_rate_1_s(step))
    return rates


def _rate_1_s(step: Callable[[], None]) -> float:
    step()
    began_s = time.perf_counter()
    steps = 0
    while (elapsed_s := time.perf_counter() - began_s) < ROUND_S:
        step()
        steps += 1
    return steps / elapsed_s


def _table(count: int, rates_1_s: dict[str, float]) -> str:
    """Our models beside RotorPy's with the same integrator; RotorPy is fastest without drag."""
    lines = [f"{count} vehicles, one core, steps of 4 ms; million vehicle-steps per second"]
    lines += [f"  {name:26} {rate * count / 1e6:8.3f}" for name, rate in rates_1_s.items()]
    lines.append("ratio")
    for order in ("Euler", "RK4"):
        for theirs in (f"RotorPy, {order}, no drag", f"RotorPy, {order}"):
            ratio = rates_1_s[f"vehicle model, {order}"] / rates_1_s[theirs]
            lines.append(f"  {f'vehicle model, {order} : {theirs}':52} {ratio:6.1f}")
    ratio = rates_1_s["whole formations"] / rates_1_s["RotorPy, Euler, no drag"]
    lines.append(f"  {'whole formations : RotorPy, Euler, no drag':52} {ratio:6.1f}")
    return "\n".join(lines)


def _take_one_core() -> None:
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


if __name__ == "__main__":
    sys.exit(main())
