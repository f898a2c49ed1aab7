"""The report: index.html and claims.json from claims, errata and figures."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path

import jinja2
import matplotlib
import numpy as np
from msgspec import Struct

from companion import __version__
from sitl.paper.beyond import SettingRow
from sitl.paper.book import listed
from sitl.paper.figures.pictures import PICTURES, PaperFigure
from sitl.paper.law_table import LawRow
from sitl.report.claim import Claim, ClaimVerdict, Erratum
from sitl.report.plots import LAW_TITLES
from sitl.report.summary import write_json
from sitl.study.command import SHOWN

SCHEMA = 1
SIGNS = {ClaimVerdict.HOLDS: "✓", ClaimVerdict.CONDITION: "◐", ClaimVerdict.FAILS: "✗"}  # distinct without colour
CSS_CLASSES = {ClaimVerdict.HOLDS: "holds", ClaimVerdict.CONDITION: "condition", ClaimVerdict.FAILS: "fails"}


class PaperReport(Struct, frozen=True, kw_only=True):
    """Content of claims.json. `took_s`: run time of the command; `flights`: number of its flights."""

    schema: int = SCHEMA
    claims: list[Claim]
    errata: list[Erratum]
    laws: list[LawRow]
    versions: dict[str, str]
    full: bool
    flights: int
    took_s: float
    past_claims: list[Claim] = []
    past_words: str = ""
    past_settings: list[SettingRow] = []


def versions() -> dict[str, str]:
    return {
        "formation-companion": __version__,
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "matplotlib": matplotlib.__version__,
    }


def verdict_counts(claims: Sequence[Claim]) -> str:
    """ "31 claims: 22 hold, 8 hold with a condition and 1 does not hold"."""
    counts = {verdict: sum(claim.verdict is verdict for claim in claims) for verdict in ClaimVerdict}
    holds, condition, fails = counts.values()
    parts = [
        f"{holds} {'holds' if holds == 1 else 'hold'}",
        f"{condition} {'holds' if condition == 1 else 'hold'} with a condition",
        f"{fails} {'does' if fails == 1 else 'do'} not hold",
    ]
    return f"{len(claims)} claim{'' if len(claims) == 1 else 's'}: {listed(parts)}"


def write_report(folder: Path, report: PaperReport) -> None:
    """Write index.html and claims.json to the folder of the figures."""
    write_json(folder / "claims.json", report)
    (folder / "index.html").write_text(as_html(report), encoding="utf-8")


def as_html(report: PaperReport) -> str:
    """The page. It needs no network; its figures are files in the same folder."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sitl.paper"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"sign": SIGNS.__getitem__, "css_class": CSS_CLASSES.__getitem__, "sentence": sentence}
    template = environment.get_template("report.html.j2")
    by_id = {claim.id: claim for claim in report.claims}
    return template.render(
        report=report,
        summary=verdict_counts(report.claims),
        verdicts=[(verdict, [c for c in report.claims if c.verdict is verdict]) for verdict in ClaimVerdict],
        pictures=[(picture, _claims_of(picture, by_id)) for picture in PICTURES],
        law_titles=LAW_TITLES,
        past_shapes=SHOWN,
    )


def sentence(text: str) -> str:
    """The text with a full stop, and a capital unless it begins with a symbol; empty stays empty."""
    first = text.partition(" ")[0]
    capital = text[:1].upper() + text[1:] if first.isalpha() else text
    return capital if not text or text.endswith(".") else f"{capital}."


def _claims_of(picture: PaperFigure, by_id: dict[str, Claim]) -> list[Claim]:
    return [by_id[claim_id] for claim_id in picture.claim_ids if claim_id in by_id]
