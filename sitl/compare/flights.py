"""The flights of a comparison as jobs: batches that fit in memory, and single flights of the real agents."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil

import numpy as np
from msgspec.structs import replace

from companion.analysis.interaction import FloatArray
from companion.config.fleet import EdgeNeighbours
from companion.types.flight import Role
from sitl.autopilots.types import hover_thrust_norm
from sitl.batch.agents import commanded_m_s2
from sitl.batch.columns import BoolArray
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.compare.figures import NOTHING, Figures, FlownFormation, failed, figures_of
from sitl.compare.plan import CellFlight
from sitl.flight.files import ids_of
from sitl.flight.scenario import Scenario, reference_of
from sitl.flight.virtual_flight import TAKE_OFF_S, Flown, JobProgress, fly_without_landing
from sitl.report.metrics import SAMPLE_S, reference_positions_m
from sitl.workers import report_progress

# A sample takes some 50 bytes while its figures are computed, a pair of vehicles some 500 bytes in flight with bad links:
# 300 MB per core.
MAX_SAMPLES = 6_000_000  # ticks x flights x vehicles
MAX_PAIRS = 400_000  # flights x vehicles x vehicles
# A batch with fewer columns takes as long as one with this many. The chunks must not depend on the number of cores, because
# that would change the last bits of the results; so there are enough of them for most machines.
MIN_COLUMNS = 1000
CHUNKS = 16
AGENTS_COST = 50.0  # work of a vehicle-second of an agent, relative to one of a batch, for progress
CONNECTED_EVERY = 5  # samples
CUT_SHORT_S = 0.5  # a formation that ends so much before its time was left


@dataclass(frozen=True, slots=True)
class FlightJob:
    """Flights of one batch, or one flight of the agents, with their numbers in the plan. Sent to a worker process."""

    numbers: tuple[int, ...]
    flights: tuple[CellFlight, ...]
    seconds: float
    by_agents: bool

    @property
    def work(self) -> float:
        """For progress, and to start the longest first."""
        vehicles = self.flights[0].cell.place.vehicles
        return len(self.flights) * vehicles * self.seconds * (AGENTS_COST if self.by_agents else 1.0)


def jobs_of(flights: Sequence[CellFlight], check: Sequence[CellFlight], seconds: float) -> list[FlightJob]:
    """Jobs for all flights, which are numbered as they come: first the flights, then those that agents fly to check."""
    kinds: dict[tuple[object, ...], list[int]] = {}
    single = list(range(len(flights), len(flights) + len(check)))
    for number, flight in enumerate(flights):
        if flight.by_agents:
            single.append(number)
        else:
            kinds.setdefault(_kind(flight), []).append(number)
    every = [*flights, *check]
    jobs = [
        FlightJob(own, tuple(every[number] for number in own), seconds, by_agents=False)
        for numbers in kinds.values()
        for own in _cut(
            sorted(
                numbers, key=lambda number: flights[number].cell.law
            ),  # vehicles with one law are asked about together
            chunk_size(len(numbers), flights[numbers[0]].cell.place.vehicles, seconds),
        )
    ]
    return jobs + [FlightJob((number,), (every[number],), seconds, by_agents=True) for number in single]


def chunk_size(flights: int, vehicles: int, duration_s: float) -> int:
    """Number of flights per batch for this number of flights in all."""
    ticks = ceil(duration_s / SAMPLE_S) + 1
    most = min(MAX_SAMPLES // (ticks * vehicles), MAX_PAIRS // vehicles**2)
    wanted = max(ceil(flights / CHUNKS), ceil(MIN_COLUMNS / vehicles))
    return max(1, min(most, wanted))


def _kind(flight: CellFlight) -> tuple[object, ...]:
    """Key of the flights that may share a batch: same size and attitude control, and same features that cost time."""
    scenario = flight.scenario
    is_random = scenario.links.peer_loss > 0.0 or scenario.links.peer_jitter_s > 0.0
    by_edges = isinstance(scenario.fleet.neighbours, EdgeNeighbours)
    return (flight.cell.place.vehicles, scenario.stand_in.airframe.attitude, is_random, by_edges)


def _cut(numbers: Sequence[int], size: int) -> Iterator[tuple[int, ...]]:
    """Parts of nearly equal size, at most `size`, so that no core works on a small remainder at the end."""
    parts = ceil(len(numbers) / size)
    ends = [len(numbers) * part // parts for part in range(parts + 1)]
    for begin, end in pairwise(ends):
        yield tuple(numbers[begin:end])


def fly_job(job: FlightJob) -> list[Figures]:
    """Figures in the order of the job's flights."""
    if job.by_agents:
        return [fly_by_agents(flight, job.seconds) for flight in job.flights]
    return fly_in_a_batch(job.flights, job.seconds)


