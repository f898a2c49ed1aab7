"""Statistics of many flights with switching topologies, as data and as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from sitl.switching.topology import Topology

ARRIVED_M = 0.2


class LawSummary(Struct, frozen=True, kw_only=True):
    """Of all starts under one law with one hysteresis; `connected` counts those in which nobody was ever cut off.

    `lambda_min_median` and `lambda_min_5_percent` are of each flight's smallest lambda_min while it was connected.
    """

    law: str
    hysteresis_m: float
    starts: int
    connected: int
    connected_at_the_end: int
    arrived: int
    edges_lost_mean: float
    edges_lost_95_percent: float
    lambda_min_median: float
    lambda_min_5_percent: float
    cut_off_median_s: float | None  # of those that were cut off
    closest_median_m: float


def summarize(topologies: Sequence[Topology]) -> list[LawSummary]:
    """One for each law and hysteresis, in the order in which they come."""
    groups: dict[tuple[float, str], list[Topology]] = {}
    for topology in topologies:
        groups.setdefault((topology.hysteresis_m, topology.law), []).append(topology)
    return [
        _summary(law, hysteresis_m, group) for (hysteresis_m, law), group in sorted(groups.items(), key=_by_hysteresis)
    ]


def _by_hysteresis(group: tuple[tuple[float, str], list[Topology]]) -> float:
    return group[0][0]


def _summary(law: str, hysteresis_m: float, group: Sequence[Topology]) -> LawSummary:
    lost = [t.edges_lost for t in group]
    smallest = [t.lambda_min or 0.0 for t in group]
    cut_s = [t.cut_off_s for t in group if t.cut_off_s is not None]
    return LawSummary(
        law=law,
        hysteresis_m=hysteresis_m,
        starts=len(group),
        connected=len(group) - len(cut_s),
        connected_at_the_end=sum(t.connected_at_the_end for t in group),
        arrived=sum(t.final_error_m <= ARRIVED_M for t in group),
        edges_lost_mean=round(float(np.mean(lost)), 2),
        edges_lost_95_percent=round(float(np.percentile(lost, 95)), 1),
        lambda_min_median=round(float(np.median(smallest)), 4),
        lambda_min_5_percent=round(float(np.percentile(smallest, 5)), 4),
        cut_off_median_s=round(float(np.median(cut_s)), 2) if cut_s else None,
        closest_median_m=round(float(np.median([t.closest_m for t in group])), 3),
    )


def in_a_table(summaries: Sequence[LawSummary]) -> str:
    head = (
        f"{'law':<14}{'hysteresis':>11}{'connected':>11}{'at the end':>12}{'arrived':>9}"
        f"{'edges lost':>12}{'lambda_min':>12}{'its 5 %':>9}{'first cut':>11}"
    )
    return "\n".join([head, *(_row(summary) for summary in summaries)])


def _row(s: LawSummary) -> str:
    cut = "-" if s.cut_off_median_s is None else f"{s.cut_off_median_s:.1f} s"
    return (
        f"{s.law:<14}{s.hysteresis_m:>9.2f} m{_share(s.connected, s.starts):>11}{_share(s.connected_at_the_end, s.starts):>12}"
        f"{_share(s.arrived, s.starts):>9}{s.edges_lost_mean:>12.1f}"
        f"{s.lambda_min_median:>12.4f}{s.lambda_min_5_percent:>9.4f}{cut:>11}"
    )


def _share(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f} %"
