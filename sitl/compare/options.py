"""Options of `sitl compare`. Light to import."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

DEFAULT_LAWS = ("average_22", "weighted", "cooperative")
DEFAULT_GRAPHS = ("chain", "ring", "grid", "random")
DEFAULT_CONDITIONS = ("ideal", "noise", "delay_loss", "step")
DEFAULT_VEHICLES, MOST_VEHICLES = (8,), 100
DEFAULT_SEEDS, DEFAULT_S = 10, 30.0
MAX_FLIGHTS = 100_000
SHORTEST_S, LONGEST_S = 4.0, 3600.0  # "final" and "settled" are taken over the last 2 s


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareOptions:
    """With a `scenario` its fleet is the only graph, and empty `laws` are its own; `seconds` None takes those of its form step.

    `cluster` is None to fly on the cores of this machine; `lockstep`: cells that the agents fly as well.
    """

    scenario: Path | None = None
    laws: Sequence[str] = ()
    graphs: Sequence[str] = ()
    conditions: Sequence[str] = ()
    vehicles: Sequence[int] = ()
    varied: Sequence[str] = ()
    overrides: Sequence[str] = ()
    seeds: int = DEFAULT_SEEDS
    seconds: float | None = None
    lockstep: int = 0
    out: Path | None = None
    quiet: bool = False
    cluster: str | None = None
    processes: int | None = None
