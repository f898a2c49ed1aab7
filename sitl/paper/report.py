"""The report: index.html and claims.json from claims, errata, figures and the table of laws."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
from markupsafe import Markup
from msgspec import Struct

from companion import __version__
from companion.analysis.interaction import couple
from companion.analysis.prediction import errors_over_time
from companion.analysis.response import TICK_S, LinearModel
from companion.config.fleet import EdgeNeighbours
from companion.config.law import law_of
from companion.report.page import templates_of
from companion.types.flight import Role
from sitl.paper.flights import COMPARED, PERFECT, Book, FlightSubject, FlownPlan, Model
from sitl.paper.graphs import graph_of
from sitl.paper.platoon_claims import PAIRS
from sitl.paper.words import join_words, words
from sitl.report.claim import Claim, ClaimVerdict, Erratum
from sitl.report.metrics import FormationFigures, settle_time_s
from sitl.report.page_style import STYLE
from sitl.report.plots import LAW_TITLES
from sitl.report.summary import write_json

SCHEMA = 1
SIGNS = {ClaimVerdict.HOLDS: "✓", ClaimVerdict.CONDITION: "◐", ClaimVerdict.FAILS: "✗"}  # distinct without colour
CSS_CLASSES = {ClaimVerdict.HOLDS: "holds", ClaimVerdict.CONDITION: "condition", ClaimVerdict.FAILS: "fails"}


class PaperReport(Struct, frozen=True, kw_only=True):
    """Content of claims.json. `took_s`: run time of the command; `flights`: number of its flights.

    `missing`: claims and figures that were not finished when the command was stopped.
    """

    schema: int = SCHEMA
    claims: list[Claim]
    errata: list[Erratum]
    laws: list[LawRow]
    versions: dict[str, str]
    full: bool
    flights: int
    took_s: float
    missing: list[str] = []


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
    return f"{len(claims)} claim{'' if len(claims) == 1 else 's'}: {join_words(parts)}"


def write_report(folder: Path, report: PaperReport) -> None:
    """Write index.html and claims.json to the folder of the figures."""
    write_json(folder / "claims.json", report)
    (folder / "index.html").write_text(as_html(report), encoding="utf-8")


def as_html(report: PaperReport) -> str:
    """The page. It needs no network; its figures are files in the same folder."""
    environment = templates_of("sitl.paper")
    environment.filters |= {"sign": SIGNS.__getitem__, "css_class": CSS_CLASSES.__getitem__, "sentence": sentence}
    template = environment.get_template("report.html.j2")
    by_id = {claim.id: claim for claim in report.claims}
    return template.render(
        report=report,
        summary=verdict_counts(report.claims),
        verdicts=[(verdict, [c for c in report.claims if c.verdict is verdict]) for verdict in ClaimVerdict],
        figures=[
            (file, own, [by_id[i] for i in own.claims if i in by_id])
            for file, own in words().figures.items()
            if file not in report.missing
        ],
        law_titles=LAW_TITLES,
        style=Markup(STYLE),
    )


def sentence(text: str) -> str:
    """The text with a full stop, and a capital unless it begins with a symbol; empty stays empty."""
    first = text.partition(" ")[0]
    capital = text[:1].upper() + text[1:] if first.isalpha() else text
    return capital if not text or text.endswith(".") else f"{capital}."


DELAY_S = 0.01  # agents tick every 0.02 s at different phases: the mean age of a neighbour's state is half of that
FLOWN = {Model.IDEAL: "agents, ideal model", Model.FULL: "agents, full quadrotor"}


class LawRow(Struct, frozen=True, kw_only=True):
    """Largest distances [m] in the order of PAIRS, and settle time to 10 cm [s], None for a flight that never settled."""

    law: str
    source: str
    largest_m: tuple[float, ...]
    settle_s: float | None


def law_table(book: Book) -> list[LawRow]:
    rows = []
    for law in COMPARED:
        flown = book.one(FlightSubject.PLATOON, law, Model.IDEAL)
        sources: list[tuple[str, IdealFigures | FormationFigures]] = [
            ("equations", ideal_figures(flown, 0.0)),
            (f"equations, neighbours delayed by {DELAY_S:g} s", ideal_figures(flown, DELAY_S)),
            *((FLOWN[model], book.one(FlightSubject.PLATOON, law, model).figures) for model in PERFECT),
        ]
        for source, figures in sources:
            largest_m = tuple(figures.max_distance_m[pair] for pair in PAIRS)
            rows.append(LawRow(law=law, source=source, largest_m=largest_m, settle_s=figures.settle_s))
    return rows


IDEAL = LinearModel(attitude_lag_s=0.0, delay_s=0.5 * TICK_S)  # a command is held for a tick


@dataclass(frozen=True, slots=True)
class IdealFigures:
    """Figures of the ideal model. `max_distance_m` is by pair of neighbouring ids, as in `FormationFigures`."""

    max_distance_m: Mapping[str, float]
    settle_s: float | None


def ideal_figures(flown: FlownPlan, delay_s: float) -> IdealFigures:
    """Figures of a flight along x by eq. 2 and the law, from its true start; neighbour states are delayed by `delay_s`."""
    fleet, flight = flown.scenario.fleet, flown.flight
    if not isinstance(fleet.neighbours, EdgeNeighbours):
        raise TypeError("eq. 18 needs a fixed graph")
    ids = sorted(flight.tracks)
    leaders = {member.id for member in fleet.vehicles if member.role is Role.LEADER}
    coupling = couple(graph_of(ids, fleet.neighbours.edges), leaders, law_of(fleet.law), flight.slots_enu_m)
    slots_m = np.array([flight.slots_enu_m[i][0] for i in ids])
    starts_m = np.array([flown.scenario.starts_enu_m[i][0] for i in ids])
    errors_m = starts_m - flight.reference(0.0).position_enu_m[0] - slots_m
    duration_s = flight.formation.end_s - flight.formation.start_s
    model = replace(IDEAL, neighbour_delay_s=delay_s)
    history_m = errors_over_time(coupling, errors_m[:, np.newaxis], model, duration_s)[..., 0]
    apart_m = np.abs(np.diff(history_m + slots_m, axis=1)).max(axis=0)
    times_s = TICK_S * np.arange(len(history_m), dtype=np.float64)
    return IdealFigures(
        max_distance_m={f"{i}-{j}": float(d) for i, j, d in zip(ids, ids[1:], apart_m, strict=False)},
        settle_s=settle_time_s(times_s, np.asarray(np.abs(history_m).max(axis=1))),
    )
