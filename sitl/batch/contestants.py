"""The models that sitl.batch.benchmark compares, as functions that advance N vehicles by one step of DT_S.

Every model tracks a given attitude and thrust with controller, motor lag and rigid body. RotorPy models four rotors, ours one
thrust and three moments. RotorPy's rotor drag has rows of its own, because it takes time and our drag is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from sitl.autopilots.autopilot import DT_S
from sitl.batch.attitude_loops import AttitudeLoops
from sitl.batch.bodies import ATTITUDE, RATES, Bodies, RungeKutta
from sitl.batch.columns import columns_of
from sitl.batch.simulation import Simulation, starts_at_rest
from sitl.flight.scenario import Scenario
from sitl.vehicle.config import Airframe

Step = Callable[[], None]
LEAN = np.array([0.9990482, 0.0, 0.0436194, 0.0])  # quaternion of a pitch of 5 degrees, w x y z


def ours(count: int, runge_kutta: bool) -> Step:
    """AttitudeLoops and Bodies, as in every step of a batch."""
    bodies = Bodies([Airframe()], np.zeros(count, dtype=np.int64))
    loops = AttitudeLoops(bodies.inertia_kg_m2)
    integrator = RungeKutta(bodies) if runge_kutta else bodies
    state = bodies.at_rest(np.zeros((3, count)), np.zeros((3, count)))
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
