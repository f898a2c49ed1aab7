"""The page of a comparison: one HTML file with everything in it, without a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from companion.report.page import templates_of
from companion.report.plotting import render
from sitl.batch.flight import LEFT_OUT
from sitl.compare.conditions import CONDITIONS
from sitl.compare.graphs import GRAPHS
from sitl.compare.plan import Plan
from sitl.compare.plots import ComparisonFigure
from sitl.compare.report import (
    Compared,
    conditions_by_agents,
    failures_text,
    interval_parts,
    number_text,
    remarks_text,
    settings_text,
)
from sitl.compare.statistics import MEANINGS, ByCell, CellSummary, Winner
from sitl.report.page_style import STYLE


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """One law in one place. `best`: by figure, whether it is the best, and clearly."""

    one: CellSummary
    best: dict[str, bool]


def page_of(plan: Plan, cells: ByCell, result: Compared, drawn: Mapping[str, ComparisonFigure]) -> str:
    environment = templates_of("sitl.compare")
    environment.filters |= {"interval": _interval, "number": _number}
    places = list(dict.fromkeys(cell.place for cell in cells))
    figures = [name for name in MEANINGS if any(name in one.figures for one in result.cells)]
    return environment.get_template("page.html.j2").render(
        style=Markup(STYLE),
        result=result,
        laws=list(plan.laws),
        vehicles=", ".join(str(count) for count in sorted({place.vehicles for place in places})),
        graphs=_about([place.graph for place in places], {name: graph.about for name, graph in GRAPHS.items()}),
        conditions=_about([place.condition for place in places], {name: one.about for name, one in CONDITIONS.items()}),
        by_agents=conditions_by_agents(cells),
        failures=list(failures_text(cells)),
        remarks=remarks_text(cells),
        settings=settings_text(result),
        figures=[(name, MEANINGS[name].label) for name in figures],
        wins=_wins(plan, result, figures),
        places=_by_place(result),
        drawn=[(render(one.figure, name, one.title, one.shows), f"{name}.pdf") for name, one in drawn.items()],
        left_out=LEFT_OUT,
        markup=Markup,
        labels={name: one.label for name, one in MEANINGS.items()},
    )


def _about(names: Sequence[str], known: Mapping[str, str]) -> list[tuple[str, str]]:
    return [(name, known.get(name, "the scenario's own")) for name in dict.fromkeys(names)]


def _wins(plan: Plan, result: Compared, figures: Sequence[str]) -> list[tuple[str, list[tuple[int, int]]]]:
    """For each law: by figure, in how many places it is the best, and in how many clearly."""

    def count(law: str, name: str) -> tuple[int, int]:
        own: list[Winner] = [one for one in result.winners if (one.law, one.figure) == (law, name)]
        return len(own), sum(one.clear for one in own)

    return [(law, [count(law, name) for name in figures]) for law in plan.laws]


def _by_place(result: Compared) -> dict[str, list[PlaceRow]]:
    best: dict[tuple[str, str], dict[str, bool]] = {}
    for winner in result.winners:
        best.setdefault((winner.place, winner.law), {})[winner.figure] = winner.clear
    found: dict[str, list[PlaceRow]] = {}
    for one in result.cells:
        found.setdefault(one.place, []).append(PlaceRow(one, best.get((one.place, one.law), {})))
    return found


def _interval(one: CellSummary, name: str) -> tuple[str, str]:
    return interval_parts(name, one.figures.get(name))


def _number(value: float | None, name: str) -> str:
    return number_text(name, value)
