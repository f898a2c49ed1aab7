"""`sitl study`: fly the study, write its folder, and print the results."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill

from msgspec import Struct

from sitl.errors import EXIT_DONE
from sitl.paper.claim import Claim
from sitl.report.folder import results_folder
from sitl.report.share import ShareProgress
from sitl.report.summary import write_json
from sitl.stopping import StopRequest
from sitl.study.goals import goal_claims
from sitl.study.large import Spectra, large_spectra
from sitl.study.study import Study, run_study
from sitl.study.table import table_text

SCHEMA = 1
WIDTH = 120
SHOWN = ("chain-4", "chain-16", "ring-16", "grid-10x10")
DRAWN = ("chain-16", "ring-16", "grid-10x10")
SPECTRA_SHARE = 0.1  # of the run time


class StudyReport(Struct, frozen=True, kw_only=True):
    """Content of study.json."""

    schema: int = SCHEMA
    claims: list[Claim]
    study: Study
    smallest_eigenvalues: Spectra


def run_study_command(arguments: argparse.Namespace) -> int:
    """Run the command and return the exit code. Raises the errors that sitl/cli/ending.py reports."""
    folder = results_folder(arguments.out, "study")
    with StopRequest("stopped; nothing was written", at_once=True), ShareProgress(arguments.quiet) as progress:
        progress.begin("study")
        report = study_report(arguments.full, progress.show)
    write_json(folder / "study.json", report)
    draw(folder, report)
    print(f"{table_text(report.study.quiet, SHOWN)}\n\n{_claims_text(report.claims)}\n\nresults in {folder}")
    return EXIT_DONE


def study_report(full: bool, progress: Callable[[float], None]) -> StudyReport:
    """Compute all spectra and fly all flights. Calls `progress` with the share done, 0 to 1."""
    spectra = large_spectra(lambda share: progress(SPECTRA_SHARE * share))
    study = run_study(full, lambda share: progress(SPECTRA_SHARE + (1.0 - SPECTRA_SHARE) * share))
    return StudyReport(claims=goal_claims(study), study=study, smallest_eigenvalues=spectra)


def draw(folder: Path, report: StudyReport) -> None:
    """Write trade_off.png and spectra.png."""
    from sitl.study.figures import save_spectra, save_trade_off  # importing matplotlib is slow

    save_trade_off(folder / "trade_off.png", report.study.quiet, DRAWN)
    save_spectra(folder / "spectra.png", report.smallest_eigenvalues)


def _claims_text(claims: Sequence[Claim]) -> str:
    return "\n\n".join(
        "\n".join(
            [f"{claim.verdict}: {claim.claim}", *(_indented(part) for part in (_results_text(claim), claim.remark))]
        )
        for claim in claims
    )


def _indented(text: str) -> str:
    return fill(text, WIDTH, initial_indent="  ", subsequent_indent="  ")


def _results_text(claim: Claim) -> str:
    return claim.full if claim.ideal == "-" else f"without noise: {claim.ideal}; with noise: {claim.full}"
