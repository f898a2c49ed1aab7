"""The example files of vehicles and fleets load and agree with each other."""

from __future__ import annotations

import argparse
from itertools import combinations
from pathlib import Path

import pytest

from common import ROOT
from companion.config.vehicle import load_agent

CONFIG = ROOT / "config"
VEHICLES = sorted((CONFIG / "vehicles").glob("*.yaml"))


@pytest.mark.parametrize("path", VEHICLES, ids=lambda path: path.stem)
def test_a_vehicle_file_loads_with_its_fleet(path: Path) -> None:
    agent = load_agent(path)
    assert path.stem.endswith(f"-{agent.vehicle.id}")


def test_every_fleet_file_is_used_by_a_vehicle() -> None:
    used = {(path.parent / load_agent(path).vehicle.fleet).resolve() for path in VEHICLES}
    assert used == {path.resolve() for path in (CONFIG / "fleets").glob("*.yaml")}


def test_the_simulated_vehicles_can_run_on_one_machine() -> None:
    simulated = [load_agent(path) for path in VEHICLES if path.stem.startswith("simulation")]
    for one, other in combinations(simulated, 2):
        assert one.vehicle.mavlink != other.vehicle.mavlink
        assert not set(one.zenoh.listen) & set(other.zenoh.listen)
        assert set(one.zenoh.connect) & set(other.zenoh.listen) or set(other.zenoh.connect) & set(one.zenoh.listen)


def test_the_monitor_connects_to_simulated_vehicles_by_default() -> None:
    from companion.ground.current_fleet import simulation_endpoints

    for path in VEHICLES:
        agent = load_agent(path)
        if path.stem.startswith("simulation"):
            assert set(agent.zenoh.listen) <= set(simulation_endpoints([agent.vehicle.id]))


def test_the_examples_in_the_help_work_in_any_folder() -> None:
    from companion.cli.main import parser as companion
    from sitl.cli.main import parser as sitl

    for program in (companion(), sitl()):
        (commands,) = (action for action in program._actions if isinstance(action, argparse._SubParsersAction))
        for name, command in commands.choices.items():
            lines = (command.epilog or "").splitlines()
            examples = [line for line in lines if line.startswith(("  companion ", "  sitl "))]
            assert not [line for line in examples if " config/" in line], name
