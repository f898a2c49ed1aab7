"""Verdicts on the theory claims fail for spectra, matrices and PrCs that differ from the paper."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import sitl.paper.spectrum as spectrum
import sitl.paper.theorems as algorithm1
import sitl.paper.theorems as comparison
from companion.analysis.interaction import FloatArray
from sitl.paper.graphs import every_small_pair, random_pairs
from sitl.paper.spectrum import (
    GraphSpectra,
    GraphSurvey,
    corollary_2,
    lemma_1,
    lemma_1_converse,
    lemma_2,
    rows_of_g,
    spectra_of,
)
from sitl.paper.theorems import (
    platoon,
    proposition_1_and_corollary_1,
    proposition_2_against_22,
    proposition_2_against_26,
)
from sitl.report.claim import Claim, ClaimVerdict

HOLDS, CONDITION, FAILS = ClaimVerdict.HOLDS, ClaimVerdict.CONDITION, ClaimVerdict.FAILS


@pytest.fixture(scope="module")
def survey() -> GraphSurvey:
    """A small survey that agrees with the paper."""
    drawn = [spectra_of(pair) for pair in random_pairs(np.random.default_rng(1), 4)]
    return GraphSurvey(4, [spectra_of(pair) for pair in every_small_pair(4)], drawn)


def with_one(survey: GraphSurvey, **changes: object) -> GraphSurvey:
    """The survey with one changed pair."""
    index = next(i for i, s in enumerate(survey.small) if len(s.pair.graph) == 4 and len(s.pair.leaders) == 1)
    odd = replace(survey.small[index], **changes)  # type: ignore[arg-type]
    return replace(survey, small=[*survey.small[:index], odd, *survey.small[index + 1 :]])


def proposition_1(survey: GraphSurvey) -> Claim:
    return proposition_1_and_corollary_1(survey)[0]


def corollary_1(survey: GraphSurvey) -> Claim:
    return proposition_1_and_corollary_1(survey)[1]


ODD: FloatArray = np.array([-0.1, 1.0, 1.5, 3.2])
RIGHT: FloatArray = np.array([0.2, 1.0, 1.5, 2.0])
UNSTABLE: FloatArray = np.diag([-0.1, 1.0, 1.0, 1.0])
OTHER: FloatArray = np.diag([0.4, 1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("claim_of", "usually", "changes"),
    [
        (rows_of_g, HOLDS, {"interaction": UNSTABLE}),
        (lemma_1, HOLDS, {"eigenvalues": ODD}),
        (lemma_2, HOLDS, {"largest_imaginary": 0.1}),
        (lemma_2, HOLDS, {"asymmetry": 0.1}),
        (lemma_2, HOLDS, {"symmetric_eigenvalues": ODD}),
        (corollary_2, HOLDS, {"eigenvalues": np.array([0.1, 1.0, 1.5, 3.2])}),
        (corollary_2, HOLDS, {"eigenvalues": np.array([-0.1, 1.0, 1.5, 2.0])}),
        (proposition_1, HOLDS, {"interaction": UNSTABLE}),
        (corollary_1, CONDITION, {"interaction": OTHER, "eigenvalues": RIGHT}),
        (proposition_2_against_22, CONDITION, {"lambda_min_22": 3.0}),
    ],
)
def test_a_single_different_pair_breaks_a_claim(
    survey: GraphSurvey, claim_of: Callable[[GraphSurvey], Claim], usually: ClaimVerdict, changes: dict[str, object]
) -> None:
    assert claim_of(survey).verdict is usually
    claim = claim_of(with_one(survey, **changes))
    assert claim.verdict is FAILS


def test_a_failed_proposition_names_a_counterexample(survey: GraphSurvey) -> None:
    assert "against 3.0000 on the graph" in proposition_2_against_22(with_one(survey, lambda_min_22=3.0)).remark


def test_proposition_2_holds_without_its_counterexamples(survey: GraphSurvey, monkeypatch: pytest.MonkeyPatch) -> None:
    def tame(spectra: GraphSpectra) -> GraphSpectra:
        return replace(spectra, lambda_min_22=1e-4, lambda_min_26=1e-4)

    monkeypatch.setattr(comparison, "contrary", lambda: tame(survey.small[0]))
    assert proposition_2_against_22(survey).verdict is HOLDS
    assert proposition_2_against_26(survey).verdict is FAILS
    monkeypatch.setattr(comparison, "spectra_of", lambda pair: tame(spectra_of(pair)))
    tamed = replace(survey, small=[tame(s) for s in survey.small], drawn=[tame(s) for s in survey.drawn])
    assert proposition_2_against_26(tamed).verdict is HOLDS
    assert platoon().verdict is HOLDS


def test_a_regular_matrix_without_leader_breaks_the_converse_of_lemma_1(
    survey: GraphSurvey, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert lemma_1_converse(survey).remark.startswith("so the condition")
    matrix = spectrum.interaction_matrix
    monkeypatch.setattr(spectrum, "interaction_matrix", lambda *known: matrix(*known) + 0.1 * np.eye(len(known[0])))
    claim = lemma_1_converse(survey)
    assert claim.verdict is FAILS
    assert "not singular on" in claim.remark


@pytest.mark.parametrize("wrong", [lambda *_known: 1, lambda leads, _heard, n: 1 if leads else n])
def test_prcs_that_are_not_hops_break_algorithm_1(
    survey: GraphSurvey, monkeypatch: pytest.MonkeyPatch, wrong: Callable[..., int]
) -> None:
    assert "PrC climbs" in algorithm1.algorithm_1(survey).remark
    monkeypatch.setattr(algorithm1, "next_prc", wrong)
    assert algorithm1.algorithm_1(survey).verdict is FAILS
