"""Spectra for the checks of the theorems, computed once for all pairs of a graph and its leaders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.consensus.law import average_22, average_26, weighted
from companion.stability.arrays import FloatArray
from companion.stability.interaction import interaction_matrix, settled_prcs
from sitl.paper.theory.graphs import Led, every_small_pair, random_pairs
from sitl.report.claim import Progress, no_progress

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
            "pairs_small": float(len(self.small)),
            "pairs_small_one_leader": float(len(self.one_leader)),
            "pairs_random": float(len(self.drawn)),
        }

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
    found: list[GraphSpectra] = []
    for index, pair in enumerate([*small, *drawn]):
        found.append(spectra_of(pair))
        if index % 100 == 0:
            progress(index / (len(small) + len(drawn)))
    return GraphSurvey(most_vertices, found[: len(small)], found[len(small) :])


def spectra_of(pair: Led) -> GraphSpectra:
    matrix = interaction_matrix(pair.graph, pair.leaders, weighted())
    spectrum = spectrum_of(matrix)
    similar = symmetric_form(pair, matrix)
    return GraphSpectra(
        pair=pair,
        interaction=matrix,
        eigenvalues=np.sort(spectrum.real),
        largest_imaginary=float(np.abs(spectrum.imag).max()),
        symmetric_eigenvalues=np.asarray(np.linalg.eigvalsh(similar), dtype=np.float64),
        asymmetry=float(np.abs(similar - similar.T).max()),
        lambda_min_22=lambda_min(interaction_matrix(pair.graph, pair.leaders, average_22())),
        lambda_min_26=lambda_min(interaction_matrix(pair.graph, pair.leaders, average_26())),
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
