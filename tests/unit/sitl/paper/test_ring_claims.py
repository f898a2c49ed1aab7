"""Verdicts on figures 9 and 10 and on latency, for constructed flights that confirm a claim and others that refute it."""

import numpy as np
import pytest

from companion.types.flight import Role
from paper_flights import (
    FAILS,
    FOLLOWS,
    GOOD,
    HOLDS,
    LED,
    START_S,
    Paths,
    found,
    frozen,
    late,
    platoon,
    reports,
    ring,
    rings,
    stretched,
)
from sitl.paper.flights import Book, FlownPlan
from sitl.paper.ring_claims import ring_claims
from sitl.report.claim import ClaimVerdict
from sitl.report.summary import TopologyChange


def test_following_the_8_holds() -> None:
    claims = ring_claims(Book(rings()))
    assert {claim.verdict for claim in claims} == {HOLDS}
    measured = claims[0].measured
    assert measured["leader_rms_m_full"] == pytest.approx(0.0, abs=0.005)
    assert measured["all_rms_m_full"] == pytest.approx(np.sqrt((0.1**2 + 0.1**2 + 0.2**2) / 4), abs=0.005)
    assert measured["side_deviation_m_full"] == pytest.approx(0.1, abs=0.01)
    assert (measured["bound_leader_rms_m"], measured["bound_all_rms_m"]) == pytest.approx((0.3, 0.6))
    assert measured["bound_side_deviation_m"] == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    "flights",
    [
        rings(frozen()),
        rings(late(3.0)),
        rings(stretched(0.6)),
        rings(ring({0: 0.35, 1: 0.35, 2: 0.35})),  # the leader is off, and the square is whole
        rings(ring({0: 0.0, 1: 0.9, 2: 0.9})),
        rings(topology=reports(LED[:2])),  # the lead changes but once
        rings(topology=reports([(1, START_S)])),
        rings(topology=reports([(1, START_S), (3, START_S + 20.0), (1, START_S + 35.0)])),
        rings(failure="vehicle 3 has failed"),
    ],
    ids=[
        "frozen",
        "late",
        "stretched",
        "leader-off",
        "followers-off",
        "one-change",
        "no-change",
        "led-by-3",
        "failure",
    ],
)
def test_not_following_the_8_fails(flights: list[FlownPlan]) -> None:
    assert found(ring_claims, flights, "fig-9").verdict is FAILS


@pytest.mark.parametrize("claim_id", ["fig-10-matrices", "fig-10-at-once"])
def test_weights_that_never_change_fail(claim_id: str) -> None:
    stale = [
        change
        for change in reports()
        if not (change.vehicle == 3 and change.role is Role.FOLLOWER and change.time_s > START_S)
    ]
    claim = found(ring_claims, rings(topology=stale), claim_id)
    assert claim.verdict is FAILS
    assert claim_id == "fig-10-matrices" or claim.ideal.startswith("never")


@pytest.mark.parametrize(
    ("topology", "at_once", "matrices"),
    [
        (reports(prcs_late_s=0.5), FAILS, HOLDS),  # late, but right in the end
        (reports([(1, START_S)]), FAILS, FAILS),  # without a leader change
        (reports([(1, START_S), (3, START_S + 20.0)]), FAILS, FAILS),  # the paper prints nothing for vehicle 3
    ],
)
def test_weights_are_checked_in_each_leadership(
    topology: list[TopologyChange], at_once: ClaimVerdict, matrices: ClaimVerdict
) -> None:
    assert found(ring_claims, rings(topology=topology), "fig-10-at-once").verdict is at_once
    assert found(ring_claims, rings(topology=topology), "fig-10-matrices").verdict is matrices


@pytest.mark.parametrize("off_m", [{0: 0.0, 1: 0.2, 2: 0.1}, {0: 0.0, 1: 0.1, 2: 0.08}])
def test_the_opposite_vehicle_must_have_the_larger_error(off_m: dict[int, float]) -> None:
    assert found(ring_claims, rings(ring(off_m)), "latency-diagonal").verdict is FAILS


def test_latency_must_grow_from_hop_to_hop() -> None:
    assert found(ring_claims, rings(response=platoon((0.0, 0.0, 0.0))), "latency-hops").verdict is FAILS
    assert found(ring_claims, rings(response=frozen(GOOD)), "latency-hops").verdict is FAILS


@pytest.mark.parametrize("average", [FOLLOWS, ring({0: 0.0, 1: 0.2, 2: 0.15}), ring({0: 0.0, 1: 0.05, 2: 0.3})])
def test_latency_must_be_less_at_every_hop(average: Paths) -> None:
    assert found(ring_claims, rings(average=average), "latency-reduced").verdict is FAILS
