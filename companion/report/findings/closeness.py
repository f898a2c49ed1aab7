"""Too close: pairs of vehicles in the air nearer than `separation_m`, by their recorded positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from companion.report.distances import PairDistance
from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.intervals import runs
from companion.types.notices import Code

ENCOUNTERS_APART_S = 2.0  # what is nearer again within this time is the same encounter


def too_close(pairs: Sequence[PairDistance], separation_m: float | None) -> Iterator[Finding]:
    """One finding for each encounter. None can be judged without `separation_m`."""
    if separation_m is None:
        return
    for pair in pairs:
        distance_m = np.where(pair.judged, pair.distance_m, np.inf)
        for episode in runs(pair.time_s, distance_m < separation_m, ENCOUNTERS_APART_S):
            row = episode.first + int(np.argmin(distance_m[episode.first : episode.last + 1]))
            a, b = pair.pair
            text = (
                f"vehicles {a} and {b} were {distance_m[row]:.2f} m apart at {pair.time_s[row]:.1f} s,"
                f" separation_m is {separation_m:g} m"
            )
            yield finding(
                FindingKind.CLOSE,
                Severity.CRITICAL,
                Code.SEPARATION_VIOLATED,
                a,
                episode.interval.begins_s,
                text,
                episode.held_s,
            )
