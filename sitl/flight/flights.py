"""From a scenario file to a folder of results, under one law or several. How each flight is flown is an argument."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from companion.config.file import ConfigError
from companion.config.fleet import LawName
from companion.types.commands import CommandName
from sitl.errors import EXIT_DONE, EXIT_FAILED
from sitl.flight.convergence import DivergesError, check_convergence
from sitl.flight.options import RunOptions
from sitl.flight.results import FlightResult
from sitl.flight.scenario import Scenario, load_scenario, with_law
from sitl.report.compare import compare, in_a_table, write_comparison
from sitl.report.folder import open_folder
from sitl.report.summary import Summary, in_words
from sitl.stopping import StopRequest

FlyOnce = Callable[[Scenario, str, Path, StopRequest], FlightResult]  # scenario, its name, the folder for the results
Prepare = Callable[[Scenario], AbstractContextManager[FlyOnce]]


def run_flights(options: RunOptions, prepare: Prepare) -> int:
    """Fly as the options require; returns the exit code. Raises the errors that sitl/cli/ending.py reports.

    `prepare` reserves what the flights need, before anything is written or flown; it may raise ConfigError or
    PortInUseError.
    """
    with StopRequest("stopped at once; the vehicles were not landed") as stop:
        scenario = load_scenario(options.scenario, options.overrides)
        scenarios = [with_law(scenario, law) for law in _laws(scenario, options)]
        warnings = _convergence_warnings(scenarios, options.anyway)
        name = options.scenario.stem
        stem = f"{name}-{scenario.fleet.law.name}"
        with prepare(scenario) as fly_once, open_folder(options.out, stem) as folder:
            if not options.quiet:
                print("".join(f"warning, {warning}\n" for warning in warnings), end="", flush=True)
            if options.others is None:
                return _fly_one(scenario, name, folder, fly_once, stop)
            return _fly_laws(scenarios, name, folder, fly_once, stop)


def _laws(scenario: Scenario, options: RunOptions) -> list[LawName]:
    """The scenario's own law, then the others. Raises ConfigError."""
    own = scenario.fleet.law.name
    if options.others is not None and all(step.command is not CommandName.FORM for step in scenario.timeline):
        raise ConfigError(
            options.scenario, "timeline", "has no step with command: form, so --compare has nothing to compare"
        )
    return [own, *(law for law in options.others or () if law != own)]


def _convergence_warnings(scenarios: list[Scenario], anyway: bool) -> list[str]:
    """About the formation under each law, one line each. Raises DivergesError, but not with `anyway`."""
    warnings = []
    for scenario in scenarios:
        law = scenario.fleet.law.name
        try:
            warnings += [f"{law}: {notice}" for notice in check_convergence(scenario)]
        except DivergesError as error:
            if not anyway:
                raise
            warnings.append(f"{law}: {error}")
    return warnings


def _fly_one(scenario: Scenario, name: str, folder: Path, fly_once: FlyOnce, stop: StopRequest) -> int:
    result = fly_once(scenario, name, folder, stop)
    print(f"{in_words(result.summary)}\nresults in {folder}")
    return stop.exit_code if stop.number else _exit_code(result.summary)


def _fly_laws(scenarios: list[Scenario], name: str, folder: Path, fly_once: FlyOnce, stop: StopRequest) -> int:
    """One flight per law, then the table and the figure.

    A law that fails in formation is part of the comparison; a flight without a formation ends it.
    """
    results: list[FlightResult] = []
    for scenario in scenarios:
        result = fly_once(scenario, name, folder / scenario.fleet.law.name, stop)
        results.append(result)
        print(in_words(result.summary) + "\n", flush=True)
        if stop.number or result.flight is None:
            print(f"results so far in {folder}")
            return stop.exit_code if stop.number else EXIT_FAILED
    comparison = compare([result.summary for result in results])
    write_comparison(folder, comparison, [result.flight for result in results if result.flight])
    print(f"{in_a_table(comparison)}\nresults in {folder}")
    return max(_exit_code(result.summary) for result in results)


def _exit_code(summary: Summary) -> int:
    return EXIT_FAILED if summary.failure else EXIT_DONE
