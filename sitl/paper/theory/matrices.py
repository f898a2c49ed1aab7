"""Claims on the printed matrices and weights, recomputed by Algorithms 1 and 2 from roles and neighbour sets."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from fractions import Fraction

import numpy as np

from companion.core.consensus.law import FormationLaw, average_22, average_26, neighbour_weights, weighted
from companion.stability.arrays import FloatArray
from companion.stability.interaction import Graph, interaction_matrix, settled_prcs
from companion.types.values import Vector3
from sitl.paper.theory.graphs import graph_of, hops, within_range
from sitl.report.claim import Claim, ClaimVerdict
from sitl.study.shapes import ring

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
    """G1 and G2 of the aggregation at its start, with leader UAV 1."""
    graph = aggregation_graph()
    parts = [("G1", EQ_27_G1, {1}, average_26()), ("G2", EQ_27_G2, {1}, weighted())]
    is_eq_26 = _difference(interaction_matrix(graph, {1}, average_26()), EQ_27_G1) <= EXACT
    off_eq_22 = np.abs(interaction_matrix(graph, {1}, average_22()) - printed_matrix(EQ_27_G1))
    rows = [i for i, row in zip(sorted(graph), off_eq_22, strict=True) if row.max() > EXACT]
    return _matrix_claim(
        "eq-27",
        "eq. 27",
        "the interaction matrices of the aggregation, G1 under the average law and G2 under the weighted one",
        graph,
        parts,
        f"G1 is {'' if is_eq_26 else 'not '}the matrix of eq. 26, whose leader uses no neighbours; eq. 22, the law of the "
        f"proofs, differs from it by up to {off_eq_22.max():g}, in {len(rows)} of {len(graph)} rows"
        + (": that of the leader" if rows == [1] else ""),
        {"g1_difference_eq_22": float(off_eq_22.max())},
    )


def section_5_2() -> Claim:
    """Both matrices of the ring of four with its leader change."""
    parts = [("led by 1", RING_LED_BY_1, {1}, weighted()), ("led by 2", RING_LED_BY_2, {2}, weighted())]
    return _matrix_claim(
        "section-5.2",
        "section 5.2",
        "the interaction matrices of the ring of four with leader UAV 1 and with leader UAV 2",
        ring(4).adjacency(),
        parts,
    )


def _matrix_claim(
    claim_id: str,
    where: str,
    claim: str,
    graph: Graph,
    parts: list[tuple[str, list[str], set[int], FormationLaw]],
    remark: str = "",
    measured: dict[str, float] | None = None,
) -> Claim:
    ours = {name: interaction_matrix(graph, leaders, law) for name, _, leaders, law in parts}
    differences = {name: _difference(ours[name], printed) for name, printed, _, _ in parts}
    entries = sum(matrix.size for matrix in ours.values())
    worst = max(differences.values())
    matrices = "; ".join(f"{name} = {_text(matrix)}" for name, matrix in ours.items())
    return Claim(
        id=claim_id,
        where=where,
        claim=claim,
        paper="; ".join(f"{name} = {_text(printed_matrix(printed))}" for name, printed, _, _ in parts),
        ideal=f"{matrices}; largest difference of {entries} entries {worst:.1g}",
        full="-",
        verdict=ClaimVerdict.HOLDS if worst <= EXACT else ClaimVerdict.FAILS,
        remark=remark,
        measured={f"{_key(name)}_largest_difference": value for name, value in differences.items()} | (measured or {}),
    )


def figure_2() -> Claim:
    """Weights of vertex 3's neighbours, and the distance of vertices that they come from."""
    ours = weights_of(FIGURE_2, {1}, 3)
    distance = hops(FIGURE_2, {1})[5]
    worst = max(abs(ours.get(j, 0.0) - float(weight)) for j, weight in FIGURE_2_WEIGHTS.items())
    ordered = ours[1] > ours[2] > ours[5] == ours[6]
    right = worst <= EXACT and ordered and ours.keys() == FIGURE_2_WEIGHTS.keys() and distance == 2
    listed = ", ".join(f"{_fraction(weight)} for {j}" for j, weight in ours.items())
    return Claim(
        id="fig-2",
        where="figure 2, section 3.3",
        claim="vertex 3 gives its neighbours 1, 2, 5, 6 decreasing weights, equal for 5 and 6; the distance of 1 and 5 is 2",
        paper="w31 > w32 > w35 = w36; distance 2",
        ideal=f"{listed}; distance {distance}",
        full="-",
        verdict=ClaimVerdict.HOLDS if right else ClaimVerdict.FAILS,
        remark="the scan lacks the picture: the edges are chosen to fit the text, which determines these weights",
        measured={f"weight_3_{j}": weight for j, weight in ours.items()}
        | {"largest_difference": worst, "distance_1_5_hops": float(distance)},
    )


def weights_of(graph: Graph, leaders: Collection[int], vertex: int) -> dict[int, float]:
    """Neighbour -> weight, by Algorithms 1 and 2."""
    prcs = settled_prcs(graph, leaders)
    neighbours = sorted(graph[vertex])
    return dict(zip(neighbours, neighbour_weights([prcs[j] for j in neighbours], weighted().weighting), strict=True))


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
