"""Claims on the eigenvalues of G: section 2.2, Lemmas 1 and 2, Corollary 2, and the survey of graphs behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.analysis.interaction import FloatArray, interaction_matrix
from companion.analysis.response import settled_prcs
from companion.laws.average_22 import Average22
from companion.laws.average_26 import Average26
from companion.laws.weighted import Weighted
from sitl.paper.graphs import Led, connected_graphs, describe, every_small_pair, random_pairs, random_parts, unite
from sitl.paper.words import claim_of, verdict_of
from sitl.report.claim import Claim, ClaimVerdict, Progress, no_progress

UNIONS = 300  # random graphs in parts


def rows_of_g(survey: GraphSurvey) -> Claim:
    """Section 2.2: entries off the diagonal are not positive and row i adds up to w_i^l."""
    row_error, off_diagonal = 0.0, -np.inf
    for spectra in survey.all:
        matrix = spectra.interaction
        role = np.array([1.0 if i in spectra.pair.leaders else 0.0 for i in sorted(spectra.pair.graph)])
        row_error = max(row_error, float(np.abs(matrix.sum(axis=1) - role).max()))
        off_diagonal = max(off_diagonal, float((matrix - np.diag(np.diag(matrix))).max()))
    measured = {"largest_row_sum_error": row_error, "largest_off_diagonal": off_diagonal}
    return survey.claim("section-2.2", verdict_of(row_error < ROUNDING and off_diagonal <= 0.0), measured)


def lemma_1(survey: GraphSurvey) -> Claim:
    """Positive eigenvalues where every connected part has a leader, on graphs of one part and of several parts."""
    random = np.random.default_rng(SEED)
    smallest = min(survey.all, key=lambda spectra: spectra.lambda_min)
    in_parts = [float(_spectrum(unite(random_parts(random))).real.min()) for _ in range(UNIONS)]
    least = min(smallest.lambda_min, *in_parts)
    measured = {"graphs_in_parts": UNIONS, "smallest_eigenvalue": least, "smallest_eigenvalue_in_parts": min(in_parts)}
    where = {"smallest": smallest.lambda_min, "where_smallest": describe(smallest.pair)}
    return survey.claim("lemma-1", verdict_of(least > ROUNDING), measured, **where)


def lemma_1_converse(survey: GraphSurvey) -> Claim:
    """A part without a leader makes G singular: every small connected graph without leader, and unions with such a part."""
    random = np.random.default_rng(SEED + 1)
    alone = [graph for n in range(2, survey.most_vertices + 1) for graph in connected_graphs(n)]
    pairs = [Led(graph, frozenset()) for graph in alone]
    for _ in range(UNIONS):
        first, *others = random_parts(random)
        pairs.append(unite([Led(first.graph, frozenset()), *others]))
    nearest = [float(np.abs(_spectrum(pair)).min()) for pair in pairs]
    largest = max(nearest)
    singular = largest < ROUNDING
    if singular:
        remark = (
            "so the condition of Lemma 1 is necessary; by Lemma 1 a disconnected graph still converges if each part has a"
            " leader"
        )
    else:
        remark = f"not singular on {sum(distance >= ROUNDING for distance in nearest)} of them"
    return claim_of(
        "lemma-1-converse",
        verdict_of(singular),
        {"graphs": len(nearest), "largest_distance_from_zero": largest},
        vertices=survey.most_vertices,
        unions=UNIONS,
        remark=remark,
    )


def lemma_2(survey: GraphSurvey) -> Claim:
    """Real eigenvalues: by a general solver, and by the similar symmetric matrix of the proof."""
    imaginary = max(spectra.largest_imaginary for spectra in survey.all)
    asymmetry = max(spectra.asymmetry for spectra in survey.all)
    gap = max(float(np.abs(s.symmetric_eigenvalues - s.eigenvalues).max()) for s in survey.all)
    unsymmetric = sum(1 for s in survey.all if np.abs(s.interaction - s.interaction.T).max() > ROUNDING)
    measured = {
        "largest_imaginary_part": imaginary,
        "largest_asymmetry": asymmetry,
        "largest_gap_of_solvers": gap,
        "pairs_not_symmetric": unsymmetric,
    }
    return survey.claim("lemma-2", verdict_of(max(imaginary, asymmetry, gap) < ROUNDING), measured)


def corollary_2(survey: GraphSurvey) -> Claim:
    """0 < lambda <= 3, and the part of this range that occurs."""
    least = min(spectra.lambda_min for spectra in survey.all)
    # Rounded, so that of equal values the smallest graph is named.
    widest = max(survey.all, key=lambda spectra: round(float(spectra.eigenvalues[-1]), 9))
    most = float(widest.eigenvalues[-1])
    most_one_leader = max(float(spectra.eigenvalues[-1]) for spectra in survey.one_leader)
    measured = {"smallest": least, "largest": most, "largest_one_leader": most_one_leader}
    verdict = verdict_of(least > ROUNDING and most <= 3.0 + ROUNDING)
    return survey.claim("corollary-2", verdict, measured, widest=describe(widest.pair))


def _spectrum(pair: Led) -> ComplexArray:
    """Eigenvalues of G under the weighted law."""
    return spectrum_of(interaction_matrix(pair.graph, pair.leaders, Weighted()))


Item = TypeVar("Item")
ComplexArray = NDArray[np.complex128]

SEED = 2021
MOST_VERTICES, MOST_VERTICES_FULL = 6, 7
RANDOM_PAIRS, RANDOM_PAIRS_FULL = 300, 3000
ROUNDING = 1e-9  # eigenvalues with a smaller difference count as equal


@dataclass(frozen=True, slots=True)
class GraphSpectra:
    """Spectra of one pair. `interaction` is G of eq. 21 (n x n), `eigenvalues` are those of G in rising order (n,)."""

    pair: Led
    interaction: FloatArray
    eigenvalues: FloatArray
    largest_imaginary: float
    symmetric_eigenvalues: FloatArray  # of T^-1 G T, by a solver for symmetric matrices (n,)
    asymmetry: float  # largest difference of T^-1 G T from its transpose
    lambda_min_22: float
    lambda_min_26: float

    @property
    def lambda_min(self) -> float:
        return float(self.eigenvalues[0])


@dataclass(frozen=True, slots=True)
class GraphSurvey:
    """`small`: every connected graph of up to `most_vertices` with every set of leaders; `drawn`: random larger ones."""

    most_vertices: int
    small: Sequence[GraphSpectra]
    drawn: Sequence[GraphSpectra]

    @property
    def all(self) -> Sequence[GraphSpectra]:
        return [*self.small, *self.drawn]

    @property
    def one_leader(self) -> Sequence[GraphSpectra]:
        """The small pairs with a single leader: 809 for up to 6 vertices, 6780 for up to 7."""
        return [spectra for spectra in self.small if len(spectra.pair.leaders) == 1]

    def counts(self) -> dict[str, float]:
        return {
            "pairs": float(len(self.small) + len(self.drawn)),
            "pairs_small": len(self.small),
            "pairs_small_one_leader": len(self.one_leader),
            "pairs_random": len(self.drawn),
        }

    def claim(self, id_: str, verdict: ClaimVerdict, measured: dict[str, float], **values: object) -> Claim:
        """A claim on the pairs of this survey."""
        return claim_of(id_, verdict, self.counts() | measured, extent=self.extent(), **values)

    def extent(self) -> str:
        """Text: the pairs of the survey."""
        return (
            f"{len(self.small) + len(self.drawn)} pairs of a graph and its leaders: every connected graph of 2 to "
            f"{self.most_vertices} vertices with every set of leaders ({len(self.one_leader)} with one leader) and "
            f"{len(self.drawn)} random larger ones"
        )


def take_survey(full: bool = False, progress: Progress = no_progress) -> GraphSurvey:
    most_vertices = MOST_VERTICES_FULL if full else MOST_VERTICES
    small = list(every_small_pair(most_vertices))
    drawn = list(random_pairs(np.random.default_rng(SEED), RANDOM_PAIRS_FULL if full else RANDOM_PAIRS))
    found = [spectra_of(pair) for pair in with_progress([*small, *drawn], progress)]
    return GraphSurvey(most_vertices, found[: len(small)], found[len(small) :])


def with_progress(items: Sequence[Item], progress: Progress) -> Iterator[Item]:
    """The items in turn; `progress` gets the share of them that was taken."""
    for index, item in enumerate(items):
        if index % 100 == 0:
            progress(index / len(items))
        yield item


def spectra_of(pair: Led) -> GraphSpectra:
    matrix = interaction_matrix(pair.graph, pair.leaders, Weighted())
    spectrum = spectrum_of(matrix)
    similar = symmetric_form(pair, matrix)
    return GraphSpectra(
        pair=pair,
        interaction=matrix,
        eigenvalues=np.sort(spectrum.real),
        largest_imaginary=float(np.abs(spectrum.imag).max()),
        symmetric_eigenvalues=np.asarray(np.linalg.eigvalsh(similar), dtype=np.float64),
        asymmetry=float(np.abs(similar - similar.T).max()),
        lambda_min_22=lambda_min(interaction_matrix(pair.graph, pair.leaders, Average22())),
        lambda_min_26=lambda_min(interaction_matrix(pair.graph, pair.leaders, Average26())),
    )


def symmetric_form(pair: Led, matrix: FloatArray) -> FloatArray:
    """T^-1 G T in the proof of Lemma 2: T = W1^-1/2 W2^1/2, W1 = diag(sum of 1/p_j over the neighbours), W2 = diag(p_i)."""
    prcs = settled_prcs(pair.graph, pair.leaders)
    ids = sorted(pair.graph)
    w1 = np.array([sum(1.0 / prcs[j] for j in pair.graph[i]) for i in ids])
    w2 = np.array([float(prcs[i]) for i in ids])
    t = np.sqrt(w2 / w1)
    similar: FloatArray = matrix * t[np.newaxis, :] / t[:, np.newaxis]
    return similar


def spectrum_of(matrix: FloatArray) -> ComplexArray:
    """Eigenvalues (n,) by a general solver: a symmetric one would assume Lemma 2, which is to be checked."""
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)


def lambda_min(matrix: FloatArray) -> float:
    return float(spectrum_of(matrix).real.min())
