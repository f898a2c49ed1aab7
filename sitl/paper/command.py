"""`sitl paper`: try every claim of the paper again, and write down what came out."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from sitl.ending import EXIT_DONE
from sitl.share import ShareProgress
from sitl.stopping import StopRequest

if TYPE_CHECKING:
    from sitl.paper.claims import Claim
    from sitl.paper.flights import FlownPlan

DESCRIPTION = """\
Reproduce Hou and Zhang (Robotica 2021): compute every claim of the theory, fly what figures 4 to 10 show with the same agents
that fly for real, and write a page that says which claims hold.
"""

MORE = """\
examples:
  sitl paper --out runs/paper
  sitl paper --out runs/paper --full         more graphs and more flights with sensor noise

the folder (default: runs/paper-DATE-TIME):
  index.html       claims with verdicts, errata, figures beside what the paper states
  claims.json      the same claims with every number behind them, versions, and how long it took
  *.png            the figures

exit codes:
  0    written; a claim that does not hold is a result, not a failure
  1    a flight that a figure needs never came to its formation, or a process ended before its flights did; the one line says it
  2    an argument cannot be used; the one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
"""


@dataclass(frozen=True, slots=True)
class PaperOptions:
    out: Path
    full: bool = False
    quiet: bool = False


def add_paper_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the report")
    parser.add_argument("--full", action="store_true", help="more graphs and more flights with sensor noise")
    parser.add_argument("--quiet", action="store_true", help="print the result only")


def paper_options(parsed: argparse.Namespace) -> PaperOptions:
    out = parsed.out or Path("runs") / f"paper-{datetime.now():%Y%m%d-%H%M%S}"
    return PaperOptions(out, parsed.full, parsed.quiet)


def run_paper(options: PaperOptions) -> int:
    """The exit code. Raises what sitl/ending.py puts into words."""
    with StopRequest("stopped; no report was written", at_once=True):
        _check(options)
        return _reproduce(options)


def _check(options: PaperOptions) -> None:
    """All that can be known before minutes are spent. Raises OSError."""
    options.out.mkdir(parents=True, exist_ok=True)
    trial = options.out / ".writable"
    trial.touch()
    trial.unlink()


def _reproduce(options: PaperOptions) -> int:
    """Compute, fly, draw, write. What takes long to import is imported here."""
    from sitl.paper.book import Book
    from sitl.paper.errata import errata
    from sitl.paper.figures import PICTURES
    from sitl.paper.flight_claims import flight_claims
    from sitl.paper.law_table import law_table
    from sitl.paper.past import past_rows, past_words
    from sitl.paper.report import Report, in_short, versions, write_report
    from sitl.study.command import draw, past_the_paper

    began_s = time.perf_counter()
    with ShareProgress(options.quiet) as progress:
        theory, flown = _compute_and_fly(options, progress)
        progress.begin("past the paper")
        past = past_the_paper(options.full, progress.show)
        progress.begin("drawing")
        book = Book(flown)
        for number, picture in enumerate(PICTURES):
            progress.show(number / len(PICTURES))
            picture.save(options.out / picture.file, book)
        draw(options.out, past)
    report = Report(
        claims=[*theory, *flight_claims(book)],
        past_claims=past.claims,
        past_words=past_words(past),
        past_settings=past_rows(past),
        errata=errata(),
        laws=law_table(book),
        versions=versions(),
        full=options.full,
        flights=len(flown),
        took_s=round(time.perf_counter() - began_s, 1),
    )
    write_report(options.out, report)
    print(f"{in_short(report.claims)}\nreport in {options.out / 'index.html'} ({report.took_s:.0f} s)", flush=True)
    return EXIT_DONE


def _compute_and_fly(options: PaperOptions, progress: ShareProgress) -> tuple[list[Claim], list[FlownPlan]]:
    """The theory is computed here while the flights are flown in processes of their own."""
    from sitl.paper.flights import fly, paper_plans
    from sitl.paper.theorems import theory_claims
    from sitl.workers import LOOK_EVERY_S, running

    plans = paper_plans(options.full)
    for plan in plans:
        plan.scenario()  # a scenario that cannot be used is said at once
    progress.begin("theory and flights")
    with running(fly, plans) as flights:

        def show(theory: float) -> None:
            flown = flights.share_done
            progress.show(min(theory, flown), f"theory {theory:.0%}, flights {flown:.0%}")

        theory = theory_claims(options.full, show)
        while not flights.wait(LOOK_EVERY_S):
            show(1.0)
        return theory, flights.results()
