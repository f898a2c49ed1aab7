"""`sitl compare`: fly all cells and write the folder. `compare` is its interface for Python."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from shlex import join

from companion.types.errors import EXIT_DONE
from sitl.cluster import workers_of
from sitl.compare.conditions import CONDITIONS
from sitl.compare.figures import Figures
from sitl.compare.flights import FlightJob, fly_job, jobs_of
from sitl.compare.graphs import GRAPHS
from sitl.compare.options import CompareOptions
from sitl.compare.plan import Plan, plan_of
from sitl.compare.report import Compared, Row, compared, report_text, rows_of, write_rows
from sitl.compare.statistics import FlownFlight, by_cell
from sitl.report.folder import results_folder
from sitl.report.progress import ShareProgress
from sitl.report.summary import write_json
from sitl.stopping import StopNow, StopRequest
from sitl.workers import POLL_S, Workers


@dataclass(frozen=True, slots=True)
class FlownCells:
    """What was flown, in the order of the plan; less after a stop. `checked`: what the agents flew beside a batch."""

    flights: list[FlownFlight]
    checked: list[FlownFlight]


def run(options: CompareOptions) -> int:
    """Run `sitl compare` and return the exit code. Raises what sitl/cli/main.py reports."""
    with StopRequest("stopped at once; nothing was kept") as stop, ShareProgress(options.quiet) as progress:
        plan = _checked(options, progress, stop)
        with workers_of(options.cluster, options.processes) as workers:
            folder = results_folder(
                options.out, "compare" if options.scenario is None else f"{options.scenario.stem}-compare"
            )
            flown = fly_all(workers, plan, progress, lambda: stop.number is not None)
        if not flown.flights:
            if not any(folder.iterdir()):
                folder.rmdir()
            print("stopped before any flight was complete: those of a batch end together", file=sys.stderr)
            return stop.exit_code
        progress.begin("drawing")
        progress.show(0.0)
        result = compared(command_of(options), plan, flown.flights, flown.checked)
        write_folder(folder, plan, flown, result)
    print(f"{report_text(result, by_cell(flown.flights))}\n\nresults in {folder}")
    return stop.exit_code if stop.number else EXIT_DONE


def _checked(options: CompareOptions, progress: ShareProgress, stop: StopRequest) -> Plan:
    """The plan. Raises ConfigError, and StopNow, since many scenarios take a while."""

    def checked(share: float) -> None:
        progress.show(share)
        if stop.number:
            raise StopNow("stopped; nothing was flown", stop.exit_code)

    progress.begin("checking")
    return plan_of(options, checked)


def fly_all(workers: Workers, plan: Plan, progress: ShareProgress, stops: Callable[[], bool]) -> FlownCells:
    """Fly the plan until all is done, or `stops` says so."""
    jobs = jobs_of(plan.flights, plan.check, plan.seconds)
    total = len(plan.flights) + len(plan.check)
    progress.begin("flying")
    with workers.running(fly_job, jobs, [job.work for job in jobs]) as in_progress:
        while not in_progress.wait(POLL_S) and not stops():
            done = sum(map(len, filter(None, in_progress.results_so_far())))
            progress.show(in_progress.share_done, f"{done} of {total} flights complete" if done else f"{total} flights")
        results = in_progress.results_so_far() if stops() else in_progress.results()
    return _in_order(plan, jobs, results)


def _in_order(plan: Plan, jobs: Sequence[FlightJob], results: Sequence[list[Figures] | None]) -> FlownCells:
    every = [*plan.flights, *(replace(flight, by_agents=True) for flight in plan.check)]
    numbered = sorted(
        chain.from_iterable(
            zip(job.numbers, of_job or (), strict=False) for job, of_job in zip(jobs, results, strict=True)
        ),
        key=lambda one: one[0],
    )
    flown = [(number, FlownFlight(every[number], figures)) for number, figures in numbered]
    count = len(plan.flights)
    return FlownCells(
        [one for number, one in flown if number < count], [one for number, one in flown if number >= count]
    )


def write_folder(folder: Path, plan: Plan, flown: FlownCells, result: Compared) -> None:
    """compare.csv, compare.parquet, compare.json, index.html and the figures as PDF."""
    from sitl.compare.page import page_of  # importing matplotlib is slow
    from sitl.compare.plots import figures_of, save_pdf

    write_rows(folder, rows_of(flown.flights))
    write_json(folder / "compare.json", result)
    drawn = figures_of(plan, by_cell(flown.flights), result)
    for name, figure in drawn.items():
        save_pdf(folder / f"{name}.pdf", figure.figure)
    (folder / "index.html").write_text(page_of(plan, by_cell(flown.flights), result, drawn), encoding="utf-8")


def command_of(options: CompareOptions) -> str:
    """The command line that gives the same figures again, on whatever machine."""
    words = ["sitl", "compare", *([str(options.scenario)] if options.scenario else [])]
    lists = {
        "laws": options.laws,
        "graphs": options.graphs,
        "conditions": options.conditions,
        "vehicles": options.vehicles,
    }
    for name, given in lists.items():
        words += [f"--{name}", ",".join(map(str, given))] if given else []
    for value in options.varied:
        words += ["--vary", value]
    for value in options.overrides:
        words += ["--set", value]
    words += ["--seeds", str(options.seeds)]
    words += ["--seconds", f"{options.seconds:g}"] if options.seconds else []
    words += ["--lockstep", str(options.lockstep)] if options.lockstep else []
    return join(words)


def names_text() -> str:
    """All graphs and conditions with a line each."""
    lines = ["graphs:", *(f"  {name:<14} {graph.about}" for name, graph in GRAPHS.items())]
    lines += ["conditions:"]
    for name, condition in CONDITIONS.items():
        by_agents = "; flown by the agents one by one" if condition.by_agents else ""
        lines.append(f"  {name:<14} {condition.about}{by_agents}")
    return "\n".join(lines)


def compare(options: CompareOptions) -> tuple[list[Row], Compared]:
    """Fly a comparison without a folder: the rows of compare.csv, and the content of compare.json. Raises ConfigError."""
    with ShareProgress(options.quiet) as progress:
        progress.begin("checking")
        plan = plan_of(options, progress.show)
        with workers_of(options.cluster, options.processes) as workers:
            flown = fly_all(workers, plan, progress, lambda: False)
    return rows_of(flown.flights), compared(command_of(options), plan, flown.flights, flown.checked)
