"""The cells of a comparison, and the scenario of each of their flights: law by graph by condition by values of --vary."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from random import Random

import yaml
from msgspec.structs import replace

from companion.config.file import ConfigError, StrictLoader, refuse
from companion.config.law import PYTHON, LawSection, law_names, law_problems
from companion.config.reference import TargetReference
from companion.config.validation import did_you_mean
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.values import quoted
from sitl.compare.conditions import CONDITIONS, Condition
from sitl.compare.graphs import GRAPHS
from sitl.compare.options import (
    DEFAULT_CONDITIONS,
    DEFAULT_GRAPHS,
    DEFAULT_LAWS,
    DEFAULT_S,
    DEFAULT_VEHICLES,
    MAX_FLIGHTS,
    SHORTEST_S,
    CompareOptions,
)
from sitl.compare.vary import axes_of, changed, checked
from sitl.flight.files import ids_of
from sitl.flight.scenario import Scenario, load_scenario
from sitl.vehicle.config import Sensors

LOCKSTEP_SEED = 1
LAWS, PARAMETERS = "--laws", ":"


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """What laws are compared in: a graph, its number of vehicles, a condition, and the values of --vary."""

    graph: str
    vehicles: int
    condition: str
    varied: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """ "chain 16, noise, links.peer_loss=0.1"."""
        return ", ".join([f"{self.graph} {self.vehicles}", self.condition, *self.varied])

    @property
    def panel(self) -> str:
        """ "noise, peer_loss=0.1": of the varied keys the ends that tell them apart."""
        pairs = [varied.split("=", 1) for varied in self.varied]
        ends = {key: _end(key, [other for other, _ in pairs if other != key]) for key, _ in pairs}
        return ", ".join([self.condition, *(f"{ends[key]}={value}" for key, value in pairs)])


def _end(key: str, others: Sequence[str]) -> str:
    """The shortest end of a key that no other key has."""
    parts = key.split(".")
    ends = (".".join(parts[-count:]) for count in range(1, len(parts)))
    return next((end for end in ends if not any(f".{other}".endswith(f".{end}") for other in others)), key)


@dataclass(frozen=True, slots=True)
class Cell:
    """One law in one place."""

    law: str
    place: Place


@dataclass(frozen=True, slots=True)
class CellFlight:
    """One flight of a cell. `repeats`: without random errors; `by_agents`: a batch cannot fly it."""

    cell: Cell
    seed: int
    scenario: Scenario
    repeats: bool
    by_agents: bool


@dataclass(frozen=True, slots=True)
class Plan:
    """All flights, in the order of cells and seeds.

    `check` are flights of a batch that the agents fly as well; `settings`: those of --set, of all flights.
    """

    laws: dict[str, LawSection]
    flights: list[CellFlight]
    check: list[CellFlight]
    settings: list[str]
    seeds: int
    seconds: float


def plan_of(options: CompareOptions, progress: Callable[[float], None]) -> Plan:
    """Make and check all scenarios. Calls `progress` with the share done. Raises ConfigError."""
    source = load_scenario(options.scenario) if options.scenario else None
    seconds = options.seconds or (DEFAULT_S if source is None else _form_s(str(options.scenario), source))
    laws, places = _laws(options, source), _places(options, source)
    count = len(laws) * len(places) * options.seeds
    if count > MAX_FLIGHTS:
        raise ConfigError("sitl compare", "", f"{count} flights; expected at most {MAX_FLIGHTS}")
    overrides = checked(options.overrides)
    cells: dict[Cell, list[CellFlight]] = {Cell(law, place): [] for place, law in product(places, laws)}
    for number, (place, seed) in enumerate(product(places, range(1, options.seeds + 1))):
        progress(number * len(laws) / count)
        made = source if source is not None else _generated(place, seed)
        condition = CONDITIONS[place.condition]
        made = condition.of(_lasting(replace(made, stand_in=replace(made.stand_in, seed=seed)), seconds))
        for law, section in laws.items():
            scenario = replace(made, fleet=replace(made.fleet, law=section))
            scenario = changed(scenario, overrides, place.varied)
            cells[Cell(law, place)].append(_planned(Cell(law, place), seed, scenario, condition))
    flights = [flight for own in cells.values() for flight in own]
    return Plan(laws, flights, _to_check(flights, options.lockstep), overrides, options.seeds, seconds)


def _laws(options: CompareOptions, source: Scenario | None) -> dict[str, LawSection]:
    """By label. Raises ConfigError."""
    base = (
        LawSection(disturbance_bandwidth_1_s=0.0, velocity_correction_1_s=0.0) if source is None else source.fleet.law
    )
    if source is not None and not options.laws:
        return {base.name: base}
    laws = {}
    for text in options.laws or DEFAULT_LAWS:
        label, section = law_of_text(text, base)
        if label in laws:
            raise ConfigError(LAWS, label, "is listed twice; expected different laws")
        laws[label] = section
    return laws


def _places(options: CompareOptions, source: Scenario | None) -> list[Place]:
    """All combinations; the last --vary varies fastest. Raises ConfigError."""
    graphs: Sequence[str]
    sizes: Sequence[int]
    usual: Sequence[str]
    if source is None:
        graphs = _named("--graphs", options.graphs or DEFAULT_GRAPHS, GRAPHS)
        sizes, usual = options.vehicles or DEFAULT_VEHICLES, DEFAULT_CONDITIONS
    else:
        if options.graphs or options.vehicles:
            raise ConfigError("--graphs, --vehicles", "", "a scenario has its own graph and vehicles; take them out")
        assert options.scenario is not None
        graphs, sizes, usual = [options.scenario.stem], [len(source.fleet.vehicles)], ("ideal",)
    conditions = _named("--conditions", options.conditions or usual, CONDITIONS)
    axes = axes_of(options.varied)
    varied = [
        tuple(f"{axis.key}={choice.text}" for axis, choice in zip(axes, choices, strict=True))
        for choices in product(*(axis.choices for axis in axes))
    ]
    return [Place(*of) for of in product(graphs, sizes, conditions, varied)]


def law_of_text(text: str, base: LawSection) -> tuple[str, LawSection]:
    """ "weighted:exponent=2" or "my_law.py" -> its label and section, with the other settings of `base`. Raises ConfigError."""
    name, *parts = text.split(PARAMETERS)
    if not name.endswith(PYTHON) and name not in law_names():
        text = f"expected one of {', '.join(law_names())}, or the path of a Python file with a law"
        raise ConfigError(LAWS, name, text + did_you_mean(name, law_names()))
    section = base.with_name(name)
    parameters = dict(_parameter(text, part) for part in parts)
    section = replace(section, parameters=section.parameters | parameters)
    refuse(f"{LAWS} {text}", law_problems(section, "law"))
    return " ".join([section.name, *parts]), section


def _parameter(text: str, part: str) -> tuple[str, bool | int | float | str]:
    key, equals, value = part.partition("=")
    if not equals or not value:
        raise ConfigError(LAWS, text, "expected NAME:KEY=VALUE, like weighted:exponent=2")
    try:
        return key, yaml.load(value, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise ConfigError(LAWS, text, f"{quoted(value)} is not a YAML value") from error


def _named(option: str, names: Sequence[str], registry: Mapping[str, object]) -> Sequence[str]:
    """The names, all of which are in the registry. Raises ConfigError."""
    for name in names:
        if name not in registry:
            raise ConfigError(option, name, f"expected some of {', '.join(registry)}{did_you_mean(name, registry)}")
    return list(dict.fromkeys(names))


def _generated(place: Place, seed: int) -> Scenario:
    try:
        return GRAPHS[place.graph].scenario(place.vehicles, seed)
    except ValueError as error:
        raise ConfigError("--graphs", place.graph, f"{error}; choose fewer vehicles") from error


def _form_s(path: str, scenario: Scenario) -> float:
    """Duration of the form step in the scenario's timeline. Raises ConfigError."""
    for step in scenario.timeline:
        if step.command is CommandName.FORM and step.for_s >= SHORTEST_S:
            return step.for_s
    raise ConfigError(
        path, "timeline", f"no form step with for_s of {SHORTEST_S:g} or more; set the duration with --seconds S"
    )


