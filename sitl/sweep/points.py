"""The points of a sweep: values of --vary, all their combinations, and the scenario of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path

import yaml

from companion.config.file import ConfigError, StrictLoader
from companion.config.reference import TargetReference
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.values import quoted
from sitl.flight.scenario import Scenario, load_scenario
from sitl.sweep.options import MAX_FLIGHTS, SHORTEST_S

Value = bool | int | float | str

VARY = "--vary"
EXAMPLE = "fleet.law.parameters.exponent=0,1,2"
SEED, TIMELINE = "stand_in.seed", "timeline"


@dataclass(frozen=True, slots=True)
class Choice:
    """One value of a varied key, and its text on the command line."""

    text: str
    value: Value


@dataclass(frozen=True, slots=True)
class Axis:
    """One --vary."""

    key: str
    choices: tuple[Choice, ...]

    @property
    def is_numeric(self) -> bool:
        """Whether the key can be the axis of a plot."""
        return len(self.choices) > 1 and all(type(choice.value) in (int, float) for choice in self.choices)


@dataclass(frozen=True, slots=True)
class Point:
    """One combination: a choice of each axis, in the order of the axes, and its scenario."""

    choices: tuple[Choice, ...]
    scenario: Scenario


def axis_of(argument: str) -> Axis:
    """ "links.peer_loss=0,0.1" -> Axis. Raises ConfigError for bad syntax; loading the scenarios checks the values."""
    key, equals, text = argument.partition("=")
    if not equals or not key:
        raise ConfigError(VARY, argument, f"expected KEY=V1,V2,..., like {EXAMPLE}")
    if key == SEED:
        raise ConfigError(VARY, key, "a sweep sets the seeds itself, 1 to N; use --seeds N")
    if key.startswith(TIMELINE):
        raise ConfigError(VARY, key, "a sweep does not fly the timeline; use --seconds S")
    if any(bracket in text for bracket in "[]{}"):
        raise ConfigError(
            VARY, argument, "lists and mappings cannot be varied; vary an item (KEY[0]=V1,V2), or --set the whole"
        )
    choices = tuple(_choice(key, part.strip()) for part in text.split(","))
    values = [choice.value for choice in choices]
    for index, choice in enumerate(choices):
        if choice.value in values[:index]:
            raise ConfigError(VARY, key, f"{choice.text} is listed twice; expected different values")
    return Axis(key, choices)


def _choice(key: str, text: str) -> Choice:
    if not text:
        raise ConfigError(VARY, key, f"has an empty value; expected values separated by commas, like {EXAMPLE}")
    try:
        value = yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise ConfigError(VARY, key, f"{quoted(text)} is not a YAML value") from error
    if not isinstance(value, bool | int | float | str):
        raise ConfigError(VARY, key, f"{quoted(text)}: expected a number, true, false or a string")
    return Choice(text, value)


def axes_of(arguments: Sequence[str], seeds: int) -> list[Axis]:
    """The axes of all --vary. Raises ConfigError, also for more than MAX_FLIGHTS flights."""
    axes = [axis_of(argument) for argument in arguments]
    keys = [axis.key for axis in axes]
    for index, key in enumerate(keys):
        if key in keys[:index]:
            raise ConfigError(VARY, key, "is given twice; list all its values in one --vary")
    flights = prod(len(axis.choices) for axis in axes) * seeds
    if flights > MAX_FLIGHTS:
        sizes = " x ".join([*(str(len(axis.choices)) for axis in axes), f"{seeds} seeds"])
        raise ConfigError(VARY, " ".join(keys), f"{sizes} are {flights} flights; expected at most {MAX_FLIGHTS}")
    return axes


def base_scenario(path: Path, overrides: Sequence[str]) -> Scenario:
    """The scenario without the varied keys. Raises ConfigError."""
    for override in overrides:
        if override.partition("=")[0] == SEED:
            raise ConfigError("--set", SEED, "a sweep sets the seeds itself, 1 to N; use --seeds N")
    return _supported(path, load_scenario(path, overrides))


def _supported(path: Path, scenario: Scenario) -> Scenario:
    """The scenario, if a batch can fly it: PX4's attitude loops, no targets, fixed slots. Raises ConfigError."""
    if scenario.stand_in.autopilot is not AutopilotKind.PX4:
        raise ConfigError(
            path, "stand_in.autopilot", f'"{scenario.stand_in.autopilot}": a sweep supports px4 only; use sitl run'
        )
    if isinstance(scenario.reference, TargetReference):
        raise ConfigError(path, "reference.kind", '"target": a sweep does not support targets; use sitl run')
    if scenario.fleet.slots_turn:
        raise ConfigError(
            path, "fleet.formation_heading", '"course": a sweep does not support turning formations; use sitl run'
        )
    return scenario


def formation_time_s(path: Path, scenario: Scenario) -> float:
    """Duration of the form step in the scenario's timeline. Raises ConfigError."""
    for step in scenario.timeline:
        if step.command is CommandName.FORM:
            if step.for_s < SHORTEST_S:
                problem = f"its form step has for_s: {step.for_s:g}; expected {SHORTEST_S:g} or more, or --seconds S"
                raise ConfigError(path, TIMELINE, problem)
            return step.for_s
    raise ConfigError(path, TIMELINE, "has no step with command: form; set the duration with --seconds S")


def points_of(
    path: Path, overrides: Sequence[str], axes: Sequence[Axis], progress: Callable[[int, int], None]
) -> list[Point]:
    """All combinations; the last axis varies fastest. Calls `progress` with number done and total. Raises ConfigError."""
    combinations = list(product(*(axis.choices for axis in axes)))
    points = []
    for number, choices in enumerate(combinations):
        progress(number, len(combinations))
        points.append(Point(choices, _scenario(path, overrides, axes, choices)))
    return points


def _scenario(path: Path, overrides: Sequence[str], axes: Sequence[Axis], choices: tuple[Choice, ...]) -> Scenario:
    own = [f"{axis.key}={choice.text}" for axis, choice in zip(axes, choices, strict=True)]
    try:
        return _supported(path, load_scenario(path, [*overrides, *own]))
    except ConfigError as error:
        for one in own:
            _try_alone(path, overrides, one)
        raise _of_vary(own, error) from error


def _try_alone(path: Path, overrides: Sequence[str], own: str) -> None:
    """Raise ConfigError where this value alone is the problem."""
    try:
        _supported(path, load_scenario(path, [*overrides, own]))
    except ConfigError as error:
        raise _of_vary([own], error) from error


def _of_vary(own: Sequence[str], error: ConfigError) -> ConfigError:
    combination = " with ".join(f"{VARY} {one}" for one in own)
    return ConfigError.of([ConfigError(combination, "", line.removeprefix("--set: ")) for line in error.lines])
