"""`sitl paper`: check every claim of the paper by computation or flight, and write the report."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from companion.types.errors import EXIT_DONE
from sitl.cluster import workers_of
from sitl.report.folder import results_folder
from sitl.report.progress import ShareProgress
from sitl.stopping import StopRequest

if TYPE_CHECKING:
    from sitl.paper.flights import FlownPlan, PaperPlan
    from sitl.report.claim import Claim
    from sitl.workers import Workers

CORE_MINUTES, FULL_CORE_MINUTES = 2.0, 5.0  # of a quiet core, as measured
THEORY_S, FULL_THEORY_S = 200.0, 2500.0  # computing the theory takes as long as flying so many seconds


class _Stopped(Exception):  # noqa: N818 -- no error: what is finished is kept
    """Computing ends here."""


def run_paper(options: argparse.Namespace) -> int:
    """Run `sitl paper` and return the exit code. Raises what sitl/cli/main.py reports."""
    folder = results_folder(options.out, "paper")
    with StopRequest("stopped at once; no report was written") as stop:
        trial = folder / ".writable"  # before minutes are spent
        trial.touch()
        trial.unlink()
        if not options.quiet and not options.cluster:
            print(duration_text(options.full, len(os.sched_getaffinity(0))), file=sys.stderr, flush=True)
        return _reproduce(folder, options, stop)


def duration_text(full: bool, cores: int) -> str:
    """How long it takes, in a line."""
    minutes = max(1, round((FULL_CORE_MINUTES if full else CORE_MINUTES) / cores))
    lasts = f"{minutes} minute{'' if minutes == 1 else 's'} on {cores} quiet core{'' if cores == 1 else 's'}"
    return f"about {lasts}; Ctrl-C keeps what is finished"


def _reproduce(folder: Path, options: argparse.Namespace, stop: StopRequest) -> int:
    """Compute, fly, draw and write the report. Slow imports are made here."""
    from sitl.paper.aggregation_claims import flight_claims
    from sitl.paper.errata import errata
    from sitl.paper.figures import SAVED
    from sitl.paper.flights import Book, NotFlownError, paper_plans
    from sitl.paper.report import PaperReport, law_table, verdict_counts, versions, write_report
    from sitl.paper.words import words

    began_s = time.perf_counter()
    plans = paper_plans(options.full)
    with ShareProgress(options.quiet) as progress:
        with workers_of(options.cluster) as workers:
            theory, flown = _compute_and_fly(options, plans, workers, progress, lambda: stop.number is not None)
        if not theory and not flown:
            print("stopped before anything was finished; no report was written", file=sys.stderr)
            return stop.exit_code
        progress.begin("drawing")
        book = Book(flown, plans)
        drawn = []
        for number, (file, save) in enumerate(SAVED.items()):
            progress.show(number / len(SAVED))
            with suppress(NotFlownError):
                save(folder / file, book)
                drawn.append(file)
        laws = []
        with suppress(NotFlownError):
            laws = law_table(book)
    claims = {claim.id: claim for claim in (*theory, *flight_claims(book))}
    report = PaperReport(
        claims=[claims[id_] for id_ in words().claims if id_ in claims],
        errata=errata(),
        laws=laws,
        versions=versions(),
        full=options.full,
        flights=len(flown),
        took_s=round(time.perf_counter() - began_s, 1),
        missing=[name for name in (*words().claims, *SAVED) if name not in claims and name not in drawn],
    )
    write_report(folder, report)
    print(f"{verdict_counts(report.claims)}\nreport in {folder / 'index.html'} ({report.took_s:.0f} s)", flush=True)
    if report.missing:
        print(
            f"incomplete: stopped before {len(report.missing)} of the claims and figures were finished", file=sys.stderr
        )
    return stop.exit_code if stop.number else EXIT_DONE


def _compute_and_fly(
    options: argparse.Namespace,
    plans: list[PaperPlan],
    workers: Workers,
    progress: ShareProgress,
    stops: Callable[[], bool],
) -> tuple[list[Claim], list[FlownPlan]]:
    """Compute the theory in this process while the workers fly the flights. Less of both after a stop."""
    from sitl.flight.virtual_flight import lasts_s
    from sitl.paper.flights import fly
    from sitl.paper.theorems import theory_claims
    from sitl.workers import POLL_S

    work_s = [lasts_s(plan.scenario()) for plan in plans]  # an invalid scenario is an error before any flight
    theory_s = FULL_THEORY_S if options.full else THEORY_S
    all_s = theory_s + sum(work_s)
    progress.begin("theory and flights")
    theory: list[Claim] = []
    with workers.running(fly, plans, work_s) as flights:

        def show(share: float) -> None:
            if stops():
                raise _Stopped
            flown = flights.share_done
            done_s = theory_s * share + (all_s - theory_s) * flown
            progress.show(done_s / all_s, f"theory {share:.0%}, flights {flown:.0%}")

        with suppress(_Stopped):
            for claim in theory_claims(options.full, show):
                theory.append(claim)  # noqa: PERF402 -- those before a stop are kept
            while not flights.wait(POLL_S):
                show(1.0)
            return theory, flights.results()
        return theory, [flown for flown in flights.results_so_far() if flown is not None]
