"""All flown claims together: each holds and fails for suitable flights."""

from math import dist, inf

from paper_flights import (
    BAD,
    GATHERS,
    GOOD,
    HOLDS,
    LEFT,
    STANDS,
    START_S,
    aggregations,
    frozen,
    noisy,
    platoon,
    platoons,
    reports,
    ring,
    rings,
    scenario_of,
)
from sitl.paper.aggregation_claims import flight_claims
from sitl.paper.flights import Book, FlightSubject, Model


def test_every_flown_claim_is_tested_with_different_verdicts() -> None:
    good = aggregations(GATHERS, LEFT, LEFT, GATHERS) + rings() + noisy((GOOD, BAD))
    good = [f for f in good if f.plan.subject is not FlightSubject.PLATOON or f.plan.model is Model.NOISY]
    weighted, average = platoon((0.2, 0.24, 0.2), 6.0), platoon((0.31, 0.2, 0.15), 14.0)
    good += platoons(weighted, average)
    claims = flight_claims(Book(good))
    assert [claim.id for claim in claims if claim.verdict is not HOLDS] == []
    worst, wrong_way = platoon((0.4, 0.3, 0.3), 14.0), frozen(ring({0: 0.0, 1: 0.2, 2: 0.1}))
    bad = aggregations(STANDS, STANDS, STANDS, STANDS) + rings(wrong_way, wrong_way, reports([(1, START_S)]))
    bad = [f for f in bad if f.plan.subject is not FlightSubject.PLATOON] + platoons(worst, GOOD) + noisy((worst, GOOD))
    worse = {claim.id: claim.verdict for claim in flight_claims(Book(bad))}
    assert {claim_id for claim_id, verdict in worse.items() if verdict is HOLDS} == {"latency-hops"}
    assert len(claims) == len(worse) == 18


def test_starts_of_the_aggregation_have_the_papers_graph() -> None:
    starts = scenario_of(FlightSubject.AGGREGATION).starts_enu_m
    assert dist(starts[1], starts[2]) < 3.0 < dist(starts[1], starts[4]) < inf
