"""`sitl sweep`: from a scenario file to a folder of statistics."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.types.errors import EXIT_DONE
from sitl.cluster import workers_of
from sitl.report.folder import results_folder
from sitl.report.progress import ShareProgress
from sitl.report.summary import write_json
from sitl.stopping import StopNow, StopRequest
from sitl.sweep.flights import Chunk, FlightFigures, chunks_of, fly_chunk
from sitl.sweep.options import SweepOptions
from sitl.sweep.points import Axis, Point, axes_of, base_scenario, formation_time_s, points_of
from sitl.sweep.report import Row, table_text, write_csv
from sitl.sweep.statistics import Sweep, combination
from sitl.workers import POLL_S, Workers


@dataclass(frozen=True, slots=True)
class Grid:
    """The points of a sweep, and the duration of each flight."""

    axes: list[Axis]
    points: list[Point]
    seconds: float


@dataclass(frozen=True, slots=True)
class FlownGrid:
    """Rows in the order of the points and, within a point, of the seeds. `flying_s` is wall-clock time."""

    rows: list[Row]
    flying_s: float


def run(options: SweepOptions) -> int:
    """Run `sitl sweep` and return the exit code. Raises what sitl/cli/main.py reports."""
    with StopRequest("stopped at once; nothing was kept") as stop:
        return _run(options, stop)


def _run(options: SweepOptions, stop: StopRequest) -> int:
    name = options.scenario.stem
    with ShareProgress(options.quiet) as progress:
        grid = _grid(options, progress, stop)
        with workers_of(options.cluster, options.processes) as workers:
            folder = results_folder(options.out, f"{name}-sweep")
            flown = _fly(workers, chunks_of(grid.points, options.seeds, grid.seconds), progress, stop)
    if not flown.rows:
        print(f"stopped before any flight was complete; nothing in {folder}", file=sys.stderr)
        return stop.exit_code
    sweep = _statistics(options, name, grid, flown.rows)
    _write(folder, grid, sweep, flown.rows)
    print(f"{table_text(sweep)}\n{_speed(sweep, flown)}\nresults in {folder}")
    return stop.exit_code if stop.number else EXIT_DONE


def _grid(options: SweepOptions, progress: ShareProgress, stop: StopRequest) -> Grid:
    """Load and check all scenarios. Raises ConfigError, and StopNow, since many scenarios take a while."""

    def checked(number: int, of: int) -> None:
        progress.show(number / of)
        if stop.number:
            raise StopNow("stopped; nothing was flown", stop.exit_code)

    progress.begin("checking")
    base = base_scenario(options.scenario, options.overrides)
    axes = axes_of(options.varied, options.seeds)
    seconds = options.seconds or formation_time_s(options.scenario, base)
    return Grid(axes, points_of(options.scenario, options.overrides, axes, checked), seconds)


def _fly(workers: Workers, chunks: Sequence[Chunk], progress: ShareProgress, stop: StopRequest) -> FlownGrid:
    flights = sum(len(chunk.flights) for chunk in chunks)
    began_s = time.perf_counter()
    progress.begin("flying")
    with workers.running(fly_chunk, chunks, [chunk.work_s for chunk in chunks]) as in_progress:
        while not in_progress.wait(POLL_S) and not stop.number:
            done = sum(map(len, filter(None, in_progress.results_so_far())))
            progress.show(in_progress.share_done, f"{done} of {flights} flights")
        results = in_progress.results_so_far() if stop.number else in_progress.results()
    return FlownGrid(_rows(chunks, results), time.perf_counter() - began_s)


def _rows(chunks: Sequence[Chunk], results: Sequence[list[FlightFigures] | None]) -> list[Row]:
    rows = [
        Row(flight, figures)
        for chunk, of_chunk in zip(chunks, results, strict=True)
        for flight, figures in zip(chunk.flights, of_chunk or (), strict=False)
    ]
    return sorted(rows, key=lambda row: (row.flight.point, row.flight.seed))


def _statistics(options: SweepOptions, name: str, grid: Grid, rows: Sequence[Row]) -> Sweep:
    flown: dict[int, list[FlightFigures]] = {}
    for row in rows:
        flown.setdefault(row.flight.point, []).append(row.figures)
    keys = [axis.key for axis in grid.axes]
    return Sweep(
        scenario=name,
        overrides=list(options.overrides),
        vehicles=len(grid.points[0].scenario.fleet.vehicles),
        seconds=grid.seconds,
        seeds=options.seeds,
        vary={axis.key: [choice.value for choice in axis.choices] for axis in grid.axes},
        flights=len(rows),
        complete=len(rows) == len(grid.points) * options.seeds,
        combinations=[
            combination({k: c.value for k, c in zip(keys, grid.points[point].choices, strict=True)}, figures)
            for point, figures in flown.items()
        ],
    )


def _write(folder: Path, grid: Grid, sweep: Sweep, rows: Sequence[Row]) -> None:
    from sitl.sweep.figure import save_sweep  # importing matplotlib is slow

    write_csv(folder / "sweep.csv", grid.axes, grid.points, rows)
    write_json(folder / "sweep.json", sweep)
    save_sweep(folder / "sweep.png", sweep, grid.axes)


def _speed(sweep: Sweep, flown: FlownGrid) -> str:
    vehicle_s = sweep.flights * sweep.vehicles * sweep.seconds
    return (
        f"{vehicle_s:.0f} vehicle-seconds in {flown.flying_s:.1f} s: {vehicle_s / flown.flying_s:.0f} times real time"
    )
