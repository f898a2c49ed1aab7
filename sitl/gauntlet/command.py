"""`sitl gauntlet`: fly random flights on all cores, keep the worst, and print the table."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from itertools import islice
from pathlib import Path

from msgspec import Struct

from companion.config.fleet import FleetConfig
from companion.config.fleet_check import load_fleet
from companion.types.errors import EXIT_DONE, EXIT_FAILED, UnusableError
from sitl.cluster import workers_of
from sitl.gauntlet.adversarial import run_search
from sitl.gauntlet.anything import SEARCHED
from sitl.gauntlet.drawing import numbers_of
from sitl.gauntlet.faults import ALL_FAMILIES
from sitl.gauntlet.flight import FlightOutcome, Job, fly
from sitl.gauntlet.rare import MISSIONS, run_rare
from sitl.gauntlet.real import REAL_FAMILIES, fly_real_flights
from sitl.gauntlet.summary import COLUMNS, MEANING, FamilySummary, cells, page, summarize, write_worst
from sitl.report.folder import results_folder, table_text
from sitl.report.progress import ShareProgress
from sitl.report.summary import write_json
from sitl.stopping import StopNow, StopRequest
from sitl.workers import POLL_S, Workers

SCHEMA = 1
STOPPED_EARLY = "stopped before the first flight was complete"


class GauntletReport(Struct, frozen=True, kw_only=True):
    """Content of gauntlet.json."""

    schema: int = SCHEMA
    seed: int
    families: list[FamilySummary]
    flights: list[FlightOutcome]


def run_gauntlet(arguments: argparse.Namespace) -> int:
    """Run the command and return the exit code. Raises what sitl/cli/main.py reports."""
    _check_options(arguments)
    if arguments.rare:
        return run_rare(
            arguments, parse_families(None if arguments.rare == "all" else arguments.rare, MISSIONS, "--rare")
        )
    if arguments.adversarial or arguments.resume:
        return run_search(arguments, parse_families(arguments.families, SEARCHED))
    own = load_fleet(arguments.fleet) if arguments.fleet else None
    if arguments.external:
        return _run_real(arguments, own)
    if arguments.binary:
        raise UnusableError("--binary: goes with --external, whose program it names")
    families = parse_families(arguments.families, ALL_FAMILIES)
    with (
        StopRequest("stopped at once; nothing was written") as stop,
        ShareProgress(arguments.quiet) as progress,
        workers_of(arguments.cluster, arguments.jobs) as workers,
    ):
        folder = results_folder(arguments.out, "gauntlet")
        numbers = list(islice(numbers_of(families), arguments.flights))
        jobs = [Job(arguments.seed, number, arguments.sensors, own) for number in numbers]
        progress.begin(f"{len(jobs)} flights")
        outcomes = _fly_all(workers, jobs, progress, stop)
        if own is not None and not any(outcome.vehicles for outcome in outcomes):
            raise UnusableError(f"{arguments.fleet}: no flight is possible: {outcomes[0].failure}")
        worst = write_worst(folder, outcomes, arguments.sensors, own)
    code = _finish(arguments, folder, outcomes, worst)
    if len(outcomes) < len(jobs):
        print(f"stopped after {len(outcomes)} of {len(jobs)} flights", file=sys.stderr)
        return stop.exit_code
    return code


# Options that would have no effect with another one.
WITHOUT_EFFECT = {
    "rare": ("adversarial", "resume", "families", "sensors", "fleet", "external", "binary", "page"),
    "resume": ("families", "sensors", "out", "fleet", "external", "binary", "page"),
    "adversarial": ("fleet", "external", "binary", "page"),
}


def _check_options(arguments: argparse.Namespace) -> None:
    """Raises UnusableError."""
    for name, others in WITHOUT_EFFECT.items():
        for other in others:
            if getattr(arguments, name) and getattr(arguments, other):
                raise UnusableError(f"--{other}: has no effect with --{name}")


def _run_real(arguments: argparse.Namespace, own: FleetConfig | None) -> int:
    """The same on real autopilots."""
    if arguments.sensors:
        raise UnusableError("--sensors: are those of the autopilots' own simulations with --external")
    families = parse_families(arguments.families, REAL_FAMILIES)
    with StopRequest("stopped at once; the vehicles were not landed") as stop:
        folder = results_folder(arguments.out, f"gauntlet-{arguments.external}")
        outcomes = fly_real_flights(arguments, families, own, folder, stop)
    if not outcomes:
        raise StopNow(STOPPED_EARLY, stop.exit_code)
    code = _finish(arguments, folder, outcomes, [])
    return stop.exit_code if stop.number else code


def parse_families(text: str | None, known: Collection[str], option: str = "--families") -> tuple[str, ...]:
    """The families named in a comma-separated list; all known ones without one. Raises UnusableError."""
    names = tuple(text.split(",")) if text else tuple(known)
    for name in names:
        if name not in known:
            raise UnusableError(f"{option}: {name!r}, expected some of {', '.join(known)}")
    return names


def _fly_all(workers: Workers, jobs: list[Job], progress: ShareProgress, stop: StopRequest) -> list[FlightOutcome]:
    """The flights that were flown: all, or fewer where a stop was requested. Raises StopNow where no flight was."""
    with workers.running(fly, jobs) as in_progress:
        while not in_progress.wait(POLL_S):
            so_far = [outcome for outcome in in_progress.results_so_far() if outcome]
            progress.show(in_progress.share_done, f"{sum(one.violation for one in so_far)} violations")
            if stop.number and so_far:
                return so_far
            if stop.number:
                raise StopNow(STOPPED_EARLY, stop.exit_code)
        return in_progress.results()


def _finish(arguments: argparse.Namespace, folder: Path, outcomes: list[FlightOutcome], worst: list[str]) -> int:
    """Write the report, print the table and return the exit code."""
    families = summarize(outcomes)
    write_json(folder / "gauntlet.json", GauntletReport(seed=arguments.seed, families=families, flights=outcomes))
    if arguments.page:
        arguments.page.write_text(page(arguments.seed, families, outcomes), encoding="utf-8")
    print(
        f"{len(outcomes)} flights with seed {arguments.seed}\n\n{table_text(COLUMNS, map(cells, families))}\n\n{MEANING}\n"
    )
    for line in worst:
        print(line)
    print(f"results in {folder}")
    bad = any(outcome.violation or outcome.exception or (outcome.vehicles and outcome.failure) for outcome in outcomes)
    return EXIT_FAILED if bad else EXIT_DONE
