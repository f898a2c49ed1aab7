"""`sitl study`: fly the study, write its folder, and print the results."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill

from msgspec import Struct

from companion.types.errors import EXIT_DONE
from sitl.cluster import workers_of
from sitl.report.claim import Claim
from sitl.report.folder import results_folder
from sitl.report.progress import ShareProgress
from sitl.report.summary import write_json
from sitl.stopping import StopRequest
from sitl.study.goals import goal_claims
from sitl.study.large import Spectra, large_spectra
from sitl.study.plan import compared_shapes
from sitl.study.selection import Score, chosen, compare, scores, selection_text
from sitl.study.study import Study, run_study
from sitl.study.table import table_text
from sitl.workers import Workers

SCHEMA = 1
WIDTH = 120
SHOWN = ("chain-4", "chain-16", "ring-16", "grid-10x10")
DRAWN = ("chain-16", "ring-16", "grid-10x10")
SPECTRA_SHARE, SELECTION_SHARE = 0.1, 0.4  # of the run time


class StudyReport(Struct, frozen=True, kw_only=True):
    """Content of study.json."""

    schema: int = SCHEMA
    claims: list[Claim]
    study: Study
    selection: list[Score]
    selected: str | None
    smallest_eigenvalues: Spectra


def run_study_command(arguments: argparse.Namespace) -> int:
    """Run the command and return the exit code. Raises what sitl/cli/main.py reports."""
    with (
        StopRequest("stopped; nothing was written", at_once=True),
        ShareProgress(arguments.quiet) as progress,
        workers_of(arguments.cluster) as workers,
    ):
        folder = results_folder(arguments.out, "study")
        progress.begin("study")
        report = study_report(workers, arguments.full, progress.show)
    write_json(folder / "study.json", report)
    draw(folder, report)
    parts = [table_text(report.study.quiet, SHOWN), selection_text(report.selection), _claims_text(report.claims)]
    print("\n\n".join([*parts, f"results in {folder}"]))
    return EXIT_DONE


def study_report(workers: Workers, full: bool, progress: Callable[[float], None]) -> StudyReport:
    """Compute all spectra here and fly all flights in these workers. Calls `progress` with the share done, 0 to 1."""
    spectra = large_spectra(lambda share: progress(SPECTRA_SHARE * share))
    compared = compare(workers, compared_shapes(), lambda share: progress(SPECTRA_SHARE + SELECTION_SHARE * share))
    begun = SPECTRA_SHARE + SELECTION_SHARE
    study = run_study(workers, full, lambda share: progress(begun + (1.0 - begun) * share))
    found = scores(compared)
    best = chosen(found)
    return StudyReport(
        claims=goal_claims(study),
        study=study,
        selection=found,
        selected=best.setting if best else None,
        smallest_eigenvalues=spectra,
    )


def draw(folder: Path, report: StudyReport) -> None:
    """Write trade_off.png, selection.png and spectra.png."""
    from sitl.study.figures import save_spectra, save_trade_off  # importing matplotlib is slow
    from sitl.study.selection_figure import save_selection

    save_trade_off(folder / "trade_off.png", report.study.quiet, DRAWN)
    save_selection(folder / "selection.png", report.selection, chosen(report.selection))
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
