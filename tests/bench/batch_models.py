"""Vehicle-steps per second of the batch and of RotorPy: python -m tests.bench.batch_models.

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
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from companion.analysis.interaction import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.batch.bodies import ATTITUDE, RATES, ROWS, AttitudeLoops, Bodies
from sitl.batch.columns import columns_of
from sitl.batch.flight import Simulation, starts_at_rest
from sitl.flight.scenario import Scenario
from sitl.vehicle.config import Airframe

PLATOON = Path("config/scenarios/platoon.yaml")
ROUNDS, ROUND_S = 5, 0.5
INSTALL = "RotorPy is not installed; pip install '.[bench]' in the project's folder, or 'rotorpy[batched]==3.0.0'"


class RungeKutta:
    """The same bodies, integrated by the classical fourth-order Runge-Kutta method."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        shape = (ROWS, bodies.hover_n.size)
        self._rate, self._between, self._sum = np.empty(shape), np.empty(shape), np.empty(shape)

    def step(self, state: FloatArray, command: FloatArray, wind_enu_m_s: FloatArray, dt_s: float) -> None:
        bodies, rate, between, total = self._bodies, self._rate, self._between, self._sum
        bodies.set_motors(state, command)
        np.copyto(total, bodies.rate_of_change(state, command, wind_enu_m_s, rate))
        for ahead_s, share in ((0.5 * dt_s, 2.0), (0.5 * dt_s, 2.0), (dt_s, 1.0)):
            np.multiply(rate, ahead_s, out=between)
            between += state
            bodies.rate_of_change(between, command, wind_enu_m_s, rate)
            np.multiply(rate, share, out=between)
            total += between
        total *= dt_s / 6.0
        state += total
        bodies.normalise(state)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.batch_models", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000, metavar="N")
    parser.add_argument("--scenario", type=Path, default=PLATOON, help="scenario of the whole formations")
    parser.add_argument("--json", action="store_true", help="vehicle-steps per second of every round, by model")
    options = parser.parse_args()
    _take_one_core()
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
        print(table(count, {name: max(rates) for name, rates in rates_1_s.items()}))
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


def table(count: int, rates_1_s: dict[str, float]) -> str:
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


Step = Callable[[], None]
LEAN = np.array([0.9990482, 0.0, 0.0436194, 0.0])  # quaternion of a pitch of 5 degrees, w x y z


def ours(count: int, runge_kutta: bool) -> Step:
    """AttitudeLoops and Bodies, as in every step of a batch."""
    bodies = Bodies([Airframe()], np.zeros(count, dtype=np.int64))
    loops = AttitudeLoops(bodies.inertia_kg_m2)
    integrator = RungeKutta(bodies) if runge_kutta else bodies
    state = bodies.hovering(*np.zeros((3, 3, count)))
    goal = np.repeat(LEAN[:, None], count, axis=1)
    command, calm = np.zeros((4, count)), np.zeros((3, 1))
    command[0] = bodies.hover_n

    def step() -> None:
        loops.moments(goal, state[ATTITUDE], state[RATES], command[1:])
        integrator.step(state, command, calm, DT_S)

    return step


def formations(scenario: Scenario, count: int) -> Step:
    """Whole formations of this scenario, with agents and packets."""
    scenarios = [scenario] * (count // len(scenario.fleet.vehicles))
    return Simulation(scenarios, columns_of(scenarios), starts_at_rest(scenarios)).step


def rotorpy(count: int, integrator: str, aero: bool) -> Step:
    """RotorPy's BatchedMultirotor under `cmd_ctatt`. Raises ImportError where it or torch is missing.

    Its constructor accepts rk4 and dopri5 only; torchdiffeq, which gets the name, also has euler.
    """
    torch: Any = import_module("torch")
    import_module("torchdiffeq")
    import_module("roma")
    multirotor: Any = import_module("rotorpy.vehicles.multirotor")
    quad_params: Any = import_module("rotorpy.vehicles.crazyflie_params").quad_params
    torch.set_num_threads(1)
    device = torch.device("cpu")
    parameters = multirotor.BatchedMultirotorParams([quad_params] * count, count, device)
    state = _at_rest(torch, quad_params, count)
    vehicles = multirotor.BatchedMultirotor(
        parameters, count, state, device, control_abstraction="cmd_ctatt", aero=aero, integrator="rk4"
    )
    vehicles.integrator = integrator
    lean = torch.tensor([*LEAN[1:], LEAN[0]]).double()  # x y z w
    weight_n = quad_params["mass"] * parameters.g
    control = {"cmd_q": lean.repeat(count, 1), "cmd_thrust": torch.full((count, 1), weight_n).double()}
    indices = np.arange(count)  # a list, the default, is slower

    def step() -> None:
        nonlocal state
        state = vehicles.step(state, control, DT_S, indices)

    return step


def _at_rest(torch: Any, quad_params: dict[str, Any], count: int) -> dict[str, Any]:
    hover_rad_s = float(np.sqrt(quad_params["mass"] * 9.81 / 4.0 / quad_params["k_eta"]))
    state = {name: torch.zeros(count, 3).double() for name in ("x", "v", "w", "wind")}
    state["q"] = torch.tensor([0.0, 0.0, 0.0, 1.0]).double().repeat(count, 1)
    state["rotor_speeds"] = torch.full((count, 4), hover_rad_s).double()
    return state


if __name__ == "__main__":
    sys.exit(main())
