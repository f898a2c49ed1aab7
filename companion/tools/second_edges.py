"""Neighbours two hops ahead, heard directly: half the hops, so that less of the leader's motion is amplified on its way."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

from msgspec import Struct

from companion.analysis.margins import StringGains
from companion.analysis.response import Graph, settled_prcs

GROWS = 1.005  # of a gain: 1 to two decimals
MOST_VEHICLES = 100


class SecondEdges(Struct, frozen=True):
    """Edges to add to `neighbours.edges`, and the string gains without and with them."""

    edges: list[tuple[int, int]]
    per_hop: float
    per_hop_with: float
    to_last: float
    to_last_with: float


def second_edges(
    graph: Graph, leaders: Collection[int], gains: StringGains, gains_of: Callable[[Graph], StringGains | None]
) -> SecondEdges | None:
    """The edges to vehicles two hops ahead. None where no gain is above 1, and where they do not help.

    `gains` are those of the graph; `gains_of` computes those of another one, None where it is unstable.
    """
    if max(gains.per_hop, gains.to_last) <= GROWS or len(graph) > MOST_VEHICLES:
        return None
    edges = list(_two_hops_ahead(graph, settled_prcs(graph, leaders)))
    more = {i: list(neighbours) for i, neighbours in graph.items()}
    for a, b in edges:
        more[a], more[b] = sorted([*more[a], b]), sorted([*more[b], a])
    with_them = gains_of(more) if edges else None
    if with_them is None or with_them.to_last >= gains.to_last:
        return None
    return SecondEdges(edges, gains.per_hop, with_them.per_hop, gains.to_last, with_them.to_last)


def _two_hops_ahead(graph: Graph, prcs: dict[int, int]) -> Iterator[tuple[int, int]]:
    """For each vehicle the one with the least id of those that its neighbours ahead follow."""
    for i in sorted(graph):
        ahead = [j for j in graph[i] if prcs[j] == prcs[i] - 1]
        further = {k for j in ahead for k in graph[j] if prcs[k] == prcs[i] - 2} - set(graph[i])
        if further:
            yield min(further), i
