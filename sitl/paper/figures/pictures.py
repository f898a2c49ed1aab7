"""List of the report's figures, with captions and the claims that they show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sitl.paper.book import Book
from sitl.paper.figures.latency import save_latency
from sitl.paper.figures.plan import save_figure_4, save_figure_9, save_figure_10
from sitl.paper.figures.platoon import save_figure_5, save_figure_6, save_figure_7, save_figure_8


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """One figure of the report. The claims of `claim_ids` are shown below it."""

    file: str
    heading: str
    shows: str
    claim_ids: tuple[str, ...]
    save: Callable[[Path, Book], None]


PICTURES = (
    PaperFigure(
        "figure_4.png",
        "Figure 4: aggregation",
        "Paths in plan view, of the ideal model (upper row) and the full quadrotor (lower row). Left: the average law that the "
        "paper names for its comparison. Middle: the average law of its proofs. Right: the weighted law. Edges join vehicles "
        "in range of each other at the end.",
        ("fig-4-average", "fig-4-weighted", "fig-4-robust", "average-law"),
        save_figure_4,
    ),
    PaperFigure(
        "figure_5.png",
        "Figure 5: x and y of the platoon",
        "True positions. The left panel of the paper's figure is one of the two average laws, the right one the weighted law.",
        ("fig-5-faster", "latency-hops"),
        save_figure_5,
    ),
    PaperFigure(
        "figure_6.png",
        "Figure 6: inter-distances of the platoon",
        "All panels have the same scale. The claims below show which average law fits the left panel of the paper's figure, "
        "with its peak of 1.8 m.",
        ("fig-6-average", "fig-6-weighted-d12", "fig-6-weighted-d23-d34", "fig-6-one-peak", "fig-6-faster"),
        save_figure_6,
    ),
    PaperFigure(
        "figure_7.png",
        "Figure 7: the platoon with take-off and landing",
        "A whole flight of the full quadrotor with sensor noise, in place of the paper's experiment. In the shaded time the "
        "vehicles are in formation; before and after it each flies in a mode of its autopilot.",
        ("fig-7-response",),
        save_figure_7,
    ),
    PaperFigure(
        "figure_8.png",
        "Figure 8: inter-distances with take-off and landing",
        "The same flights. The largest distances are of the time in formation.",
        ("fig-8-peak",),
        save_figure_8,
    ),
    PaperFigure(
        "figure_9.png",
        "Figure 9: a square on the figure of eight",
        "One snapshot in the middle of every leadership, full quadrotor. The centre of the square follows the 8.",
        ("fig-9",),
        save_figure_9,
    ),
    PaperFigure(
        "figure_10.png",
        "Figure 10: topology and weights",
        "Before the first leader change, and after the last report that it changed. The number near a vehicle on an edge is "
        "the weight that this vehicle gives the other one, computed from the reported PrCs.",
        ("fig-10-matrices", "fig-10-at-once", "section-5.2"),
        save_figure_10,
    ),
    PaperFigure(
        "latency.png",
        "Section 5.2: latency of the followers",
        "The vehicle opposite to the leader is two hops away: UAV 3 with UAV 1 as the leader, UAV 4 with UAV 2.",
        ("latency-diagonal", "latency-reduced"),
        save_latency,
    ),
)
