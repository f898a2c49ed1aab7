"""The worst flights of a gauntlet as scenario files that `sitl run` flies again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import yaml

from companion.config.fleet import FleetConfig
from sitl.gauntlet.distances import SENSOR_FACTOR
from sitl.gauntlet.drawn import drawn
from sitl.gauntlet.fleets import SensorsName
from sitl.gauntlet.flight import FlightOutcome

KEPT = 10


def write_worst(
    folder: Path, outcomes: Sequence[FlightOutcome], sensors: SensorsName | None, own: FleetConfig | None
) -> list[str]:
    """Write a scenario file for each of the KEPT flights nearest to a violation, and those with an exception.

    Returns a line for each of them.
    """
    lines = []
    for outcome in worst_of(outcomes):
        scenario = drawn(outcome.seed, outcome.number, sensors, own).scenario
        path = folder / f"{outcome.family}_{outcome.number}.yaml"
        content = yaml.safe_dump(msgspec.to_builtins(scenario), sort_keys=False)
        path.write_text(f"# {in_a_line(outcome)}\n{content}", encoding="utf-8")
        if outcome.exception:
            path.with_suffix(".txt").write_text(outcome.exception, encoding="utf-8")
        lines.append(f"{in_a_line(outcome)}: sitl run {path}")
    return lines


def worst_of(outcomes: Sequence[FlightOutcome]) -> list[FlightOutcome]:
    """Flights with an exception first, then those with the smallest ratio for their sensors."""
    failed = [outcome for outcome in outcomes if outcome.exception]
    ranked = sorted((o for o in outcomes if o.ratio is not None), key=_share_of_limit)
    return [*failed, *ranked][:KEPT]


def _share_of_limit(outcome: FlightOutcome) -> float:
    assert outcome.ratio is not None
    return outcome.ratio / SENSOR_FACTOR[outcome.sensors]


def in_a_line(outcome: FlightOutcome) -> str:
    """The flight, and what was worst in it."""
    name = f"flight {outcome.number}, {outcome.family}, {outcome.law}, {outcome.autopilot}, {outcome.sensors}"
    if outcome.exception:
        return f"{name}: exception {outcome.exception.strip().splitlines()[-1]}"
    closest = outcome.distances.commanded if outcome.distances else None
    if closest is None:
        return name
    return (
        f"{name}: vehicles {closest.vehicles[0]} and {closest.vehicles[1]} {closest.distance_m:.2f} m apart at"
        f" {closest.time_s:.1f} s, separation_m {outcome.separation_m:g}"
    )
