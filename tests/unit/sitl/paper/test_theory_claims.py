"""Theory claims of the report: all are present, their verdicts are computed, and their figures are the known ones."""

import msgspec
import pytest

import sitl.paper.graphs as matrices
import sitl.paper.theorems as comparison
from companion.types.values import ZERO3
from sitl.compare.shapes import Shape
from sitl.paper.errata import acceleration_of, errata, printed_attitude, right_attitude
from sitl.paper.theorems import theory_claims
from sitl.report.claim import Claim, ClaimVerdict

CONDITION, FAILS = ClaimVerdict.CONDITION, ClaimVerdict.FAILS


@pytest.fixture(scope="module")
def shares() -> list[float]:
    return []


@pytest.fixture(scope="module")
def claims(shares: list[float]) -> dict[str, Claim]:
    return {claim.id: claim for claim in theory_claims(progress=shares.append)}


def test_the_verdicts_of_all_theory_claims(claims: dict[str, Claim]) -> None:
    assert {claim.id: claim.verdict for claim in claims.values() if claim.verdict is not ClaimVerdict.HOLDS} == {
        "algorithm-1": CONDITION,
        "corollary-1": CONDITION,
        "proposition-2-vs-22": CONDITION,
        "proposition-2-vs-26": FAILS,
    }
    assert len(claims) == 14
    assert all(claim.remark for claim in claims.values() if claim.verdict is not ClaimVerdict.HOLDS)


def test_the_size_of_the_survey(claims: dict[str, Claim]) -> None:
    measured = claims["lemma-2"].measured
    assert measured["pairs_small_one_leader"] == 809  # 2 + 6 + 24 + 105 + 672
    assert measured["pairs"] == 7814 + 300
    assert claims["proposition-2-vs-26"].measured["pairs"] == 809
    assert "8114 pairs" in claims["lemma-2"].ideal


@pytest.mark.parametrize(
    ("claim_id", "name", "expected"),
    [
        ("platoon-lambda-min", "lambda_min_eq_22", 0.0789),
        ("platoon-lambda-min", "lambda_min_eq_26", 0.1340),
        ("platoon-lambda-min", "lambda_min_weighted", 0.1818),
        ("proposition-2-vs-26", "eq_27_lambda_min_eq_26", 0.2324),
        ("proposition-2-vs-26", "eq_27_lambda_min_weighted", 0.1979),
        ("corollary-2", "largest", 3.0),
        ("fig-2", "weight_3_1", 6 / 13),
    ],
)
def test_figures_equal_independent_results(claims: dict[str, Claim], claim_id: str, name: str, expected: float) -> None:
    assert claims[claim_id].measured[name] == pytest.approx(expected, abs=5e-5)


def test_corollary_1_is_limited_by_overdamped_modes(claims: dict[str, Claim]) -> None:
    measured = claims["corollary-1"].measured
    assert measured["pairs_not_proportional_K_1.39_1.2"] == 0
    assert measured["lambda_limit_K_1.39_1.2"] == pytest.approx(3.861, abs=5e-4)
    assert measured["lambda_limit_K_1_2"] == 1.0
    assert measured["pairs_not_proportional_K_1_2"] > 0


def test_the_claims_can_be_encoded_as_json(claims: dict[str, Claim]) -> None:
    assert msgspec.json.decode(msgspec.json.encode(list(claims.values())), type=list[Claim]) == list(claims.values())
    assert all(claim.full == "-" for claim in claims.values())


def test_progress_rises_to_one(claims: dict[str, Claim], shares: list[float]) -> None:
    assert claims
    assert shares == sorted(shares)
    assert shares[0] < 0.05
    assert shares[-1] == 1.0


def test_a_matrix_that_differs_from_the_papers_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    assert matrices.eq_27().verdict is ClaimVerdict.HOLDS
    monkeypatch.setattr(matrices, "EQ_27_G2", ["2 -1/2 -1/2 0", *matrices.EQ_27_G2[1:3], "0 -1/2 -1/3 1"])
    claim = matrices.eq_27()
    assert claim.verdict is FAILS
    assert claim.measured["g2_largest_difference"] == pytest.approx(1 / 6)


def test_wrong_weights_fail_figure_2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matrices, "neighbour_weights", lambda prcs: (1.0 / len(prcs),) * len(prcs))
    monkeypatch.setattr(matrices, "Weighted", matrices.Average22)
    claim = matrices.figure_2()
    assert claim.verdict is FAILS
    assert claim.ideal.startswith("1/4 for 1")
    assert matrices.section_5_2().verdict is FAILS


def test_the_platoon_claim_fails_with_another_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "chain", lambda _n: Shape("star", {1: ZERO3, 2: ZERO3, 3: ZERO3}, ((1, 2), (1, 3))))
    assert comparison.platoon().verdict is FAILS


def test_errata_are_complete() -> None:
    found = {erratum.place: erratum for erratum in errata()}
    assert len(found) == 9
    assert "1, 4, 4, 4 as printed" in found["Algorithm 1, line 3"].shown
    assert "diag(1, 0, 0, 0)" in found["eq. 11"].shown
    assert "2 instead of 0" in found["eq. 16, the line before it"].shown


def test_equation_8_as_printed_gives_a_wrong_acceleration() -> None:
    asked = (1.0, 0.5, 0.0)
    assert acceleration_of(*right_attitude()) == pytest.approx(asked, abs=1e-12)
    assert acceleration_of(*printed_attitude())[0] > 3.0
