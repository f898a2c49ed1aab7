"""Values of --vary and --set: other values of keys of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import yaml
from msgspec import to_builtins

from companion.config.file import SET, ConfigError, StrictLoader, override
from companion.types.values import quoted
from sitl.flight.scenario import Scenario, scenario_from

Value = bool | int | float | str

VARY = "--vary"
EXAMPLE = "fleet.law.parameters.exponent=0,1,2"
SEED, TIMELINE = "stand_in.seed", "timeline"
OWN_SEEDS = "a comparison sets the seeds itself, 1 to N; use --seeds N"


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


def axis_of(argument: str) -> Axis:
    """ "links.peer_loss=0,0.1" -> Axis. Raises ConfigError for bad syntax; loading the scenarios checks the values."""
    key, equals, text = argument.partition("=")
    if not equals or not key:
        raise ConfigError(VARY, argument, f"expected KEY=V1,V2,..., like {EXAMPLE}")
    if key == SEED:
        raise ConfigError(VARY, key, OWN_SEEDS)
    if key.startswith(TIMELINE):
        raise ConfigError(VARY, key, "a comparison has its own timeline; use --seconds S")
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


def axes_of(arguments: Sequence[str]) -> list[Axis]:
    """The axes of all --vary. Raises ConfigError."""
    axes = [axis_of(argument) for argument in arguments]
    keys = [axis.key for axis in axes]
    for index, key in enumerate(keys):
        if key in keys[:index]:
            raise ConfigError(VARY, key, "is given twice; list all its values in one --vary")
    return axes


def checked(overrides: Sequence[str]) -> list[str]:
    """The overrides, none of which is of a seed. Raises ConfigError."""
    for line in overrides:
        if line.partition("=")[0] == SEED:
            raise ConfigError(SET, SEED, OWN_SEEDS)
    return list(overrides)


def changed(scenario: Scenario, overrides: Sequence[str], own: Sequence[str]) -> Scenario:
    """The scenario with other values by key, checked as a whole; `own` are those of --vary. Raises ConfigError."""
    try:
        return _changed(scenario, [*overrides, *own])
    except ConfigError as error:
        if not own:
            raise
        _changed(scenario, overrides)  # raises where --set is the problem
        for one in own:
            _try_alone(scenario, overrides, one)
        raise _of_vary(own, error) from error


def _changed(scenario: Scenario, lines: Sequence[str]) -> Scenario:
    return scenario_from(SET, override(to_builtins(scenario), lines, EXAMPLE)) if lines else scenario


def _try_alone(scenario: Scenario, overrides: Sequence[str], own: str) -> None:
    """Raise ConfigError where this value alone is the problem."""
    try:
        _changed(scenario, [*overrides, own])
    except ConfigError as error:
        raise _of_vary([own], error) from error


def _of_vary(own: Sequence[str], error: ConfigError) -> ConfigError:
    combination = " with ".join(f"{VARY} {one}" for one in own)
    return ConfigError.of([ConfigError(combination, "", line.removeprefix("--set: ")) for line in error.lines])
