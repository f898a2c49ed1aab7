"""Flies the random starts under every law in batches on all cores, and analyses their topologies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.config.fleet import RangeNeighbours as Range
from companion.config.law import LawName, LawSection, feedback_law_of
from companion.core.election.leadership import TURN_S
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.study.cases import closest_m
from sitl.switching.starts import Start
from sitl.switching.topology import Spectra, Topology, losses, mutual, over_time, without_beacon
from sitl.workers import Workers, all_results

LAWS: tuple[LawName, ...] = ("average_26", "average_22", "weighted", "cooperative")
SAMPLE_S = 0.1
IN_A_BATCH = 200


@dataclass(frozen=True, slots=True)
class Plan:
    """One batch: starts under one law with one hysteresis."""

    law: LawName
    starts: tuple[Start, ...]
    range_m: float
    hysteresis_m: float
    duration_s: float


def plans(starts: Sequence[Start], range_m: float, hystereses_m: Sequence[float], duration_s: float) -> list[Plan]:
    """The batches for every start under every law with every hysteresis."""
    return [
        Plan(law, tuple(starts[first : first + IN_A_BATCH]), range_m, hysteresis_m, duration_s)
        for first in range(0, len(starts), IN_A_BATCH)
        for hysteresis_m in hystereses_m
        for law in LAWS
    ]


def fly_all(workers: Workers, planned: list[Plan], progress: Callable[[float], None]) -> list[Topology]:
    """Topologies in the order of the plans and their starts. Calls `progress` with the share done, 0 to 1."""
    return [topology for batch in all_results(workers, fly, planned, progress) for topology in batch]


def fly(plan: Plan) -> list[Topology]:
    """Fly and analyse one batch."""
    neighbours = Range(range_m=plan.range_m, hysteresis_m=plan.hysteresis_m)
    scenarios = [start.scenario(plan.law, neighbours) for start in plan.starts]
    flight = fly_batch(scenarios, plan.duration_s, sample_s=SAMPLE_S, keep_neighbours=True)
    spectra = Spectra(feedback_law_of(LawSection(name=plan.law)), len(plan.starts[0].starts_enu_m))
    final_errors_m = flight.errors_m()[-1].max(axis=1)
    beacon_lost_s = scenarios[0].fleet.peers.leader_beacon_max_age_s + TURN_S  # after this time an agent hands over
    return [
        _topology(plan, flight, index, spectra, float(final_errors_m[index]), beacon_lost_s)
        for index in range(len(plan.starts))
    ]


def _topology(
    plan: Plan, flight: BatchFlight, index: int, spectra: Spectra, final_error_m: float, beacon_lost_s: float
) -> Topology:
    assert flight.neighbours is not None
    uses = flight.neighbours[:, index]
    edges = mutual(uses)
    values = over_time(edges, spectra)
    connected = [value for value in values if value is not None]
    cut = next((k for k, value in enumerate(values) if value is None), None)
    positions = flight.positions_enu_m[:, index].astype(np.float64)
    return Topology(
        law=plan.law,
        seed=plan.starts[index].seed,
        hysteresis_m=plan.hysteresis_m,
        edges_lost=losses(edges),
        lambda_min=round(min(connected), 6) if connected else None,
        cut_off_s=None if cut is None else round(float(flight.times_s[cut]), 2),
        connected_at_the_end=values[-1] is not None,
        final_error_m=round(final_error_m, 3),
        would_hand_over=without_beacon(uses, SAMPLE_S, beacon_lost_s),
        closest_m=round(closest_m(positions), 3),
    )
