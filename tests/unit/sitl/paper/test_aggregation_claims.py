"""Verdicts on figure 4, for constructed flights that confirm a claim and others that refute it."""

import pytest

from paper_flights import (
    CONDITION,
    EDGE_BREAKS,
    FAILS,
    GATHERS,
    GOOD,
    HOLDS,
    LEFT,
    LEFT_AND_MET,
    LEFT_LATE,
    STANDS,
    START_S,
    Paths,
    Peaks,
    aggregations,
    found,
    platoon,
    platoons,
)
from sitl.paper.aggregation_claims import Connectivity, aggregation_claims
from sitl.paper.flights import FlightSubject, FlownPlan
from sitl.report.claim import ClaimVerdict
from sitl.report.metrics import Formation


@pytest.mark.parametrize(
    ("eq_22", "eq_26", "verdict", "text"),
    [
        (LEFT, LEFT, HOLDS, "fails with both models"),
        (GATHERS, LEFT, CONDITION, "succeeds with both models"),
        (STANDS, LEFT, CONDITION, "neither fails early nor gathers"),
        (LEFT, LEFT_LATE, FAILS, "fails with both models"),  # 6 s are more than a few seconds
        (LEFT, LEFT_AND_MET, FAILS, "fails with both models"),  # only for a time
        (GATHERS, GATHERS, FAILS, "succeeds with both models"),
        (GATHERS, STANDS, FAILS, "succeeds with both models"),
    ],
)
def test_the_average_law_loses_its_leader_within_a_few_seconds(
    eq_22: Paths, eq_26: Paths, verdict: ClaimVerdict, text: str
) -> None:
    claim = found(aggregation_claims, aggregations(GATHERS, eq_22, eq_26), "fig-4-average")
    assert claim.verdict is verdict
    assert text in claim.remark
    assert ("never finally alone" in claim.ideal) == (eq_26 is not LEFT and eq_26 is not LEFT_LATE)


def test_a_leader_alone_at_the_end_of_a_short_flight_is_not_finally_alone() -> None:
    flights = aggregations(GATHERS, LEFT, LEFT)
    cut = [
        FlownPlan(f.plan, f.scenario, f.tracks, Formation(START_S, START_S + 2.0, START_S), (), None)
        if (f.plan.subject, f.plan.law) == (FlightSubject.AGGREGATION, "average_26")
        else f
        for f in flights
    ]
    assert found(aggregation_claims, cut, "fig-4-average").verdict is FAILS


@pytest.mark.parametrize(
    ("weighted", "noise", "verdict"),
    [
        (GATHERS, (GATHERS, GATHERS), HOLDS),
        (GATHERS, (GATHERS, LEFT), CONDITION),
        (GATHERS, (), CONDITION),  # nothing was flown with noise
        (STANDS, (GATHERS, GATHERS), FAILS),
        (LEFT, (GATHERS, GATHERS), FAILS),
    ],
)
def test_the_weighted_law_must_gather(weighted: Paths, noise: tuple[Paths, ...], verdict: ClaimVerdict) -> None:
    claim = found(aggregation_claims, aggregations(weighted, GATHERS, LEFT, *noise), "fig-4-weighted")
    assert claim.verdict is verdict
    assert ("does not gather" in claim.ideal) == (verdict is FAILS)


