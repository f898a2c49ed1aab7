"""Scenarios for the tests of batches: the platoon of the example file, with overrides."""

from __future__ import annotations

from functools import cache

from repository import ROOT
from sitl.flight.scenario import Scenario, load_scenario

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"


@cache
def platoon(*overrides: str) -> Scenario:
    return load_scenario(PLATOON, overrides)
