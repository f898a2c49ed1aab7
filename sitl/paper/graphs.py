"""Graphs for the checks of the theory, and the matrices that the paper prints.

All small connected graphs, random larger ones, and a constructed counterexample.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import combinations, pairwise, permutations
from math import dist

import numpy as np

from companion.analysis.interaction import FloatArray, interaction_matrix
from companion.analysis.response import Graph, hops, settled_prcs
from companion.laws import neighbour_weights
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.laws.average_22 import Average22
from companion.laws.average_26 import Average26
from companion.laws.weighted import Weighted
from companion.types.values import Vector3
from sitl.compare.shapes import ring
from sitl.paper.words import claim_of, verdict_of
from sitl.report.claim import Claim

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


def unite(parts: Iterable[Led]) -> Led:
    graph: dict[int, Collection[int]] = {}
    leaders: frozenset[int] = frozenset()
    for part in parts:
        graph |= part.graph
        leaders |= part.leaders
    return Led(graph, leaders)


def describe(pair: Led) -> str:
    """Text: all edges and leaders of a small pair, the size of a large one."""
    n = len(pair.graph)
    edges = [f"{a}-{b}" for a in sorted(pair.graph) for b in sorted(pair.graph[a]) if a < b]
    if n >= FEWEST_RANDOM:
        count = len(pair.leaders)
        return f"a graph of {n} vertices and {len(edges)} edges with {count} leader{'' if count == 1 else 's'}"
    leaders = " and ".join(str(leader) for leader in sorted(pair.leaders))
    return f"the graph {', '.join(edges)} with leader{'' if len(pair.leaders) == 1 else 's'} {leaders}"


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


EXACT = 1e-12  # tolerance of a float against the paper's fraction

# Scenario 1 of section 5.1: start positions and range.
AGGREGATION_STARTS_M: dict[int, Vector3] = {1: (0, 0, 1), 2: (-1.49, -2.6, 1), 3: (1.49, -2.6, 1), 4: (0, -4, 1)}
AGGREGATION_RANGE_M = 3.0

# From the text on figure 2: seven vertices, leader 1, N_3 = {1, 2, 5, 6}, 1 - 3 - 5 is a shortest path, and the weight of 2 is
# larger than those of 5 and 6, which are equal. The scan lacks the picture. These are the simplest edges that fit the text;
# the edges of 4 and 7 have no effect.
FIGURE_2 = graph_of(range(1, 8), [(1, 2), (1, 3), (2, 3), (2, 4), (3, 5), (3, 6), (5, 7), (6, 7)])
FIGURE_2_WEIGHTS = {1: Fraction(6, 13), 2: Fraction(3, 13), 5: Fraction(2, 13), 6: Fraction(2, 13)}

EQ_27_G1 = ["1 0 0 0", "-1/3 1 -1/3 -1/3", "-1/3 -1/3 1 -1/3", "0 -1/2 -1/2 1"]
EQ_27_G2 = ["2 -1/2 -1/2 0", "-6/11 1 -3/11 -2/11", "-6/11 -3/11 1 -2/11", "0 -1/2 -1/2 1"]
RING_LED_BY_1 = ["2 -1/2 0 -1/2", "-3/4 1 -1/4 0", "0 -1/2 1 -1/2", "-3/4 0 -1/4 1"]
RING_LED_BY_2 = ["1 -3/4 0 -1/4", "-1/2 2 -1/2 0", "0 -3/4 1 -1/4", "-1/2 0 -1/2 1"]


def aggregation_graph() -> Graph:
    """The edges 1-2, 1-3, 2-3, 2-4, 3-4: vehicles in range of each other at the start of the aggregation."""
    return within_range(AGGREGATION_STARTS_M, AGGREGATION_RANGE_M)


def matrix_claims() -> list[Claim]:
    return [eq_27(), section_5_2(), figure_2()]


def eq_27() -> Claim:
    """G1 and G2 of the aggregation at its start, with leader 1."""
    graph = aggregation_graph()
    parts = [("G1", EQ_27_G1, {1}, Average26()), ("G2", EQ_27_G2, {1}, Weighted())]
    is_eq_26 = _difference(interaction_matrix(graph, {1}, Average26()), EQ_27_G1) <= EXACT
    off_eq_22 = np.abs(interaction_matrix(graph, {1}, Average22()) - printed_matrix(EQ_27_G1))
    rows = [i for i, row in zip(sorted(graph), off_eq_22, strict=True) if row.max() > EXACT]
    return _matrix_claim(
        "eq-27",
        graph,
        parts,
        {"g1_difference_eq_22": float(off_eq_22.max())},
        is_or_not="" if is_eq_26 else "not ",
        rows=len(rows),
        of_rows=len(graph),
        which=": that of the leader" if rows == [1] else "",
    )


def section_5_2() -> Claim:
    """Both matrices of the ring of four with its leader change."""
    parts = [("led by 1", RING_LED_BY_1, {1}, Weighted()), ("led by 2", RING_LED_BY_2, {2}, Weighted())]
    return _matrix_claim("section-5.2", ring(4).adjacency(), parts, {})


def _matrix_claim(
    claim_id: str,
    graph: Graph,
    parts: Sequence[tuple[str, list[str], set[int], NeighbourFeedback]],
    measured: dict[str, float],
    **values: object,
) -> Claim:
    ours = {name: interaction_matrix(graph, leaders, law) for name, _, leaders, law in parts}
    differences = {name: _difference(ours[name], printed) for name, printed, _, _ in parts}
    worst = max(differences.values())
    return claim_of(
        claim_id,
        verdict_of(worst <= EXACT),
        {f"{_key(name)}_largest_difference": value for name, value in differences.items()} | measured,
        printed="; ".join(f"{name} = {_text(printed_matrix(printed))}" for name, printed, _, _ in parts),
        matrices="; ".join(f"{name} = {_text(matrix)}" for name, matrix in ours.items()),
        entries=sum(matrix.size for matrix in ours.values()),
        worst=worst,
        **values,
    )


def figure_2() -> Claim:
    """Weights of vertex 3's neighbours, and the distance of vertices that they come from."""
    ours = weights_of(FIGURE_2, {1}, 3)
    distance = hops(FIGURE_2, {1})[5]
    worst = max(abs(ours.get(j, 0.0) - float(weight)) for j, weight in FIGURE_2_WEIGHTS.items())
    ordered = ours[1] > ours[2] > ours[5] == ours[6]
    right = worst <= EXACT and ordered and ours.keys() == FIGURE_2_WEIGHTS.keys() and distance == 2
    weights = ", ".join(f"{_fraction(weight)} for {j}" for j, weight in ours.items())
    return claim_of(
        "fig-2",
        verdict_of(right),
        {f"weight_3_{j}": weight for j, weight in ours.items()}
        | {"largest_difference": worst, "distance_1_5_hops": distance},
        weights=weights,
    )


def weights_of(graph: Graph, leaders: Collection[int], vertex: int) -> dict[int, float]:
    """Neighbour -> weight, by Algorithms 1 and 2."""
    prcs = settled_prcs(graph, leaders)
    neighbours = sorted(graph[vertex])
    return dict(zip(neighbours, neighbour_weights(tuple([prcs[j] for j in neighbours])), strict=True))


def printed_matrix(rows: Sequence[str]) -> FloatArray:
    """["2 -1/2", "-3/4 1"] -> G."""
    return np.array([[float(Fraction(entry)) for entry in row.split()] for row in rows])


def _difference(ours: FloatArray, printed: list[str]) -> float:
    return float(np.abs(ours - printed_matrix(printed)).max())


def _text(matrix: FloatArray) -> str:
    return "[" + "; ".join(" ".join(_fraction(entry) for entry in row) for row in matrix) + "]"


def _fraction(value: float) -> str:
    """The value as a fraction where it is one within EXACT, else with six digits."""
    near = Fraction(value).limit_denominator(100)
    return str(near) if abs(float(near) - value) <= EXACT else f"{value:.6g}"


def _key(name: str) -> str:
    return name.lower().replace(" ", "_")
