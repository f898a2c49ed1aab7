"""What is to be flown: --vary's values, every combination of them, and the scenario of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path

import yaml

from companion.config.reference import TargetReference
from companion.config_file import ConfigError, StrictLoader
from companion.types import AutopilotKind, CommandName
from sitl.scenario import Scenario, load_scenario
from sitl.sweep.options import MAX_FLIGHTS, SHORTEST_S

Value = bool | int | float | str

VARY = "--vary"
EXAMPLE = "fleet.law.exponent=0,1,2"
SEED, TIMELINE = "stand_in.seed", "timeline"


@dataclass(frozen=True, slots=True)
class Choice:
    """One value of a varied key, and as it was written."""

    text: str
    value: Value


@dataclass(frozen=True, slots=True)
class Axis:
    """One --vary."""

    key: str
    choices: tuple[Choice, ...]

    @property
    def is_numeric(self) -> bool:
        """Does it make sense as the axis of a figure?"""
        return len(self.choices) > 1 and all(type(choice.value) in (int, float) for choice in self.choices)


@dataclass(frozen=True, slots=True)
class Point:
    """One combination: a choice of each axis, in the order of the axes, and the scenario that it makes."""

    choices: tuple[Choice, ...]
    scenario: Scenario


def axis_of(argument: str) -> Axis:
    """ "links.peer_loss=0,0.1" -> Axis. Raises ConfigError; what the values mean shows when scenarios are made."""
    key, equals, text = argument.partition("=")
    if not equals or not key:
        raise ConfigError(VARY, argument, f"expected KEY=V1,V2,..., like {EXAMPLE}")
    if key == SEED:
        raise ConfigError(VARY, key, "every combination flies with seeds 1 to N; use --seeds N")
    if key.startswith(TIMELINE):
        raise ConfigError(VARY, key, "a sweep flies the formation alone, not the timeline; use --seconds S")
    if any(bracket in text for bracket in "[]{}"):
        raise ConfigError(
            VARY, argument, "lists and mappings cannot be varied; vary an item (KEY[0]=V1,V2), or --set the whole"
        )
    choices = tuple(_choice(key, part.strip()) for part in text.split(","))
    values = [choice.value for choice in choices]
    for place, choice in enumerate(choices):
        if choice.value in values[:place]:
            raise ConfigError(VARY, key, f"{choice.text} stands twice; expected different values")
    return Axis(key, choices)


def _choice(key: str, text: str) -> Choice:
    if not text:
        raise ConfigError(VARY, key, f"has an empty value; expected values with commas between them, like {EXAMPLE}")
    try:
        value = yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise ConfigError(VARY, key, f"{text!r} is not a YAML value") from error
    if not isinstance(value, bool | int | float | str):
        raise ConfigError(VARY, key, f"{text!r}: expected a number or a word")
    return Choice(text, value)


def axes_of(arguments: Sequence[str], seeds: int) -> list[Axis]:
    """All --vary. Raises ConfigError, also where they would make too many flights."""
    axes = [axis_of(argument) for argument in arguments]
    keys = [axis.key for axis in axes]
    for place, key in enumerate(keys):
        if key in keys[:place]:
            raise ConfigError(VARY, key, "is given twice; list all its values in one --vary")
    flights = prod(len(axis.choices) for axis in axes) * seeds
    if flights > MAX_FLIGHTS:
        sizes = " x ".join([*(str(len(axis.choices)) for axis in axes), f"{seeds} seeds"])
        raise ConfigError(VARY, " ".join(keys), f"{sizes} are {flights} flights; expected {MAX_FLIGHTS} at most")
    return axes


def base_scenario(path: Path, overrides: Sequence[str]) -> Scenario:
    """What all combinations have in common. Raises ConfigError."""
    for override in overrides:
        if override.partition("=")[0] == SEED:
            raise ConfigError("--set", SEED, "every combination flies with seeds 1 to N; use --seeds N")
    return _as_batches_fly(path, load_scenario(path, overrides))


def _as_batches_fly(path: Path, scenario: Scenario) -> Scenario:
    """Batches have PX4's loops alone, nothing to follow, and slots that stand. Raises ConfigError."""
    if scenario.stand_in.autopilot is not AutopilotKind.PX4:
        raise ConfigError(
            path, "stand_in.autopilot", f'"{scenario.stand_in.autopilot}": sweeps fly px4 alone; try sitl run'
        )
    if isinstance(scenario.reference, TargetReference):
        raise ConfigError(path, "reference.kind", '"target": sweeps have nothing that could be followed; try sitl run')
    if scenario.fleet.slots_turn:
        raise ConfigError(path, "fleet.formation_heading", '"course": sweeps turn no formation; try sitl run')
    return scenario


def formation_time_s(path: Path, scenario: Scenario) -> float:
    """How long the scenario's own timeline stays in formation. Raises ConfigError."""
    for step in scenario.timeline:
        if step.command is CommandName.FORM:
            if step.for_s < SHORTEST_S:
                problem = f"its form step has for_s: {step.for_s:g}; expected {SHORTEST_S:g} or more, or --seconds S"
                raise ConfigError(path, TIMELINE, problem)
            return step.for_s
    raise ConfigError(path, TIMELINE, "has no step with command: form; say with --seconds S how long to fly")


def points_of(
    path: Path, overrides: Sequence[str], axes: Sequence[Axis], told: Callable[[int, int], None]
) -> list[Point]:
    """Every combination, the last axis the fastest. `told` hears how many of how many are made. Raises ConfigError."""
    combinations = list(product(*(axis.choices for axis in axes)))
    points = []
    for number, choices in enumerate(combinations):
        told(number, len(combinations))
        points.append(Point(choices, _scenario(path, overrides, axes, choices)))
    return points


def _scenario(path: Path, overrides: Sequence[str], axes: Sequence[Axis], choices: tuple[Choice, ...]) -> Scenario:
    own = [f"{axis.key}={choice.text}" for axis, choice in zip(axes, choices, strict=True)]
    try:
        return _as_batches_fly(path, load_scenario(path, [*overrides, *own]))
    except ConfigError as error:
        for one in own:
            _try_alone(path, overrides, one)
        raise _of_vary(own, error) from error


def _try_alone(path: Path, overrides: Sequence[str], own: str) -> None:
    """Which of several values is to blame: whichever cannot be used without the others, either."""
    try:
        _as_batches_fly(path, load_scenario(path, [*overrides, own]))
    except ConfigError as error:
        raise _of_vary([own], error) from error


def _of_vary(own: Sequence[str], error: ConfigError) -> ConfigError:
    together = " with ".join(f"{VARY} {one}" for one in own)
    return ConfigError(together, "", str(error).removeprefix("--set: "))
