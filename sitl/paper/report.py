"""From claims, errata and figures to index.html and claims.json."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path

import jinja2
import matplotlib
import numpy as np
from msgspec import Struct

from companion import __version__
from sitl.paper.book import listed
from sitl.paper.claims import Claim, Erratum, Verdict
from sitl.paper.figures import PICTURES, Picture
from sitl.paper.law_table import LawRow
from sitl.paper.past import PastRow
from sitl.plots import LAW_TITLES
from sitl.study.command import SHOWN
from sitl.summary import write_json

SCHEMA = 1
SIGNS = {Verdict.HOLDS: "✓", Verdict.CONDITION: "◐", Verdict.FAILS: "✗"}  # told apart without colour
CSS_CLASSES = {Verdict.HOLDS: "holds", Verdict.CONDITION: "condition", Verdict.FAILS: "fails"}


class Report(Struct, frozen=True, kw_only=True):
    """claims.json. `took_s` is how long the whole command took, `flights` how many it flew."""

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
    past_settings: list[PastRow] = []


def versions() -> dict[str, str]:
    return {
        "formation-companion": __version__,
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "matplotlib": matplotlib.__version__,
    }


def in_short(claims: Sequence[Claim]) -> str:
    """ "31 claims: 22 hold, 8 hold with a condition and 1 does not hold"."""
    counts = {verdict: sum(claim.verdict is verdict for claim in claims) for verdict in Verdict}
    holds, condition, fails = counts.values()
    parts = [
        f"{holds} {'holds' if holds == 1 else 'hold'}",
        f"{condition} {'holds' if condition == 1 else 'hold'} with a condition",
        f"{fails} {'does' if fails == 1 else 'do'} not hold",
    ]
    return f"{len(claims)} claim{'' if len(claims) == 1 else 's'}: {listed(parts)}"


def write_report(folder: Path, report: Report) -> None:
    """index.html and claims.json; the figures lie beside them."""
    write_json(folder / "claims.json", report)
    (folder / "index.html").write_text(as_html(report), encoding="utf-8")


def as_html(report: Report) -> str:
    """One page that needs nothing from the network; its figures are files beside it."""
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
        summary=in_short(report.claims),
        verdicts=[(verdict, [c for c in report.claims if c.verdict is verdict]) for verdict in Verdict],
        pictures=[(picture, _claims_of(picture, by_id)) for picture in PICTURES],
        law_titles=LAW_TITLES,
        past_shapes=SHOWN,
    )


def sentence(text: str) -> str:
    """With a capital, unless it begins with a symbol, and a full stop; empty stays empty."""
    first = text.partition(" ")[0]
    capital = text[:1].upper() + text[1:] if first.isalpha() else text
    return capital if not text or text.endswith(".") else f"{capital}."


def _claims_of(picture: Picture, by_id: dict[str, Claim]) -> list[Claim]:
    return [by_id[claim_id] for claim_id in picture.claim_ids if claim_id in by_id]
