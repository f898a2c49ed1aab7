"""Table of the platoon, law by law: results of the equations alone and of the flown agents."""

from __future__ import annotations

from msgspec import Struct

from sitl.paper.book import PERFECT, Book
from sitl.paper.claims.platoon import PAIRS
from sitl.paper.flights import COMPARED, FlightSubject, Model
from sitl.paper.ideal_model import ideal_figures

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
        flown = book.one(FlightSubject.PLATOON, law, Model.IDEAL).flown
        for source, delay_s in (("equations", 0.0), (f"equations, neighbours delayed by {DELAY_S:g} s", DELAY_S)):
            ideal = ideal_figures(flown, delay_s)
            largest_m = tuple(ideal.max_distance_m[pair] for pair in PAIRS)
            rows.append(LawRow(law=law, source=source, largest_m=largest_m, settle_s=ideal.settle_s))
        for model in PERFECT:
            figures = book.one(FlightSubject.PLATOON, law, model).figures
            largest_m = tuple(figures.max_distance_m[pair] for pair in PAIRS)
            rows.append(LawRow(law=law, source=FLOWN[model], largest_m=largest_m, settle_s=figures.settle_s))
    return rows
