"""`sitl switching`: fly random starts with switching topologies, write the results, and print the table."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct

from companion.config.file import ConfigError
from companion.types.errors import EXIT_DONE
from sitl.cluster import workers_of
from sitl.report.folder import results_folder, table_text
from sitl.report.progress import ShareProgress
from sitl.report.summary import write_json
from sitl.stopping import StopRequest
from sitl.switching.starts import Start, random_start
from sitl.switching.study import fly_all, plans
from sitl.switching.summary import ARRIVED_M, COLUMNS, LawSummary, cells, limits_text, summarize
from sitl.switching.topology import Topology

SCHEMA = 1


class SwitchingReport(Struct, frozen=True, kw_only=True):
    """Content of switching.json."""

    schema: int = SCHEMA
    vehicles: int
    range_m: float
    duration_s: float
    laws: list[LawSummary]
    flights: list[Topology]


def run_switching(arguments: argparse.Namespace) -> int:
    """Run the command and return the exit code. Raises what sitl/cli/main.py reports."""
    with StopRequest("stopped; nothing was written", at_once=True), ShareProgress(arguments.quiet) as progress:
        progress.begin("random starts")
        starts = _starts(arguments, progress.show)
        with workers_of(arguments.cluster) as workers:
            folder = results_folder(arguments.out, "switching")
            planned = plans(starts, arguments.range, (0.0, arguments.hysteresis), arguments.seconds)
            progress.begin(f"{len(planned)} batches")
            flown = fly_all(workers, planned, progress.show)
    _write(folder, arguments, flown)
    return EXIT_DONE


def _starts(arguments: argparse.Namespace, progress: Callable[[float], None]) -> list[Start]:
    """Draw all starts before the first flight. Raises ConfigError."""
    starts = []
    for seed in range(arguments.starts):
        progress(seed / arguments.starts)
        try:
            starts.append(random_start(arguments.vehicles, arguments.range, seed))
        except ValueError as error:
            raise ConfigError(
                "sitl switching", "--vehicles, --range", f"{error}; choose fewer vehicles or another range"
            ) from error
    return starts


def _write(folder: Path, arguments: argparse.Namespace, flown: list[Topology]) -> None:
    from sitl.switching.figure import save_switching  # importing matplotlib is slow

    laws = summarize(flown)
    write_json(
        folder / "switching.json",
        SwitchingReport(
            vehicles=arguments.vehicles,
            range_m=arguments.range,
            duration_s=arguments.seconds,
            laws=laws,
            flights=flown,
        ),
    )
    title = f"{_starts_text(arguments.starts)} of {arguments.vehicles} vehicles with a range of {arguments.range:g} m"
    save_switching(folder / "switching.png", flown, arguments.seconds, title)
    print(f"{title}, {arguments.seconds:g} s\n\n{table_text(COLUMNS, map(cells, laws))}\n\n{MEANING}\n")
    print(f"{limits_text(laws, arguments.vehicles)}\nresults in {folder}")


def _starts_text(starts: int) -> str:
    return "1 random start" if starts == 1 else f"{starts} random starts"


MEANING = f"""\
connected: all vehicles always had a path to the leader; at the end: they had one at the end of the flight; would hand over:
at least one agent lost the leader beacon for so long that it would hand over; arrived: all vehicles within {ARRIVED_M:g} m of
their slots at the end; within, closest: smallest distance of any two vehicles, median of the flights; edges lost: mean per
flight; lambda_min: smallest of each flight while connected, median; first cut: time of the first disconnection, median"""
