"""Verdicts on figures 5 to 8, for constructed flights that confirm a claim and others that refute it."""

import numpy as np
import pytest

from paper_flights import BAD, CONDITION, FAILS, GOOD, HIGH, HOLDS, Peaks, found, noisy, platoon, platoons
from sitl.paper.flights import FlownPlan
from sitl.paper.platoon_claims import experiment_claims, platoon_claims
from sitl.report.claim import ClaimVerdict


@pytest.mark.parametrize("claim_id", ["fig-5-faster", "fig-6-faster"])
@pytest.mark.parametrize(
    ("weighted_s", "eq_22_s", "eq_26_s", "verdict"),
    [
        (8.0, 14.0, 14.0, HOLDS),
        (8.0, 14.0, 6.0, CONDITION),
        (14.0, 14.0, 14.0, FAILS),
        (20.0, 14.0, 14.0, FAILS),
        (99.0, 99.0, 99.0, FAILS),  # none ever settles
    ],
)
def test_the_weighted_law_must_be_faster(
    claim_id: str, weighted_s: float, eq_22_s: float, eq_26_s: float, verdict: ClaimVerdict
) -> None:
    flights = platoons(*(platoon(HIGH, settled_s) for settled_s in (weighted_s, eq_22_s, eq_26_s)))
    claim = found(platoon_claims, flights, claim_id)
    assert claim.verdict is verdict
    assert ("It does not hold against eq. 26." in claim.remark) == (verdict is CONDITION)
    assert ("never" in claim.ideal) == (weighted_s == 99.0)


@pytest.mark.parametrize(
    ("eq_22_m", "eq_26_m", "verdict"), [(0.5, 0.31, HOLDS), (0.31, 0.5, CONDITION), (0.1, 0.5, FAILS)]
)
def test_the_peak_of_figure_6_is_that_of_the_law_named_in_the_paper(
    eq_22_m: float, eq_26_m: float, verdict: ClaimVerdict
) -> None:
    flights = platoons(platoon(), platoon((eq_22_m, 0.1, 0.1)), platoon((eq_26_m, 0.1, 0.1)))
    claim = found(platoon_claims, flights, "fig-6-average")
    assert claim.verdict is verdict
    assert ("neither law" in claim.remark) == (verdict is FAILS)


@pytest.mark.parametrize(("claim_id", "pair"), [("fig-6-weighted-d12", 0), ("fig-6-weighted-d23-d34", 2)])
@pytest.mark.parametrize(
    ("ideal_m", "full_m", "verdict"),
    [(0.240, 0.245, HOLDS), (0.240, 0.300, CONDITION), (0.253, 0.253, CONDITION), (0.260, 0.240, FAILS)],
)
def test_distances_must_be_below_the_papers(
    claim_id: str, pair: int, ideal_m: float, full_m: float, verdict: ClaimVerdict
) -> None:
    def peaks(peak_m: float) -> Peaks:
        return (peak_m, 0.1, 0.1) if pair == 0 else (0.1, 0.1, peak_m)

    flights = platoons(platoon(peaks(ideal_m)), platoon(HIGH), full=platoon(peaks(full_m)))
    claim = found(platoon_claims, flights, claim_id)
    assert claim.verdict is verdict
    assert (claim.remark == "") == (verdict is HOLDS)
    assert ("To the centimetre" in claim.remark) == (verdict is CONDITION)
    assert ("attitude lag" in claim.remark) == (full_m == 0.300)


@pytest.mark.parametrize(
    ("weighted", "eq_26", "verdict"),
    [
        ((0.2, 0.25, 0.2), (0.3, 0.2, 0.15), HOLDS),
        ((0.2, 0.25, 0.2), (0.3, 0.4, 0.15), CONDITION),  # two peaks are smaller than those of eq. 26
        ((0.2, 0.1, 0.1), (0.3, 0.2, 0.15), FAILS),  # all are smaller
        ((0.4, 0.25, 0.2), (0.3, 0.2, 0.15), FAILS),  # none is
    ],
)
def test_one_peak_must_be_smaller_and_the_others_larger(weighted: Peaks, eq_26: Peaks, verdict: ClaimVerdict) -> None:
    flights = platoons(platoon(weighted), platoon(HIGH), platoon(eq_26))
    claim = found(platoon_claims, flights, "fig-6-one-peak")
    assert claim.verdict is verdict
    assert ("eq. 26 with neither model" in claim.remark) == (verdict is not HOLDS)


@pytest.mark.parametrize("claim_id", ["fig-7-response", "fig-8-peak"])
@pytest.mark.parametrize(
    ("flights", "verdict"),
    [
        (platoons(GOOD, BAD) + noisy((GOOD, BAD), (GOOD, BAD)), HOLDS),
        (platoons(GOOD, BAD) + noisy((GOOD, BAD), (BAD, GOOD)), CONDITION),
        (platoons(GOOD, BAD), CONDITION),  # no flight with noise at all
        (platoons(GOOD, BAD, GOOD) + noisy((GOOD, BAD)), CONDITION),  # no better than eq. 26
        (platoons(BAD, GOOD) + noisy((BAD, GOOD)), FAILS),
        (platoons(GOOD, GOOD) + noisy((GOOD, GOOD)), FAILS),
    ],
)
def test_the_verdict_with_noise(claim_id: str, flights: list[FlownPlan], verdict: ClaimVerdict) -> None:
    claim = found(experiment_claims, flights, claim_id)
    assert claim.verdict is verdict
    not_26 = claim.measured["noisy_pairs"] == 1 and verdict is CONDITION
    assert ("It does not hold against eq. 26." in claim.remark) == not_26


def test_a_platoon_that_does_not_move_has_no_response() -> None:
    still = {i: np.repeat(path_m[:1], 2, axis=0) for i, path_m in GOOD.items()}
    for flights in (platoons(still, still), platoons(still, GOOD)):
        assert found(experiment_claims, flights + noisy((still, GOOD)), "fig-7-response").verdict is FAILS
    followers_alone = GOOD | {1: still[1]}
    assert found(experiment_claims, platoons(followers_alone, BAD), "fig-7-response").verdict is FAILS


def test_figure_8_holds_with_a_condition_when_vehicles_come_too_close() -> None:
    close = platoon((0.1, -0.4, 0.1))
    claim = found(experiment_claims, platoons(close, BAD) + noisy((close, BAD)), "fig-8-peak")
    assert claim.verdict is CONDITION
    assert "0.40 m against 0.30 m (eq. 22, ideal)" in claim.remark
