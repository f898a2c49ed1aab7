"""Claim on Algorithm 1, run tick by tick on all vehicles: the final PrCs, the time to reach them, and their limits."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from companion.core.consensus.law import next_prc
from companion.stability.interaction import Graph
from sitl.paper.theory.graphs import Led, connected_graphs, diameter, hops
from sitl.paper.theory.survey import SEED, GraphSurvey
from sitl.report.claim import Claim, ClaimVerdict, Progress, no_progress
from sitl.study.shapes import chain

Prcs = dict[int, int]


def ticks_to_settle(graph: Graph, leaders: Collection[int], start: Mapping[int, int]) -> tuple[Prcs, int]:
    """The final PrCs, and the ticks until they are reached; 2 n ticks are enough. Raises ValueError where they never settle."""
    n = len(graph)
    prcs = dict(start)
    for tick in range(2 * n + 1):
        update = {i: next_prc(i in leaders, (prcs[j] for j in graph[i]), n) for i in graph}
        if update == prcs:
            return prcs, tick
        prcs = update
    raise ValueError("these PrCs never settle")


def printed_prcs(graph: Graph, leaders: Collection[int]) -> Prcs:
    """PrCs by line 3 as printed, per[j] = p_i(k), where a vehicle uses its own PrC in place of its neighbours'."""
    n = len(graph)
    prcs = {i: 1 if i in leaders else n for i in graph}
    for _ in range(n):
        prcs = {i: next_prc(i in leaders, [prcs[i]] * len(graph[i]), n) for i in graph}
    return prcs


def algorithm_1(survey: GraphSurvey, progress: Progress = no_progress) -> Claim:
    """p_i = hops + 1 within diameter + 1 ticks, from p = n at all vehicles including leaders, and from random PrCs."""
    random = np.random.default_rng(SEED)
    wrong = late = late_from_any = printed_right = 0
    slowest = -np.inf
    for index, spectra in enumerate(survey.all):
        graph, leaders = spectra.pair.graph, spectra.pair.leaders
        n, limit = len(graph), diameter(graph) + 1
        right = {i: distance + 1 for i, distance in hops(graph, leaders).items()}
        settled, ticks = ticks_to_settle(graph, leaders, dict.fromkeys(graph, n))
        from_any, ticks_from_any = ticks_to_settle(graph, leaders, {i: int(random.integers(1, n + 1)) for i in graph})
        wrong += settled != right or from_any != right
        late += ticks > limit
        late_from_any += ticks_from_any > limit
        slowest = max(slowest, ticks - limit, ticks_from_any - limit)
        printed_right += printed_prcs(graph, leaders) == right
        if index % 100 == 0:
            progress(index / len(survey.all))
    no_leader = _without_leader(survey)
    climbs = no_leader["graphs_without_leader_at_n"] == no_leader["graphs_without_leader"]
    good = not wrong and not late and not late_from_any
    pairs = len(survey.all)
    return Claim(
        id="algorithm-1",
        where="Algorithm 1",
        claim="every vehicle finds p_i = its distance of vertices to the nearest leader + 1 from its neighbours' PrCs alone",
        paper="p_i = d_i + 1; no statement on the time",
        ideal=f"correct on {pairs - wrong} of {pairs} pairs, and within diameter + 1 ticks on "
        f"{pairs - max(late, late_from_any)}, both from p = n and from random PrCs, on {survey.extent()}",
        full="-",
        verdict=ClaimVerdict.CONDITION if good and climbs else ClaimVerdict.HOLDS if good else ClaimVerdict.FAILS,
        remark="line 3 must read p_j(k): as printed every follower stays at n, which is correct on "
        f"{printed_right} pairs only.{_leader_loss_text(survey.most_vertices) if climbs else ''}",
        measured=survey.counts()
        | {
            "pairs_wrong": float(wrong),
            "pairs_late": float(late),
            "pairs_late_from_random_start": float(late_from_any),
            "slowest_ticks_beyond_diameter_plus_1": float(slowest),
            "pairs_right_as_printed": float(printed_right),
        }
        | no_leader,
    )


def _without_leader(survey: GraphSurvey) -> dict[str, float]:
    """Counts for every small connected graph that has just lost its leader: all PrCs start at 1."""
    graphs = [graph for n in range(2, survey.most_vertices + 1) for graph in connected_graphs(n)]
    settled = [ticks_to_settle(graph, (), dict.fromkeys(graph, 1)) for graph in graphs]
    at_n = sum(set(prcs.values()) == {len(graph)} for graph, (prcs, _) in zip(graphs, settled, strict=True))
    return {
        "graphs_without_leader": float(len(graphs)),
        "graphs_without_leader_at_n": float(at_n),
        "most_ticks_of_the_climb": float(max(ticks for _, ticks in settled)),
    }


def _leader_loss_text(n: int) -> str:
    return (
        " A leader is required: without one the PrC climbs by one per tick to n and stays there. "
        f"{_end_of_chain(n)} is also the PrC at the end of a chain of {n}, so the PrC alone does not show the loss of a leader"
    )


def _end_of_chain(n: int) -> int:
    """PrC of the last vehicle of a chain with the first as the leader."""
    pair = Led(chain(n).adjacency(), frozenset({1}))
    return ticks_to_settle(pair.graph, pair.leaders, dict.fromkeys(pair.graph, n))[0][n]
