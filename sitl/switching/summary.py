"""Statistics of flights with switching topologies, as data and as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from sitl.report.folder import Column
from sitl.switching.topology import Topology

ARRIVED_M = 0.2
CAME_CLOSE_M = 0.3  # between centres; any real vehicles would collide


class LawSummary(Struct, frozen=True, kw_only=True):
    """Statistics of all starts under one law with one hysteresis.

    `connected`: flights in which all vehicles always had a path to the leader. `would_hand_over`: flights in which at least
    one agent would have handed over for a stale leader beacon; `vehicles_that_would`: the number of these vehicles.
    `came_close`: flights in which two vehicles came within CAME_CLOSE_M. `lambda_min_median` and `lambda_min_5_percent`:
    percentiles of the smallest lambda_min of each flight while it was connected.
    """

    law: str
    hysteresis_m: float
    starts: int
    connected: int
    connected_at_the_end: int
    would_hand_over: int
    vehicles_that_would: int
    arrived: int
    came_close: int
    closest_median_m: float
    edges_lost_mean: float
    lambda_min_median: float
    lambda_min_5_percent: float
    cut_off_median_s: float | None  # of the flights that were cut off


def summarize(topologies: Sequence[Topology]) -> list[LawSummary]:
    """One summary per hysteresis, rising, and law, in the order of the flights."""
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
        would_hand_over=sum(t.would_hand_over > 0 for t in group),
        vehicles_that_would=sum(t.would_hand_over for t in group),
        arrived=sum(t.final_error_m <= ARRIVED_M for t in group),
        came_close=sum(t.closest_m < CAME_CLOSE_M for t in group),
        closest_median_m=round(float(np.median([t.closest_m for t in group])), 3),
        edges_lost_mean=round(float(np.mean(lost)), 2),
        lambda_min_median=round(float(np.median(smallest)), 4),
        lambda_min_5_percent=round(float(np.percentile(smallest, 5)), 4),
        cut_off_median_s=round(float(np.median(cut_s)), 2) if cut_s else None,
    )


COLUMNS: tuple[Column, ...] = (
    ("law", "", -12),
    ("hyste-", "resis", 8),
    ("con-", "nected", 9),
    ("at the", "end", 9),
    ("would", "hand over", 11),
    ("", "arrived", 9),
    ("within", f"{CAME_CLOSE_M:g} m", 9),
    ("", "closest", 9),
    ("edges", "lost", 7),
    ("", "lambda_min", 12),
    ("its", "5 %", 8),
    ("first", "cut", 8),
)


def cells(s: LawSummary) -> tuple[str, ...]:
    return (
        s.law,
        f"{s.hysteresis_m:.2f} m",
        _share(s.connected, s.starts),
        _share(s.connected_at_the_end, s.starts),
        _share(s.would_hand_over, s.starts),
        _share(s.arrived, s.starts),
        _share(s.came_close, s.starts),
        f"{s.closest_median_m:.2f} m",
        f"{s.edges_lost_mean:.1f}",
        f"{s.lambda_min_median:.4f}",
        f"{s.lambda_min_5_percent:.4f}",
        "-" if s.cut_off_median_s is None else f"{s.cut_off_median_s:.1f} s",
    )


def _share(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f} %"


def limits_text(summaries: Sequence[LawSummary], vehicles: int) -> str:
    """Text: the limits of this simulation, and how many flights they affect."""
    flights = sum(s.starts for s in summaries)
    handed, silent, close = (
        sum(counts)
        for counts in zip(*((s.would_hand_over, s.vehicles_that_would, s.came_close) for s in summaries), strict=True)
    )
    return (
        f"These flights have no failsafe. In {handed} of {flights} flights at least one agent would have handed over to its "
        f"autopilot's\nhold for a stale leader beacon ({silent} of {flights * vehicles} vehicles). In {close} flights two "
        f"vehicles came within {CAME_CLOSE_M:g} m, where real\nvehicles would collide."
    )
