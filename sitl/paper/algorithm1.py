"""Algorithm 1, run tick by tick on every vehicle at once: what PrC comes to, how soon, and what it cannot say."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from companion.core.interaction import Graph
from companion.core.priority import next_prc
from sitl.paper.claims import Claim, Progress, Verdict, no_progress
from sitl.paper.graphs import Led, connected_graphs, diameter, hops
from sitl.paper.survey import SEED, Survey
from sitl.shapes import chain

Prcs = dict[int, int]


def ticks_to_settle(graph: Graph, leaders: Collection[int], start: Mapping[int, int]) -> tuple[Prcs, int]:
    """The PrCs that stay, and after how many ticks they are first met. 2 n ticks are enough for anything that settles."""
    n = len(graph)
    prcs = dict(start)
    for tick in range(2 * n + 1):
        update = {i: next_prc(i in leaders, (prcs[j] for j in graph[i]), n) for i in graph}
        if update == prcs:
            return prcs, tick
        prcs = update
    raise ValueError("these PrCs never settle")


def printed_prcs(graph: Graph, leaders: Collection[int]) -> Prcs:
    """What line 3 as printed comes to: per[j] = p_i(k), so that a vehicle looks at its own PrC in place of its neighbours'."""
    n = len(graph)
    prcs = {i: 1 if i in leaders else n for i in graph}
    for _ in range(n):
        prcs = {i: next_prc(i in leaders, [prcs[i]] * len(graph[i]), n) for i in graph}
    return prcs


def algorithm_1(survey: Survey, progress: Progress = no_progress) -> Claim:
    """From p = n everywhere, the leaders too, and from any PrCs at all: p_i = hops + 1 within diameter + 1 ticks."""
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
        paper="p_i = d_i + 1; no word on how soon",
        ideal=f"right on {pairs - wrong} of {pairs} pairs and within diameter + 1 ticks on "
        f"{pairs - max(late, late_from_any)}, both from p = n and from random PrCs, on {survey.extent()}",
        full="-",
        verdict=Verdict.CONDITION if good and climbs else Verdict.HOLDS if good else Verdict.FAILS,
        remark="line 3 must read p_j(k): as printed every follower stays at n, which is right on "
        f"{printed_right} pairs alone.{_no_word_of_it(survey.most_vertices) if climbs else ''}",
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


def _without_leader(survey: Survey) -> dict[str, float]:
    """Every small connected graph whose leader has just gone: all PrCs start at 1."""
    graphs = [graph for n in range(2, survey.most_vertices + 1) for graph in connected_graphs(n)]
    settled = [ticks_to_settle(graph, (), dict.fromkeys(graph, 1)) for graph in graphs]
    at_n = sum(set(prcs.values()) == {len(graph)} for graph, (prcs, _) in zip(graphs, settled, strict=True))
    return {
        "graphs_without_leader": float(len(graphs)),
        "graphs_without_leader_at_n": float(at_n),
        "most_ticks_of_the_climb": float(max(ticks for _, ticks in settled)),
    }


def _no_word_of_it(n: int) -> str:
    return (
        " And there must be a leader: without one PrC climbs by one a tick to n and stays, and "
        f"{_end_of_chain(n)} is also the PrC at the end of a chain of {n}, so PrC alone cannot say that the leader is gone"
    )


def _end_of_chain(n: int) -> int:
    """PrC of the last vehicle of a chain that the first one leads."""
    pair = Led(chain(n).adjacency(), frozenset({1}))
    return ticks_to_settle(pair.graph, pair.leaders, dict.fromkeys(pair.graph, n))[0][n]
