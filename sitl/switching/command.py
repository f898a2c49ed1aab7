"""`sitl switching`: the report of switching topologies."""

from __future__ import annotations

import argparse
import sys
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path

from msgspec import Struct

from companion.config_file import ConfigError
from sitl.share import ShareProgress
from sitl.stopping import StopNow, StopRequest
from sitl.summary import write_json
from sitl.switching.starts import random_start
from sitl.switching.study import fly_all, plans
from sitl.switching.summary import LawSummary, in_a_table, summarize
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
    """The exit code. Raises ConfigError."""
    if find_spec("matplotlib") is None:
        raise ConfigError("sitl switching", "matplotlib", "is not installed; pip install 'formation-companion[ground]'")
    folder: Path = arguments.out or Path("runs") / f"switching-{datetime.now():%Y%m%d-%H%M%S}"
    try:
        random_start(arguments.vehicles, arguments.range, seed=0)
        folder.mkdir(parents=True, exist_ok=True)
    except ValueError as error:
        raise ConfigError("sitl switching", "--vehicles", str(error)) from error
    except OSError as error:
        raise ConfigError("sitl switching", "--out", f"{folder}: {error.strerror}; choose another folder") from error
    planned = plans(
        arguments.starts, arguments.vehicles, arguments.range, (0.0, arguments.hysteresis), arguments.seconds
    )
    with StopRequest(at_once=True) as stop:
        try:
            with ShareProgress(arguments.quiet) as progress:
                progress.begin(f"{len(planned)} batches")
                flown = fly_all(planned, progress.show)
        except StopNow:
            print("stopped; nothing was written", file=sys.stderr)
            return stop.exit_code
    _write(folder, arguments, flown)
    return 0


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
    title = f"{arguments.starts} random starts of {arguments.vehicles} vehicles that see {arguments.range:g} m far"
    save_switching(folder / "switching.png", flown, arguments.seconds, title)
    print(f"{title}, {arguments.seconds:g} s\n\n{in_a_table(laws)}\n\n{MEANING}\nresults in {folder}")


MEANING = """\
connected: nobody ever without a path to the leader; at the end: so when the time was over; arrived: all within 20 cm of their
places then; edges lost: mean of a flight; lambda_min: median of each flight's smallest while it was connected"""
