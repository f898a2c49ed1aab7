"""The report's figures: which there are, what they show, and which claims are read off them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sitl.paper.book import Book
from sitl.paper.latency_figure import save_latency
from sitl.paper.plan_figures import save_figure_4, save_figure_9, save_figure_10
from sitl.paper.platoon_figures import save_figure_5, save_figure_6, save_figure_7, save_figure_8


@dataclass(frozen=True, slots=True)
class Picture:
    """`claim_ids` are shown beside it: what the paper states, with our verdict."""

    file: str
    heading: str
    shows: str
    claim_ids: tuple[str, ...]
    save: Callable[[Path, Book], None]


PICTURES = (
    Picture(
        "figure_4.png",
        "Figure 4: aggregation",
        "Paths from above, of the ideal model (upper row) and the full quadrotor (lower row). Left the law that the paper "
        "names for its comparison, in the middle the average law of its proofs, right the weighted law. Edges join those that "
        "see each other at the end.",
        ("fig-4-average", "fig-4-weighted", "fig-4-robust", "average-law"),
        save_figure_4,
    ),
    Picture(
        "figure_5.png",
        "Figure 5: x and y of the platoon",
        "True positions. The paper's left picture is one of the two average laws here, its right one is the weighted law.",
        ("fig-5-faster", "latency-hops"),
        save_figure_5,
    ),
    Picture(
        "figure_6.png",
        "Figure 6: inter-distances of the platoon",
        "All panels share one scale. The claims below say which average law fits the paper's left picture, with its peak of "
        "1.8 m.",
        ("fig-6-average", "fig-6-weighted-d12", "fig-6-weighted-d23-d34", "fig-6-one-peak", "fig-6-faster"),
        save_figure_6,
    ),
    Picture(
        "figure_7.png",
        "Figure 7: the platoon with take-off and landing",
        "A whole flight of the full quadrotor with sensor noise takes the place of the paper's experiment. The cooperation "
        "works in the shaded time; before and after it every vehicle flies by its own autopilot.",
        ("fig-7-response",),
        save_figure_7,
    ),
    Picture(
        "figure_8.png",
        "Figure 8: inter-distances with take-off and landing",
        "The same flights. The largest distances are those of the cooperation.",
        ("fig-8-peak",),
        save_figure_8,
    ),
    Picture(
        "figure_9.png",
        "Figure 9: a square on the figure of eight",
        "One snapshot in the middle of every lead, full quadrotor. The square's centre is to follow the 8.",
        ("fig-9",),
        save_figure_9,
    ),
    Picture(
        "figure_10.png",
        "Figure 10: topology and weights",
        "Before the first change of lead, and after the last report that it changed. The number near a vehicle on an "
        "edge is the weight that this vehicle gives the other one; it follows from the PrCs that they reported.",
        ("fig-10-matrices", "fig-10-at-once", "section-5.2"),
        save_figure_10,
    ),
    Picture(
        "latency.png",
        "Section 5.2: latency of the followers",
        "The vehicle across the square from the leader is two hops away: UAV 3 while UAV 1 leads, UAV 4 while UAV 2 does.",
        ("latency-diagonal", "latency-reduced"),
        save_latency,
    ),
)
