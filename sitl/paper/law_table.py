"""The platoon in figures, law by law: the equations alone beside the agents that flew."""

from __future__ import annotations

from msgspec import Struct

from sitl.paper.book import PERFECT, Book
from sitl.paper.flights import COMPARED, Model, Subject
from sitl.paper.ideal_model import ideal_figures
from sitl.paper.platoon_claims import PAIRS

HEARD_LATE_S = 0.01  # agents tick every 0.02 s, not together: what a neighbour says is half of that old in the mean
FLOWN = {Model.IDEAL: "agents, ideal model", Model.FULL: "agents, full quadrotor"}


class LawRow(Struct, frozen=True, kw_only=True):
    """Largest distances [m] in the order of PAIRS and the time to settle to 10 cm [s], None where it never did."""

    law: str
    source: str
    largest_m: tuple[float, ...]
    settle_s: float | None


def law_table(book: Book) -> list[LawRow]:
    rows = []
    for law in COMPARED:
        flown = book.one(Subject.PLATOON, law, Model.IDEAL).flown
        for source, late_s in (("equations", 0.0), (f"equations, neighbours {HEARD_LATE_S:g} s late", HEARD_LATE_S)):
            ideal = ideal_figures(flown, late_s)
            largest_m = tuple(ideal.max_distance_m[pair] for pair in PAIRS)
            rows.append(LawRow(law=law, source=source, largest_m=largest_m, settle_s=ideal.settle_s))
        for model in PERFECT:
            figures = book.one(Subject.PLATOON, law, model).figures
            largest_m = tuple(figures.max_distance_m[pair] for pair in PAIRS)
            rows.append(LawRow(law=law, source=FLOWN[model], largest_m=largest_m, settle_s=figures.settle_s))
    return rows
