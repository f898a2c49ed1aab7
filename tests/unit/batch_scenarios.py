"""Scenarios for the tests of batches: the platoon of the example file with overrides."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from sitl.scenario import Scenario, load_scenario

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"


@cache
def platoon(*overrides: str) -> Scenario:
    return load_scenario(PLATOON, overrides)
