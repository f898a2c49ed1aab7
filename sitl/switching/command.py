"""`sitl switching`: the report of switching topologies."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from msgspec import Struct

from companion.config_file import ConfigError
from sitl.ending import EXIT_DONE
from sitl.share import ShareProgress
from sitl.stopping import StopRequest
from sitl.summary import write_json
from sitl.switching.starts import Start, random_start
from sitl.switching.study import fly_all, plans
from sitl.switching.summary import ARRIVED_M, LawSummary, flown_on, in_a_table, summarize
from sitl.switching.topology import Topology

SCHEMA = 1


class Report(Struct, frozen=True, kw_only=True):
    """switching.json."""

    schema: int = SCHEMA
    vehicles: int
    range_m: float
    duration_s: float
    laws: list[LawSummary]
    flights: list[Topology]


def run_switching(arguments: argparse.Namespace) -> int:
    """The exit code. Raises what sitl/ending.py puts into words."""
    folder: Path = arguments.out or Path("runs") / f"switching-{datetime.now():%Y%m%d-%H%M%S}"
    with StopRequest("stopped; nothing was written", at_once=True), ShareProgress(arguments.quiet) as progress:
        progress.begin("random starts")
        starts = _starts(arguments, progress.show)
        folder.mkdir(parents=True, exist_ok=True)
        planned = plans(starts, arguments.range, (0.0, arguments.hysteresis), arguments.seconds)
        progress.begin(f"{len(planned)} batches")
        flown = fly_all(planned, progress.show)
    _write(folder, arguments, flown)
    return EXIT_DONE


def _starts(arguments: argparse.Namespace, progress: Callable[[float], None]) -> list[Start]:
    """All of them, before any of them flies. Raises ConfigError."""
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
    from sitl.switching.figure import save_switching  # matplotlib takes its time

    laws = summarize(flown)
    write_json(
        folder / "switching.json",
        Report(
            vehicles=arguments.vehicles,
            range_m=arguments.range,
            duration_s=arguments.seconds,
            laws=laws,
            flights=flown,
        ),
    )
    title = f"{_starts_in_words(arguments.starts)} of {arguments.vehicles} vehicles that see {arguments.range:g} m far"
    save_switching(folder / "switching.png", flown, arguments.seconds, title)
    print(f"{title}, {arguments.seconds:g} s\n\n{in_a_table(laws)}\n\n{MEANING}\n")
    print(f"{flown_on(laws, arguments.vehicles)}\nresults in {folder}")


def _starts_in_words(starts: int) -> str:
    return "1 random start" if starts == 1 else f"{starts} random starts"


MEANING = f"""\
connected: nobody ever without a path to the leader; at the end: so when the time was over; arrived: all within
{ARRIVED_M:g} m of their places then, also where they flew on without a leader's word or too close to each other; within,
closest: any two vehicles at any time, median of the flights; edges lost: mean of a flight; lambda_min: median of each
flight's smallest while it was connected; first cut: median of those that were cut off"""
