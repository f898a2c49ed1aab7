"""Options of `sitl sweep`. Light to import."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

DEFAULT_SEEDS = 20  # with fewer, 5 and 95 percent are the extremes
MAX_FLIGHTS = 100_000
SHORTEST_S, LONGEST_S = 2.0, 3600.0  # "final" and "settled" are taken over the last 2 s


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """`seconds` is None to take the scenario's; `cluster` is None to fly on all cores of this machine."""

    scenario: Path
    varied: Sequence[str] = ()
    seeds: int = DEFAULT_SEEDS
    seconds: float | None = None
    overrides: Sequence[str] = ()
    out: Path | None = None
    quiet: bool = False
    cluster: str | None = None
    processes: int | None = None
