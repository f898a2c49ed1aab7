"""`sitl gauntlet --adversarial`: runs the search on all cores, keeps its state, and writes the worst flights as scenarios."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import msgspec
import yaml

from companion.types.errors import EXIT_DONE, EXIT_FAILED
from sitl.cluster import workers_of
from sitl.flight.scenario import Scenario
from sitl.gauntlet.flight import FlightOutcome, Job, fly
from sitl.gauntlet.minimal import minimal
from sitl.gauntlet.search import NO_PAIR, Search, is_violation, read_search, score_of, write_search
from sitl.gauntlet.summary import line_of
from sitl.report.folder import Column, results_folder, table_text
from sitl.report.progress import ShareProgress
from sitl.stopping import StopRequest
from sitl.workers import POLL_S, Workers

KEPT = 5  # worst flights that are reduced and kept
STOPPED = "stopped; whole generations are kept: sitl gauntlet --adversarial --flights {flights} --resume {folder}"
Reduced = tuple[Scenario, FlightOutcome]


def run_search(arguments: argparse.Namespace, families: tuple[str, ...]) -> int:
    """Search until `--flights` are flown, of which the last generation is flown to its end; returns the exit code."""
    folder = arguments.resume or results_folder(arguments.out, "gauntlet-adversarial")
    search = read_search(folder) if arguments.resume else _new_search(arguments, families)
    with (
        StopRequest(STOPPED.format(flights=arguments.flights, folder=folder)) as stop,
        ShareProgress(arguments.quiet) as progress,
        workers_of(arguments.cluster, arguments.jobs) as workers,
    ):
        write_search(folder, search)
        while search.flights < arguments.flights and not stop.number:
            jobs = search.next_jobs()
            progress.begin(f"generation {search.generation + 1}")
            outcomes = _fly(workers, jobs, search, progress, stop)
            if outcomes is None:
                break
            search.take(jobs, outcomes)
            write_search(folder, search)
        if not search.flights:
            print(f"stopped before the first generation was complete; state in {folder}")
            return stop.exit_code
        worst = reduced(workers, search, progress, stop)
    _print(folder, search, [_written(folder / f"worst_{n}.yaml", *one) for n, one in enumerate(worst, start=1)])
    if stop.number:
        print(f"stopped after {search.flights} of {arguments.flights} flights; to go on: add --resume {folder}")
        return stop.exit_code
    return EXIT_FAILED if search.violations else EXIT_DONE


def _new_search(arguments: argparse.Namespace, families: tuple[str, ...]) -> Search:
    return Search(seed=arguments.seed, sensors=arguments.sensors, families=families)


def _fly(
    workers: Workers, jobs: Sequence[Job], search: Search, progress: ShareProgress, stop: StopRequest
) -> list[FlightOutcome] | None:
    """The outcomes of a whole generation; None where a stop was requested."""
    worst = search.worst(1)
    so_far = f"{search.flights} flights, {search.violations} violations" + (
        f", worst at {worst[0].score:.2f} of what is allowed" if worst else ""
    )
    with workers.running(fly, jobs) as in_progress:
        while not in_progress.wait(POLL_S):
            progress.show(in_progress.share_done, so_far)
            if stop.number:
                return None
        return in_progress.results()


def reduced(workers: Workers, search: Search, progress: ShareProgress, stop: StopRequest) -> list[Reduced]:
    """The worst flights without what they do not need; none where a stop was requested."""
    jobs = [
        Job(search.seed, point.outcome.number, search.sensors, choices=point.choices)
        for point in search.worst(KEPT)
        if point.outcome.vehicles and not point.outcome.exception
    ]
    progress.begin("reducing the worst flights")
    with workers.running(minimal, jobs) as in_progress:
        while not stop.number:
            if in_progress.wait(POLL_S):
                return in_progress.results()
            progress.show(in_progress.share_done)
    return []


def _written(path: Path, scenario: Scenario, outcome: FlightOutcome) -> str:
    """Write the scenario file and return its line."""
    line = _line_of(outcome)
    content = yaml.safe_dump(msgspec.to_builtins(scenario), sort_keys=False)
    path.write_text(f"# {line}\n{content}", encoding="utf-8")
    return f"{line}: sitl run {path}"


def _line_of(outcome: FlightOutcome) -> str:
    """The flight, and what was worst in it."""
    room = outcome.room
    if room is None or room.distance_m >= 0.0:
        return line_of(outcome)
    name = f"flight {outcome.number}, {outcome.family}, {outcome.law}, {outcome.autopilot}, {outcome.sensors}"
    return f"{name}: vehicle {room.vehicle} {-room.distance_m:.2f} m beyond a wall or the ground at {room.time_s:.1f} s"


COLUMNS: tuple[Column, ...] = (
    ("family", "", -20),
    ("", "flights", 8),
    ("viola-", "tions", 7),
    ("worst, of", "allowed", 10),
    ("smallest", "ratio", 9),
    ("least", "room", 9),
    ("not", "reached", 8),
    ("last", "check", 7),
)
MEANING = """\
worst, of allowed: the smallest distance as a share of what is allowed, below 1 a violation; smallest ratio: of a true distance
to separation_m; least room: to fence, obstacle or ground; not reached: vehicles that stayed in formation and were not in their
slots at the end; last check: flights in which it braked a vehicle"""


def _print(folder: Path, search: Search, worst: Sequence[str]) -> None:
    rows = [_row(family, [o for o in search.outcomes if o.family == family]) for family in search.families]
    rows.append(_row("all", search.outcomes))
    print(f"{search.flights} flights in {search.generation} generations with seed {search.seed}\n")
    print(f"{table_text(COLUMNS, rows)}\n\n{MEANING}\n")
    for line in worst:
        print(line)
    print(f"results in {folder}")


def _row(family: str, outcomes: Sequence[FlightOutcome]) -> tuple[str, ...]:
    ratios = [o.ratio for o in outcomes if o.ratio is not None]
    rooms_m = [o.room.distance_m for o in outcomes if o.room]
    missed = sum(list(o.arrivals.reached_s.values()).count(None) for o in outcomes if o.arrivals)
    return (
        family,
        str(len(outcomes)),
        str(sum(map(is_violation, outcomes))),
        f"{min(map(score_of, outcomes), default=NO_PAIR):.2f}",
        f"{min(ratios):.2f}" if ratios else "-",
        f"{min(rooms_m):.2f} m" if rooms_m else "-",
        str(missed),
        str(sum(bool(o.braked) for o in outcomes)),
    )
