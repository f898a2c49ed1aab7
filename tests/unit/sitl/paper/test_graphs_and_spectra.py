"""Graphs and tools for the checks of the theory, each compared with an independent computation."""

from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.analysis.interaction import interaction_matrix
from companion.types.formation import PAPER_GAINS, Gains
from sitl.compare.shapes import chain, ring
from sitl.paper.graphs import (
    Led,
    aggregation_graph,
    connected_graphs,
    diameter,
    every_small_pair,
    graph_of,
    hops,
    layered_ring,
    random_connected,
    random_leaders,
    random_parts,
    unite,
    within_range,
)
from sitl.paper.spectrum import (
    GraphSurvey,
    corollary_2,
    lemma_1,
    lemma_1_converse,
    lemma_2,
    rows_of_g,
    spectra_of,
    take_survey,
)
from sitl.paper.theorems import (
    abscissa_1_s,
    algorithm_1,
    contrary,
    limit_of_proportion,
    printed_prcs,
    proposition_2_against_22,
    rate_of_mode_1_s,
    ticks_to_settle,
)
from sitl.report.claim import ClaimVerdict
from tests.helpers.laws import weighted

# ---------------------------------------------------------------- graphs


def edges_of(graph: object) -> frozenset[tuple[int, int]]:
    return frozenset((a, b) for a in graph for b in graph[a] if a < b)  # type: ignore[attr-defined,index]


def test_the_number_of_connected_graphs() -> None:
    assert [len(connected_graphs(n)) for n in range(1, 7)] == [1, 1, 2, 6, 21, 112]  # A001349


@pytest.mark.parametrize("n", [3, 4])
def test_every_connected_graph_occurs_exactly_once(n: int) -> None:
    """Compared with all labelled graphs, by enumeration."""
    pairs = list(combinations(range(1, n + 1), 2))
    labelled = [edges for size in range(len(pairs) + 1) for edges in combinations(pairs, size)]
    known = [edges_of(graph) for graph in connected_graphs(n)]
    for edges in labelled:
        graph = graph_of(range(1, n + 1), edges)
        renumbered = {
            frozenset((min(new[a - 1], new[b - 1]), max(new[a - 1], new[b - 1])) for a, b in edges)
            for new in permutations(range(1, n + 1))
        }
        assert sum(one in renumbered for one in known) == (1 if len(hops(graph, [1])) == n else 0)


def test_the_number_of_pairs() -> None:
    pairs = list(every_small_pair(5))
    assert len(pairs) == 3 + 2 * 7 + 6 * 15 + 21 * 31
    assert sum(len(pair.leaders) == 1 for pair in pairs) == 2 + 6 + 24 + 105


@given(st.integers(0, 10**6))
def test_random_graphs_are_connected_and_have_leaders(seed: int) -> None:
    random = np.random.default_rng(seed)
    graph = random_connected(random)
    assert 8 <= len(graph) <= 40
    assert hops(graph, [1]).keys() == graph.keys()
    assert all(i in graph[j] and i != j for i in graph for j in graph[i])
    assert random_leaders(random, graph) <= graph.keys()
    parts = random_parts(random)
    whole = unite(parts)
    assert len(whole.graph) == sum(len(part.graph) for part in parts)
    assert hops(whole.graph, whole.leaders).keys() == whole.graph.keys()


def test_the_papers_graphs() -> None:
    assert edges_of(aggregation_graph()) == {(1, 2), (1, 3), (2, 3), (2, 4), (3, 4)}
    assert edges_of(ring(4).adjacency()) == {(1, 2), (2, 3), (3, 4), (1, 4)}
    assert edges_of(within_range({1: (0, 0, 0), 2: (3, 0, 0), 3: (6.1, 0, 0)}, 3.0)) == {(1, 2)}
    assert edges_of(layered_ring([1, 2, 1, 1])) == {(1, 2), (1, 3), (2, 4), (3, 4), (4, 5), (1, 5)}
    assert (diameter(chain(5).adjacency()), diameter(ring(5).adjacency())) == (4, 2)


# ---------------------------------------------------------------- theorems on graphs that no list holds


@st.composite
def led_graphs(draw: st.DrawFn) -> Led:
    """A random tree with additional edges and random leaders."""
    n = draw(st.integers(2, 12))
    edges = {(draw(st.integers(1, i - 1)), i) for i in range(2, n + 1)}
    edges |= draw(st.sets(st.tuples(st.integers(1, n), st.integers(1, n)).filter(lambda e: e[0] < e[1]), max_size=12))
    leaders = draw(st.sets(st.integers(1, n), min_size=1))
    return Led(graph_of(range(1, n + 1), edges), frozenset(leaders))


@settings(max_examples=150)
@given(led_graphs())
def test_the_lemmas_corollary_2_and_proposition_2(pair: Led) -> None:
    spectra = spectra_of(pair)
    assert spectra.largest_imaginary < 1e-9
    assert spectra.asymmetry < 1e-12
    assert spectra.symmetric_eigenvalues == pytest.approx(spectra.eigenvalues, abs=1e-9)
    assert spectra.lambda_min > 0.0
    assert spectra.eigenvalues[-1] <= 3.0 + 1e-9
    assert spectra.lambda_min >= spectra.lambda_min_22 - 1e-9


@settings(max_examples=100)
@given(led_graphs(), st.floats(0.2, 3.0), st.floats(0.2, 5.0))
def test_the_abscissa_equals_that_of_the_slowest_mode(pair: Led, k1: float, k2: float) -> None:
    spectra, gains = spectra_of(pair), Gains(k1, k2)
    slowest = min(rate_of_mode_1_s(gains, value) for value in spectra.eigenvalues)
    assert abscissa_1_s(spectra.interaction, gains) == pytest.approx(-slowest, abs=1e-5)