def _lasting(scenario: Scenario, seconds: float) -> Scenario:
    """With a timeline up to its `form`, which lasts so long."""
    steps = list(scenario.timeline)
    forms = next((index for index, step in enumerate(steps) if step.command is CommandName.FORM), len(steps))
    if forms == len(steps):
        return scenario
    return replace(scenario, timeline=(*steps[:forms], replace(steps[forms], for_s=seconds)))


def _planned(cell: Cell, seed: int, scenario: Scenario, condition: Condition) -> CellFlight:
    by_agents = condition.by_agents or not _in_a_batch(scenario)
    return CellFlight(cell, seed, scenario, _repeats(scenario), by_agents)


def _repeats(scenario: Scenario) -> bool:
    """Whether nothing in it is random."""
    exact, links = all(scenario.stand_in_of(i).sensor_model() == Sensors() for i in ids_of(scenario)), scenario.links
    random = (scenario.stand_in.wind.gust_sd_m_s, links.peer_loss, links.peer_jitter_s, links.peer_duplicates)
    return exact and not any(random)


def _in_a_batch(scenario: Scenario) -> bool:
    """Whether a batch can fly it: PX4's attitude loops, vehicles that are alike, no targets, fixed slots."""
    all_px4 = scenario.stand_in.autopilot is AutopilotKind.PX4 and not scenario.stand_in.vehicles
    return all_px4 and not isinstance(scenario.reference, TargetReference) and not scenario.fleet.slots_turn


def _to_check(flights: Sequence[CellFlight], count: int) -> list[CellFlight]:
    """The first flight of so many cells, evenly chosen among those of a batch."""
    first = [one for one in flights if one.seed == 1 and not one.by_agents]
    count, begin = min(count, len(first)), Random(LOCKSTEP_SEED).random()
    return [first[int((k + begin) * len(first) / count)] for k in range(count)]
