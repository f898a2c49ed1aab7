"""`sitl study`: fly it, write its folder, and say what came out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from textwrap import fill

from msgspec import Struct

from sitl.ending import EXIT_DONE
from sitl.paper.claims import Claim
from sitl.share import ShareProgress
from sitl.stopping import StopRequest
from sitl.study.goals import goal_claims
from sitl.study.large import Spectra, large_spectra
from sitl.study.study import Study, run_study
from sitl.study.table import in_a_table
from sitl.summary import write_json

SCHEMA = 1
WIDTH = 120
SHOWN = ("chain-4", "chain-16", "ring-16", "grid-10x10")
DRAWN = ("chain-16", "ring-16", "grid-10x10")
SPECTRA_SHARE = 0.1  # of the time


class PastThePaper(Struct, frozen=True, kw_only=True):
    """study.json."""

    schema: int = SCHEMA
    claims: list[Claim]
    study: Study
    smallest_eigenvalues: Spectra


def run_study_command(arguments: argparse.Namespace) -> int:
    """The exit code. Raises what sitl/ending.py puts into words."""
    folder: Path = arguments.out or Path("runs") / f"study-{datetime.now():%Y%m%d-%H%M%S}"
    folder.mkdir(parents=True, exist_ok=True)
    with StopRequest("stopped; nothing was written", at_once=True), ShareProgress(arguments.quiet) as progress:
        progress.begin("past the paper")
        found = past_the_paper(arguments.full, progress.show)
    write_json(folder / "study.json", found)
    draw(folder, found)
    print(f"{in_a_table(found.study.quiet, SHOWN)}\n\n{_in_words(found.claims)}\n\nresults in {folder}")
    return EXIT_DONE


def past_the_paper(full: bool, progress: Callable[[float], None]) -> PastThePaper:
    """All of it; `progress` is told the share done."""
    spectra = large_spectra(lambda share: progress(SPECTRA_SHARE * share))
    study = run_study(full, lambda share: progress(SPECTRA_SHARE + (1.0 - SPECTRA_SHARE) * share))
    return PastThePaper(claims=goal_claims(study), study=study, smallest_eigenvalues=spectra)


def draw(folder: Path, found: PastThePaper) -> None:
    """trade_off.png and spectra.png."""
    from sitl.study.figures import save_spectra, save_trade_off  # matplotlib takes its time

    save_trade_off(folder / "trade_off.png", found.study.quiet, DRAWN)
    save_spectra(folder / "spectra.png", found.smallest_eigenvalues)


def _in_words(claims: Sequence[Claim]) -> str:
    return "\n\n".join(
        "\n".join([f"{claim.verdict}: {claim.claim}", *(_indented(part) for part in (_found(claim), claim.remark))])
        for claim in claims
    )


def _indented(words: str) -> str:
    return fill(words, WIDTH, initial_indent="  ", subsequent_indent="  ")


def _found(claim: Claim) -> str:
    return claim.full if claim.ideal == "-" else f"without noise: {claim.ideal}; with noise: {claim.full}"