def fly_in_a_batch(flights: Sequence[CellFlight], seconds: float) -> list[Figures]:
    """Figures of flights of one kind."""

    def progress(flown_s: float) -> None:
        report_progress(flown_s / seconds)

    scenarios = [flight.scenario for flight in flights]
    by_range = not isinstance(scenarios[0].fleet.neighbours, EdgeNeighbours)
    flown = fly_batch(scenarios, seconds, progress, sample_s=SAMPLE_S, keep_neighbours=by_range)
    every = [
        failed(flown.failures[b])
        if b in flown.failures
        else figures_of(_of_batch(flown, b, flight.scenario), flight.scenario, flight.repeats)
        for b, flight in enumerate(flights)
    ]
    return [replace(figures, remark=flown.remarks.get(b)) for b, figures in enumerate(every)]


def _of_batch(flown: BatchFlight, b: int, scenario: Scenario) -> FlownFormation:
    reference = flown.reference_of_formations_enu_m()
    uses = None if flown.neighbours is None else flown.neighbours[::CONNECTED_EVERY, b]
    return FlownFormation(
        times_s=flown.times_s,
        positions_enu_m=flown.positions_enu_m[:, b].astype(np.float64),
        reference_enu_m=reference[:, min(b, reference.shape[1] - 1)],
        slots_enu_m=flown.slots_enu_m[b],
        commanded_m_s2=flown.commanded_m_s2[:, b].astype(np.float64),
        connected=None if uses is None else connected(uses, _leads(scenario)),
    )


def connected(uses: BoolArray, leads: BoolArray) -> FloatArray:
    """Whether every vehicle had a path to a leader (T,). `uses` (T, n, n): whether i uses j; `leads` (n,)."""
    reached = np.broadcast_to(leads, uses.shape[:2]).copy()
    for _ in range(uses.shape[1] - 1):
        more = reached | (uses & reached[:, None, :]).any(axis=2)
        if (more == reached).all():
            break
        reached = more
    return np.asarray(reached.all(axis=1), dtype=np.float64)


def _leads(scenario: Scenario) -> BoolArray:
    roles = {member.id: member.role for member in scenario.fleet.vehicles}
    return np.array([roles[i] is Role.LEADER for i in ids_of(scenario)], dtype=np.bool_)


def fly_by_agents(flight: CellFlight, seconds: float) -> Figures:
    """One flight of the agents that fly real vehicles. Without figures where they never formed, or left the formation."""
    scenario = flight.scenario
    flown = fly_without_landing(scenario, JobProgress(TAKE_OFF_S + seconds))
    formation = flown.watch.formations[0] if flown.watch.formations else None
    if formation is None or formation.end_s - formation.start_s < seconds - CUT_SHORT_S:
        return NOTHING
    times_s: FloatArray = formation.start_s + np.arange(round(seconds / SAMPLE_S) + 1, dtype=np.float64) * SAMPLE_S
    times_s = times_s[times_s <= formation.end_s + SAMPLE_S]
    reference = reference_positions_m(reference_of(scenario), formation.reference_start_s, times_s)
    return figures_of(_of_agents(flown, scenario, times_s, reference), scenario, flight.repeats)


def _of_agents(flown: Flown, scenario: Scenario, times_s: FloatArray, reference_enu_m: FloatArray) -> FlownFormation:
    stand_ins = sorted(flown.stand_ins, key=lambda stand_in: stand_in.vehicle_id)
    commanded = []
    for stand_in in stand_ins:
        roll, pitch, _, thrust = np.nan_to_num(stand_in.setpoints()).T
        hover_norm = hover_thrust_norm(scenario.stand_in_of(stand_in.vehicle_id))
        sizes = commanded_m_s2(roll, pitch, thrust / hover_norm)
        commanded.append(np.interp(times_s, stand_in.track().time_s, sizes))
    slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    return FlownFormation(
        times_s=times_s - times_s[0],
        positions_enu_m=np.stack([stand_in.track().at(times_s) for stand_in in stand_ins], axis=1),
        reference_enu_m=reference_enu_m,
        slots_enu_m=np.array([slots[stand_in.vehicle_id] for stand_in in stand_ins]),
        commanded_m_s2=np.stack(commanded, axis=1),
        connected=None,
    )
