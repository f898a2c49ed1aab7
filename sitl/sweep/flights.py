"""The flights of a sweep, divided into chunks that fit in memory, and the flight of one chunk."""

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
from sitl.flight.scenario import Scenario
from sitl.report.metrics import SAMPLE_S
from sitl.sweep.points import Point
from sitl.workers import report_progress

# A sample takes some 50 bytes while its figures are computed, a pair of vehicles some 500 bytes in flight with bad links:
# 300 MB per core.
MAX_SAMPLES = 6_000_000  # ticks x flights x vehicles
MAX_PAIRS = 400_000  # flights x vehicles x vehicles
# A batch with fewer columns takes as long as one with this many. The chunks must not depend on the number of cores, because
# that would change the last bits of the results; so there are enough of them for most machines.
MIN_COLUMNS = 500
CHUNKS = 16


class FlightFigures(Struct, frozen=True, kw_only=True):
    """Figures of one flight, as defined in sitl.batch.metrics.

    `settle_s` is None for a flight that never settled; distances are None for a single vehicle.
    """

    settle_s: float | None
    largest_neighbouring_distance_m: float | None
    smallest_neighbouring_distance_m: float | None
    smallest_distance_m: float | None
    final_error_m: float | None


@dataclass(frozen=True, slots=True)
class SeededFlight:
    """One flight: the index of its point, and its seed."""

    point: int
    seed: int


@dataclass(frozen=True, slots=True)
class Chunk:
    """The flights of one batch, with the scenario of each, in the same order. Sent to a worker process."""

    flights: tuple[SeededFlight, ...]
    scenarios: tuple[Scenario, ...]
    duration_s: float

    @property
    def work_s(self) -> float:
        """Virtual seconds of all flights together."""
        return len(self.flights) * self.duration_s


def chunks_of(points: Sequence[Point], seeds: int, duration_s: float) -> list[Chunk]:
    """Chunks for every point with seeds 1 to `seeds`."""
    kinds: dict[tuple[object, ...], list[SeededFlight]] = {}
    for index, point in enumerate(points):
        alike = kinds.setdefault(_kind(point.scenario), [])
        alike.extend(SeededFlight(index, seed) for seed in range(1, seeds + 1))
    vehicles = len(points[0].scenario.fleet.vehicles)
    return [
        Chunk(own, tuple(_seeded(points[one.point].scenario, one.seed) for one in own), duration_s)
        for flights in kinds.values()
        for own in _cut(flights, chunk_size(len(flights), vehicles, duration_s))
    ]


def chunk_size(flights: int, vehicles: int, duration_s: float) -> int:
    """Number of flights per chunk for this number of flights in all."""
    ticks = ceil(duration_s / SAMPLE_S) + 1
    most = min(MAX_SAMPLES // (ticks * vehicles), MAX_PAIRS // vehicles**2)
    wanted = max(ceil(flights / CHUNKS), ceil(MIN_COLUMNS / vehicles))
    return max(1, min(most, wanted))


def _kind(scenario: Scenario) -> tuple[object, ...]:
    """Key of the flights that may share a batch: same attitude control, and same features that cost time."""
    links, fleet = scenario.links, scenario.fleet
    is_random = links.peer_loss > 0.0 or links.peer_jitter_s > 0.0
    return (scenario.stand_in.airframe.attitude, is_random, isinstance(fleet.neighbours, EdgeNeighbours))


def _seeded(scenario: Scenario, seed: int) -> Scenario:
    return replace(scenario, stand_in=replace(scenario.stand_in, seed=seed))


def _cut(flights: Sequence[SeededFlight], size: int) -> Iterator[tuple[SeededFlight, ...]]:
    """Chunks of nearly equal size, at most `size`, so that no core works on a small remainder at the end."""
    chunks = ceil(len(flights) / size)
    ends = [len(flights) * number // chunks for number in range(chunks + 1)]
    for begin, end in pairwise(ends):
        yield tuple(flights[begin:end])


def fly_chunk(chunk: Chunk) -> list[FlightFigures]:
    """Figures in the order of the chunk's flights."""

    def progress(flown_s: float) -> None:
        report_progress(flown_s / chunk.duration_s)

    figures = batch_figures(fly_batch(chunk.scenarios, chunk.duration_s, progress, sample_s=SAMPLE_S))
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