@pytest.mark.parametrize(
    ("weighted", "eq_22", "eq_26", "verdict", "remark"),
    [
        (GATHERS, LEFT, LEFT, HOLDS, "eq. 22 and eq. 26. With"),
        (GATHERS, EDGE_BREAKS, LEFT, HOLDS, "eq. 22 and eq. 26; compared with eq. 22 only in the time"),
        (GATHERS, GATHERS, LEFT, CONDITION, "eq. 26, not better than eq. 22"),
        (EDGE_BREAKS, GATHERS, LEFT, CONDITION, "eq. 26, not better than eq. 22"),
        (LEFT, LEFT_AND_MET, LEFT, FAILS, "neither average law"),
        (LEFT, LEFT, LEFT, FAILS, "neither average law"),
        (GATHERS, GATHERS, GATHERS, FAILS, "neither average law"),
    ],
)
def test_connectivity_must_be_better(
    weighted: Paths, eq_22: Paths, eq_26: Paths, verdict: ClaimVerdict, remark: str
) -> None:
    flights = aggregations(weighted, eq_22, eq_26, GATHERS, GATHERS)
    claim = found(aggregation_claims, flights, "fig-4-robust")
    assert claim.verdict is verdict
    assert claim.remark.startswith(f"With perfect sensors and both models better than {remark}")
    assert claim.ideal.startswith(f"edges out of range: {'none (weighted)' if weighted is GATHERS else '1-2 from'}")
    assert ("none (weighted)" in claim.remark) == (weighted is LEFT)


@pytest.mark.parametrize(
    ("noise", "average", "verdict", "remark"),
    [
        ((GATHERS, GATHERS, LEFT), LEFT, HOLDS, "2 of 3 flights (weighted) and 0 of 3 flights (eq. 22)"),
        ((GATHERS, LEFT), LEFT, CONDITION, "1 of 2 flights (weighted) and 0 of 2 flights (eq. 22)"),
        ((GATHERS, GATHERS), GATHERS, CONDITION, "2 of 2 flights (weighted) and 2 of 2 flights (eq. 22)"),
        ((), LEFT, CONDITION, "0 of 0 flights"),
    ],
)
def test_connectivity_must_be_better_with_noise_too(
    noise: tuple[Paths, ...], average: Paths, verdict: ClaimVerdict, remark: str
) -> None:
    flights = aggregations(GATHERS, LEFT, LEFT, *noise, average_noise=average)
    claim = found(aggregation_claims, flights, "fig-4-robust")
    assert claim.verdict is verdict
    assert remark in claim.remark


def test_better_means_worse_in_no_figure() -> None:
    base = Connectivity(broken="", out_of_sight_s=1.0, leader_alone_s=1.0, in_parts_s=1.0, connected_at_end=True)
    later = Connectivity(broken="", out_of_sight_s=0.5, leader_alone_s=2.0, in_parts_s=1.0, connected_at_end=True)
    in_parts = Connectivity(broken="", out_of_sight_s=0.5, leader_alone_s=0.5, in_parts_s=0.5, connected_at_end=False)
    assert not base.better_than(base)
    assert not later.better_than(base)
    assert not base.better_than(later)
    assert not in_parts.better_than(base)
    assert Connectivity(
        broken="", out_of_sight_s=1.0, leader_alone_s=1.0, in_parts_s=1.0, connected_at_end=True
    ).better_than(
        Connectivity(broken="", out_of_sight_s=1.0, leader_alone_s=1.0, in_parts_s=1.0, connected_at_end=False)
    )


@pytest.mark.parametrize(
    ("eq_26", "eq_26_peaks", "verdict"),
    [
        (LEFT, (0.31, 0.1, 0.1), HOLDS),
        (LEFT, (0.5, 0.1, 0.1), FAILS),
        (GATHERS, (0.31, 0.1, 0.1), FAILS),
        (STANDS, (0.31, 0.1, 0.1), FAILS),  # it does not gather, but it does not lose its leader
    ],
)
def test_one_average_law_must_fit_both_figures(eq_26: Paths, eq_26_peaks: Peaks, verdict: ClaimVerdict) -> None:
    flights = [f for f in aggregations(GATHERS, GATHERS, eq_26) if f.plan.subject is FlightSubject.AGGREGATION]
    flights += platoons(GOOD, platoon((0.31, 0.1, 0.1)), platoon(eq_26_peaks))
    claim = found(aggregation_claims, flights, "average-law")
    assert claim.verdict is verdict
    assert ("figure 4 is matched by neither law" in claim.remark) == (eq_26 is not LEFT)