@settings(max_examples=100)
@given(led_graphs(), st.data())
def test_prcs_settle_within_the_diameter(pair: Led, data: st.DataObject) -> None:
    n = len(pair.graph)
    start = {i: data.draw(st.integers(1, n)) for i in sorted(pair.graph)}
    prcs, ticks = ticks_to_settle(pair.graph, pair.leaders, start)
    assert prcs == {i: distance + 1 for i, distance in hops(pair.graph, pair.leaders).items()}
    assert ticks <= diameter(pair.graph) + 1


def test_prcs_without_a_leader_and_as_printed() -> None:
    assert ticks_to_settle(chain(5).adjacency(), (), dict.fromkeys(range(1, 6), 1)) == (
        dict.fromkeys(range(1, 6), 5),
        4,
    )
    assert printed_prcs(chain(4).adjacency(), {1}) == {1: 1, 2: 4, 3: 4, 4: 4}


def test_the_limit_of_the_proportional_rate() -> None:
    assert limit_of_proportion(PAPER_GAINS) == pytest.approx(3.861, abs=5e-4)
    both_lead = interaction_matrix(chain(2).adjacency(), {1, 2}, weighted())  # eigenvalues 1 and 3
    assert abscissa_1_s(both_lead, PAPER_GAINS) == pytest.approx(-0.6, abs=1e-9)
    assert abscissa_1_s(both_lead, Gains(1.0, 2.0)) == pytest.approx(-3.0 + np.sqrt(6.0), abs=1e-9)


# ---------------------------------------------------------------- proposition 2 is not true of every graph


def test_the_counterexample_by_its_quotient_matrix() -> None:
    """The eigenvector of the smallest eigenvalue is constant on a layer, so a matrix with one row per layer has it too."""
    sizes = np.array([len(layer) for layer in _layers()], dtype=float)
    count = len(sizes)
    hops_of = np.array([min(i, count - i) for i in range(count)])
    for exponent, expected in ((1.0, contrary().lambda_min), (0.0, contrary().lambda_min_22)):
        shares = np.zeros((count, count))
        for i in range(count):
            for j in ((i - 1) % count, (i + 1) % count):
                shares[i, j] = sizes[j] * (hops_of[j] + 1.0) ** -exponent
        matrix = np.eye(count) - shares / shares.sum(axis=1, keepdims=True)
        matrix[0, 0] += 1.0
        assert np.linalg.eigvals(matrix).real.min() == pytest.approx(expected, rel=1e-6)
    assert contrary().lambda_min < 0.95 * contrary().lambda_min_22


def _layers() -> list[set[int]]:
    """Layers of the counterexample in the order of the ring: vertices with the same neighbours are one layer."""
    graph = contrary().pair.graph
    alike: dict[frozenset[int], set[int]] = {}
    for vertex in sorted(graph):
        alike.setdefault(frozenset(graph[vertex]), set()).add(vertex)
    return list(alike.values())


# ---------------------------------------------------------------- a verdict can be "does not hold"


def survey_of(*pairs: Led) -> GraphSurvey:
    return GraphSurvey(2, [spectra_of(pair) for pair in pairs], [])


def test_a_graph_without_a_leader_breaks_lemma_1_and_corollary_2() -> None:
    survey = survey_of(Led(chain(3).adjacency(), frozenset({1})), Led(chain(3).adjacency(), frozenset()))
    assert lemma_1(survey).verdict is ClaimVerdict.FAILS
    assert corollary_2(survey).verdict is ClaimVerdict.FAILS


def test_the_counterexample_in_the_survey_breaks_proposition_2() -> None:
    survey = GraphSurvey(2, [spectra_of(Led(chain(3).adjacency(), frozenset({1})))], [contrary()])
    claim = proposition_2_against_22(survey)
    assert claim.verdict is ClaimVerdict.FAILS
    assert claim.measured["pairs_below"] == 1


def test_a_directed_graph_breaks_lemma_2() -> None:
    one_way = {1: {2}, 2: {3}, 3: {4}, 4: {2}}
    claim = lemma_2(survey_of(Led(one_way, frozenset({1}))))
    assert claim.verdict is ClaimVerdict.FAILS
    assert claim.measured["largest_imaginary_part"] > 0.1


def test_line_3_as_printed_breaks_algorithm_1(monkeypatch: pytest.MonkeyPatch) -> None:
    survey = survey_of(Led(chain(4).adjacency(), frozenset({1})))
    assert algorithm_1(survey).verdict is ClaimVerdict.CONDITION
    monkeypatch.setattr("sitl.paper.theorems.next_prc", lambda is_leader, _prcs, n: 1 if is_leader else n)
    assert algorithm_1(survey).verdict is ClaimVerdict.FAILS


def test_the_claims_hold_on_a_small_survey() -> None:
    survey = survey_of(*every_small_pair(3))
    assert {claim(survey).verdict for claim in (rows_of_g, lemma_1, lemma_1_converse, lemma_2)} == {ClaimVerdict.HOLDS}


def test_the_survey_is_reproducible(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.paper.spectrum.MOST_VERTICES", 3)
    monkeypatch.setattr("sitl.paper.spectrum.RANDOM_PAIRS", 5)
    one, other = take_survey(), take_survey()
    assert [spectra.pair for spectra in one.drawn] == [spectra.pair for spectra in other.drawn]
    assert len(one.small) == 3 + 2 * 7
