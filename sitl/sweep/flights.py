"""All flights of a sweep cut into chunks that fit memory, and one chunk flown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, isfinite

from msgspec import Struct
from msgspec.structs import replace

from companion.config.fleet import EdgeNeighbours
from sitl.batch.flight import fly_batch
from sitl.batch.metrics import batch_figures
from sitl.metrics import SAMPLE_S
from sitl.scenario import Scenario
from sitl.sweep.points import Point
from sitl.workers import tell

# A chunk's samples take some 50 bytes each while its figures are made, a pair of vehicles some 500 while it flies with
# bad links: 300 MB for each core.
MAX_SAMPLES = 6_000_000  # ticks x flights x vehicles
MAX_PAIRS = 400_000  # flights x vehicles x vehicles
# Fewer columns than this take as long as this many. Chunks must not depend on the number of cores, for that would show in
# the last bits; so there are enough of them for most machines.
MIN_COLUMNS = 500
CHUNKS = 16


class FlightFigures(Struct, frozen=True, kw_only=True):
    """One row of the table, by the definitions of sitl.batch.metrics. `settle_s` is None where it never settled, distances
    are where there are no two vehicles."""

    settle_s: float | None
    largest_neighbouring_distance_m: float | None
    smallest_neighbouring_distance_m: float | None
    smallest_distance_m: float | None
    final_error_m: float | None


@dataclass(frozen=True, slots=True)
class SeededFlight:
    """`point` is its place among the points."""

    point: int
    seed: int


@dataclass(frozen=True, slots=True)
class Chunk:
    """What is flown in one batch; it travels to another process. `scenarios` are those of the flights, in their order."""

    flights: tuple[SeededFlight, ...]
    scenarios: tuple[Scenario, ...]
    duration_s: float

    @property
    def work_s(self) -> float:
        """Seconds of formation to be flown."""
        return len(self.flights) * self.duration_s


def chunks_of(points: Sequence[Point], seeds: int, duration_s: float) -> list[Chunk]:
    """Every point with seeds 1 to `seeds`."""
    kinds: dict[tuple[object, ...], list[SeededFlight]] = {}
    for place, point in enumerate(points):
        alike = kinds.setdefault(_kind(point.scenario), [])
        alike.extend(SeededFlight(place, seed) for seed in range(1, seeds + 1))
    vehicles = len(points[0].scenario.fleet.vehicles)
    return [
        Chunk(own, tuple(_seeded(points[one.point].scenario, one.seed) for one in own), duration_s)
        for flights in kinds.values()
        for own in _cut(flights, chunk_size(len(flights), vehicles, duration_s))
    ]


def chunk_size(flights: int, vehicles: int, duration_s: float) -> int:
    """How many of so many flights go into one chunk."""
    ticks = ceil(duration_s / SAMPLE_S) + 1
    most = min(MAX_SAMPLES // (ticks * vehicles), MAX_PAIRS // vehicles**2)
    wanted = max(ceil(flights / CHUNKS), ceil(MIN_COLUMNS / vehicles))
    return max(1, min(most, wanted))


def _kind(scenario: Scenario) -> tuple[object, ...]:
    """Only one kind of attitude control can be in a batch; what costs time only some flights is better kept apart, too."""
    links, fleet = scenario.links, scenario.fleet
    by_chance = links.peer_loss > 0.0 or links.peer_jitter_s > 0.0
    return (scenario.stand_in.airframe.attitude, by_chance, isinstance(fleet.neighbours, EdgeNeighbours))


def _seeded(scenario: Scenario, seed: int) -> Scenario:
    return replace(scenario, stand_in=replace(scenario.stand_in, seed=seed))


def _cut(flights: Sequence[SeededFlight], size: int) -> Iterator[tuple[SeededFlight, ...]]:
    """As even as can be, `size` at most: the last core is not to be left with a small rest."""
    chunks = ceil(len(flights) / size)
    ends = [len(flights) * number // chunks for number in range(chunks + 1)]
    for begin, end in pairwise(ends):
        yield tuple(flights[begin:end])


def fly_chunk(chunk: Chunk) -> list[FlightFigures]:
    """In the order of the chunk's flights."""

    def flown(time_s: float) -> None:
        tell(time_s / chunk.duration_s)

    figures = batch_figures(fly_batch(chunk.scenarios, chunk.duration_s, flown, sample_s=SAMPLE_S))
    alone = len(chunk.scenarios[0].fleet.vehicles) == 1
    return [
        FlightFigures(
            settle_s=_rounded(figures.settle_s[b], 2),
            largest_neighbouring_distance_m=None if alone else _rounded(figures.largest_neighbouring_distance_m[b], 4),
            smallest_neighbouring_distance_m=_rounded(figures.smallest_neighbouring_distance_m[b], 4),
            smallest_distance_m=_rounded(figures.smallest_distance_m[b], 4),
            final_error_m=_rounded(figures.final_error_m[b], 4),
        )
        for b in range(len(chunk.flights))
    ]


def _rounded(value: float, digits: int) -> float | None:
    return round(float(value), digits) if isfinite(value) else None
