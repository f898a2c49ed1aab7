"""`sitl paper`: check every claim of the paper by computation or flight, and write the report."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from companion.types.errors import EXIT_DONE
from sitl.cluster import workers_of
from sitl.report.folder import results_folder
from sitl.report.progress import ShareProgress
from sitl.stopping import StopRequest

if TYPE_CHECKING:
    from sitl.paper.flights import FlownPlan
    from sitl.report.claim import Claim
    from sitl.workers import Workers


def run_paper(options: argparse.Namespace) -> int:
    """Run `sitl paper` and return the exit code. Raises what sitl/cli/main.py reports."""
    folder = results_folder(options.out, "paper")
    with StopRequest("stopped; no report was written", at_once=True):
        trial = folder / ".writable"  # before minutes are spent
        trial.touch()
        trial.unlink()
        return _reproduce(folder, options)


def _reproduce(folder: Path, options: argparse.Namespace) -> int:
    """Compute, fly, draw and write the report. Slow imports are made here."""
    from sitl.paper.aggregation_claims import flight_claims
    from sitl.paper.errata import errata
    from sitl.paper.figures import SAVED
    from sitl.paper.flights import Book
    from sitl.paper.report import (
        PaperReport,
        growth_text,
        law_table,
        setting_rows,
        verdict_counts,
        versions,
        write_report,
    )
    from sitl.study.command import draw, study_report

    began_s = time.perf_counter()
    with ShareProgress(options.quiet) as progress:
        with workers_of(options.cluster) as workers:
            theory, flown = _compute_and_fly(options, workers, progress)
            progress.begin("study")
            study = study_report(workers, options.full, progress.show)
        progress.begin("drawing")
        book = Book(flown)
        for number, (file, save) in enumerate(SAVED.items()):
            progress.show(number / len(SAVED))
            save(folder / file, book)
        draw(folder, study)
    report = PaperReport(
        claims=[*theory, *flight_claims(book)],
        past_claims=study.claims,
        past_words=growth_text(study),
        past_settings=setting_rows(study),
        errata=errata(),
        laws=law_table(book),
        versions=versions(),
        full=options.full,
        flights=len(flown),
        took_s=round(time.perf_counter() - began_s, 1),
    )
    write_report(folder, report)
    print(f"{verdict_counts(report.claims)}\nreport in {folder / 'index.html'} ({report.took_s:.0f} s)", flush=True)
    return EXIT_DONE


def _compute_and_fly(
    options: argparse.Namespace, workers: Workers, progress: ShareProgress
) -> tuple[list[Claim], list[FlownPlan]]:
    """Compute the theory in this process while the workers fly the flights."""
    from sitl.paper.flights import fly, paper_plans
    from sitl.paper.theorems import theory_claims
    from sitl.workers import POLL_S

    plans = paper_plans(options.full)
    for plan in plans:
        plan.scenario()  # an invalid scenario is an error before any flight
    progress.begin("theory and flights")
    with workers.running(fly, plans) as flights:

        def show(theory: float) -> None:
            flown = flights.share_done
            progress.show(min(theory, flown), f"theory {theory:.0%}, flights {flown:.0%}")

        theory = theory_claims(options.full, show)
        while not flights.wait(POLL_S):
            show(1.0)
        return theory, flights.results()
