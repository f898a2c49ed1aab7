"""Graphs for the checks of the theory: all small connected ones, random larger ones, and a constructed counterexample."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations, pairwise, permutations
from math import dist

import numpy as np

from companion.stability.interaction import Graph
from companion.types.values import Vector3

Edge = tuple[int, int]
FEWEST_RANDOM, MOST_RANDOM = 8, 40  # vertices of a random graph; smaller graphs are all enumerated


@dataclass(frozen=True, slots=True)
class Led:
    """A graph and its leaders: "pair" in the claims."""

    graph: Graph
    leaders: frozenset[int]


def graph_of(vertices: Iterable[int], edges: Iterable[Edge]) -> dict[int, set[int]]:
    graph: dict[int, set[int]] = {vertex: set() for vertex in vertices}
    for a, b in edges:
        graph[a].add(b)
        graph[b].add(a)
    return graph


def within_range(positions_m: Mapping[int, Vector3], range_m: float) -> Graph:
    """Graph with edges between vertices within `range_m`, as in the paper's aggregation."""
    close = [(a, b) for a, b in combinations(positions_m, 2) if dist(positions_m[a], positions_m[b]) <= range_m]
    return graph_of(positions_m, close)


@cache
def connected_graphs(n: int) -> tuple[Graph, ...]:
    """Every connected graph of n vertices up to isomorphism: 1, 1, 2, 6, 21, 112, 853 of them for n = 1 to 7.

    Every connected graph has a vertex whose removal leaves it connected, so all follow from those of n - 1 vertices and a new
    vertex. Two graphs are isomorphic if a renumbering makes their edges equal. Each is identified by its least number over all
    renumberings, whose bits are the edges.
    """
    if n == 1:
        return (graph_of([1], []),)
    pairs = list(combinations(range(1, n + 1), 2))
    bit_after = _bits_of_renumbered_edges(n, pairs)
    least: set[int] = set()
    for smaller in connected_graphs(n - 1):
        old = [edge for edge in pairs if edge[1] in smaller[edge[0]]] if n > 2 else []
        for joined in _subsets(range(1, n)):
            columns = [pairs.index(edge) for edge in [*old, *((vertex, n) for vertex in joined)]]
            least.add(int(bit_after[:, columns].sum(axis=1).min()))
    ones = ([pair for bit, pair in enumerate(pairs) if number >> bit & 1] for number in sorted(least))
    return tuple(graph_of(range(1, n + 1), edges) for edges in ones)


def _bits_of_renumbered_edges(n: int, pairs: list[Edge]) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """[renumbering, edge] -> the bit of the edge after the renumbering."""
    number = {pair: 1 << bit for bit, pair in enumerate(pairs)}
    rows = [
        [number[min(new[a - 1], new[b - 1]), max(new[a - 1], new[b - 1])] for a, b in pairs]
        for new in permutations(range(1, n + 1))
    ]
    return np.array(rows, dtype=np.int64)


def _subsets(items: Collection[int]) -> Iterator[tuple[int, ...]]:
    """All non-empty subsets."""
    for size in range(1, len(items) + 1):
        yield from combinations(items, size)


def every_small_pair(most_vertices: int) -> Iterator[Led]:
    """Every connected graph of 2 to `most_vertices` vertices with every non-empty set of leaders, small graphs first.

    A single vertex has no neighbours and therefore no weights; it is left out.
    """
    for n in range(2, most_vertices + 1):
        for graph in connected_graphs(n):
            for leaders in _subsets(range(1, n + 1)):
                yield Led(graph, frozenset(leaders))


def random_connected(random: np.random.Generator, first: int = 1, n: int | None = None) -> Graph:
    """A random tree, between a chain and a star, with some additional edges. Vertices are numbered from `first`."""
    n = n or int(random.integers(FEWEST_RANDOM, MOST_RANDOM + 1))
    reach = int(random.integers(1, max(n, 2)))  # 1 makes a chain
    edges = {(int(random.integers(max(0, i - reach), i)), i) for i in range(1, n)}
    for _ in range(int(random.integers(0, 2 * n)) if n > 1 else 0):
        a, b = (int(vertex) for vertex in random.choice(n, 2, replace=False))
        edges.add((a, b))
    return graph_of(range(first, first + n), [(first + a, first + b) for a, b in edges])


def random_leaders(random: np.random.Generator, graph: Graph) -> frozenset[int]:
    """One leader with probability 1/2, else a random number of leaders."""
    count = 1 if random.random() < 0.5 else int(random.integers(1, len(graph) + 1))
    return frozenset(int(vertex) for vertex in random.choice(sorted(graph), count, replace=False))


def random_pairs(random: np.random.Generator, count: int) -> Iterator[Led]:
    for _ in range(count):
        graph = random_connected(random)
        yield Led(graph, random_leaders(random, graph))


def random_parts(random: np.random.Generator) -> list[Led]:
    """Two to four disjoint connected graphs, each with leaders: the parts of Lemma 1."""
    parts: list[Led] = []
    first = 1
    for _ in range(int(random.integers(2, 5))):
        graph = random_connected(random, first, int(random.integers(1, FEWEST_RANDOM + 1)))
        parts.append(Led(graph, random_leaders(random, graph)))
        first += len(graph)
    return parts


def united(parts: Iterable[Led]) -> Led:
    graph: dict[int, Collection[int]] = {}
    leaders: frozenset[int] = frozenset()
    for part in parts:
        graph |= part.graph
        leaders |= part.leaders
    return Led(graph, leaders)


def described(pair: Led) -> str:
    """Text: all edges and leaders of a small pair, the size of a large one."""
    n = len(pair.graph)
    edges = [f"{a}-{b}" for a in sorted(pair.graph) for b in sorted(pair.graph[a]) if a < b]
    if n >= FEWEST_RANDOM:
        count = len(pair.leaders)
        return f"a graph of {n} vertices and {len(edges)} edges with {count} leader{'' if count == 1 else 's'}"
    leaders = " and ".join(str(leader) for leader in sorted(pair.leaders))
    return f"the graph {', '.join(edges)} with leader{'' if len(pair.leaders) == 1 else 's'} {leaders}"


def hops(graph: Graph, sources: Collection[int]) -> dict[int, int]:
    """Distance of vertices (DOV) to the nearest of `sources`, by breadth-first search instead of Algorithm 1."""
    found = dict.fromkeys(sources, 0)
    frontier = list(sources)
    while frontier:
        new = {j for i in frontier for j in graph[i]} - found.keys()
        found |= dict.fromkeys(new, found[frontier[0]] + 1)
        frontier = list(new)
    return found


def diameter(graph: Graph) -> int:
    return max(max(hops(graph, [vertex]).values()) for vertex in graph)


def layered_ring(sizes: Iterable[int]) -> Graph:
    """Layers in a ring; each vertex is joined to all vertices of the previous and of the next layer."""
    layers: list[range] = []
    for size in sizes:
        first = layers[-1].stop if layers else 1
        layers.append(range(first, first + size))
    edges = [(a, b) for one, other in pairwise([*layers, layers[0]]) for a in one for b in other]
    return graph_of(range(1, layers[-1].stop), edges)
