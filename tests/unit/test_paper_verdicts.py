"""Every verdict over the paper's figures can fall: flights made by hand that bear a claim out, and others that do not."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from math import dist, inf

import numpy as np
import pytest

from companion.config.law import LawName
from companion.core.arrays import FloatArray
from companion.types import Role
from sitl.metrics import Formation
from sitl.paper.aggregation_claims import Connectivity, aggregation_claims
from sitl.paper.book import PERFECT, Book
from sitl.paper.claims import Claim, Verdict
from sitl.paper.experiment_claims import experiment_claims
from sitl.paper.flight_claims import flight_claims
from sitl.paper.flights import COMPARED, NOISY_LAWS, FlownPlan, Model, Plan, Subject
from sitl.paper.platoon_claims import platoon_claims
from sitl.paper.ring_claims import ring_claims
from sitl.scenario import Scenario, reference_of
from sitl.tracks import Track
from sitl.watch import TopologyChange

HOLDS, CONDITION, FAILS = Verdict.HOLDS, Verdict.CONDITION, Verdict.FAILS
START_S = 5.0  # of every formation here
Claims = Callable[[Book], list[Claim]]
Key = tuple[LawName, Model]


@cache
def scenario_of(subject: Subject) -> Scenario:
    return Plan(subject, "weighted", Model.IDEAL).scenario()


def flown(
    subject: Subject,
    key: Key,
    paths_m: Mapping[int, FloatArray],
    end_s: float,
    *,
    seed: int = 1,
    topology: Sequence[TopologyChange] = (),
    failure: str | None = None,
) -> FlownPlan:
    """`paths_m`: positions (n, 3) of every vehicle from 0 to `end_s`, at even times."""
    tracks = {i: Track(np.linspace(0.0, end_s, len(path_m)), path_m) for i, path_m in paths_m.items()}
    formation = Formation(START_S, end_s, START_S)
    law, model = key
    plan = Plan(subject, law, model, seed)
    return FlownPlan(plan, scenario_of(subject), tracks, formation, tuple(topology), failure)


def found(claims: Claims, flights: Iterable[FlownPlan], claim_id: str) -> Claim:
    """The claim with its words, in which no figure is missing whatever came out."""
    claim = next(claim for claim in claims(Book(flights)) if claim.id == claim_id)
    assert "nan" not in claim.ideal + claim.full + claim.remark
    return claim


# ---------------------------------------------------------------- the platoon

PLATOON_END_S = 35.0
TIMES_S = np.arange(0.0, PLATOON_END_S + 0.01, 0.05)
Peaks = tuple[float, float, float]
LOW: Peaks = (0.10, 0.08, 0.06)
HIGH: Peaks = (0.30, 0.20, 0.15)


def platoon(peaks_m: Peaks = LOW, settled_s: float = 6.0) -> dict[int, FloatArray]:
    """UAV 1 goes 1 m in the first second. Each distance grows by its peak in that time and is as wanted after `settled_s`."""
    since_s = TIMES_S - START_S
    x_m, paths_m = np.clip(since_s, 0.0, 1.0), {}
    for i, peak_m in enumerate((*peaks_m, 0.0), start=1):
        paths_m[i] = np.stack([x_m, np.zeros_like(x_m), np.ones_like(x_m)], axis=1)
        x_m = x_m - 1.5 - peak_m * np.interp(since_s, [0.0, 1.0, settled_s], [0.0, 1.0, 0.0])
    return paths_m


def platoons(
    weighted: dict[int, FloatArray],
    average_22: dict[int, FloatArray],
    average_26: dict[int, FloatArray] | None = None,
    *,
    full: dict[int, FloatArray] | None = None,
) -> list[FlownPlan]:
    """The same with both models; `full` for the weighted law where that differs, `average_26` where it is not as eq. 22."""
    paths: dict[LawName, dict[int, FloatArray]] = {
        "weighted": weighted,
        "average_22": average_22,
        "average_26": average_26 or average_22,
    }
    return [
        flown(
            Subject.PLATOON,
            (law, model),
            full if full and (law, model) == ("weighted", Model.FULL) else paths[law],
            PLATOON_END_S,
        )
        for law in COMPARED
        for model in PERFECT
    ]


def noisy(*pairs: tuple[dict[int, FloatArray], dict[int, FloatArray]]) -> list[FlownPlan]:
    """(weighted, eq. 22) seed by seed."""
    return [
        flown(Subject.PLATOON, (law, Model.NOISY), paths[law == "average_22"], PLATOON_END_S, seed=seed)
        for law in NOISY_LAWS
        for seed, paths in enumerate(pairs, start=1)
    ]


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
def test_faster(claim_id: str, weighted_s: float, eq_22_s: float, eq_26_s: float, verdict: Verdict) -> None:
    flights = platoons(*(platoon(HIGH, settled_s) for settled_s in (weighted_s, eq_22_s, eq_26_s)))
    claim = found(platoon_claims, flights, claim_id)
    assert claim.verdict is verdict
    assert ("Not so against eq. 26." in claim.remark) == (verdict is CONDITION)
    assert ("never" in claim.ideal) == (weighted_s == 99.0)


@pytest.mark.parametrize(
    ("eq_22_m", "eq_26_m", "verdict"), [(0.5, 0.31, HOLDS), (0.31, 0.5, CONDITION), (0.1, 0.5, FAILS)]
)
def test_the_peak_of_figure_6_is_judged_for_the_law_that_the_paper_names(
    eq_22_m: float, eq_26_m: float, verdict: Verdict
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
def test_distances_below_the_papers(claim_id: str, pair: int, ideal_m: float, full_m: float, verdict: Verdict) -> None:
    def peaks(peak_m: float) -> Peaks:
        return (peak_m, 0.1, 0.1) if pair == 0 else (0.1, 0.1, peak_m)

    flights = platoons(platoon(peaks(ideal_m)), platoon(HIGH), full=platoon(peaks(full_m)))
    claim = found(platoon_claims, flights, claim_id)
    assert claim.verdict is verdict
    assert (claim.remark == "") == (verdict is HOLDS)
    assert ("To the centimetre" in claim.remark) == (verdict is CONDITION)
    assert ("late" in claim.remark) == (full_m == 0.300)


@pytest.mark.parametrize(
    ("weighted", "eq_26", "verdict"),
    [
        ((0.2, 0.25, 0.2), (0.3, 0.2, 0.15), HOLDS),
        ((0.2, 0.25, 0.2), (0.3, 0.4, 0.15), CONDITION),  # two peaks are smaller than those of eq. 26
        ((0.2, 0.1, 0.1), (0.3, 0.2, 0.15), FAILS),  # all are smaller
        ((0.4, 0.25, 0.2), (0.3, 0.2, 0.15), FAILS),  # none is
    ],
)
def test_one_peak_is_smaller_and_the_others_larger(weighted: Peaks, eq_26: Peaks, verdict: Verdict) -> None:
    flights = platoons(platoon(weighted), platoon(HIGH), platoon(eq_26))
    claim = found(platoon_claims, flights, "fig-6-one-peak")
    assert claim.verdict is verdict
    assert ("eq. 26 with neither model" in claim.remark) == (verdict is not HOLDS)


# ---------------------------------------------------------------- the platoon with noise

GOOD, BAD = platoon(LOW), platoon(HIGH)


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
def test_with_noise(claim_id: str, flights: list[FlownPlan], verdict: Verdict) -> None:
    claim = found(experiment_claims, flights, claim_id)
    assert claim.verdict is verdict
    not_26 = claim.measured["noisy_pairs"] == 1 and verdict is CONDITION
    assert ("Not so against eq. 26." in claim.remark) == not_26


def test_a_platoon_that_stands_still_responds_to_nobody() -> None:
    still = {i: np.repeat(path_m[:1], 2, axis=0) for i, path_m in GOOD.items()}
    for flights in (platoons(still, still), platoons(still, GOOD)):
        assert found(experiment_claims, flights + noisy((still, GOOD)), "fig-7-response").verdict is FAILS
    followers_alone = GOOD | {1: still[1]}
    assert found(experiment_claims, platoons(followers_alone, BAD), "fig-7-response").verdict is FAILS


def test_vehicles_that_come_too_close_are_a_condition_of_figure_8() -> None:
    close = platoon((0.1, -0.4, 0.1))
    claim = found(experiment_claims, platoons(close, BAD) + noisy((close, BAD)), "fig-8-peak")
    assert claim.verdict is CONDITION
    assert "0.40 m against 0.30 m (eq. 22, ideal)" in claim.remark


# ---------------------------------------------------------------- the aggregation

AGGREGATION_END_S = 15.0
AGGREGATION_TIMES_S = np.arange(0.0, AGGREGATION_END_S + 0.01, 0.05)
SINCE_S = AGGREGATION_TIMES_S - START_S
Paths = dict[int, FloatArray]


def path(from_m: FloatArray, to_m: FloatArray, done: FloatArray) -> FloatArray:
    """`done` (n,): the share of the way."""
    return np.asarray(from_m + done[:, np.newaxis] * (to_m - from_m))


def aggregation(leader: FloatArray, followers: FloatArray, aside_2_m: float = 0.0) -> Paths:
    """How much of its way each has done (n,); UAV 2 is `aside_2_m` off to the west from 2 s to 4 s."""
    scenario = scenario_of(Subject.AGGREGATION)
    goal_m, paths_m = np.array(reference_of(scenario)(0.0).position_enu_m), {}
    for member in scenario.fleet.vehicles:
        start_m = np.array(scenario.starts_enu_m[member.id]) + np.array([0.0, 0.0, 1.0])
        done = leader if member.id == 1 else followers
        paths_m[member.id] = path(start_m, goal_m + np.array(member.slot_enu_m), done)
    paths_m[2] = paths_m[2] - np.outer((SINCE_S >= 2.0) & (SINCE_S < 4.0), (aside_2_m, 0.0, 0.0))
    return paths_m


def ramp(from_s: float, to_s: float) -> FloatArray:
    return np.clip((SINCE_S - from_s) / (to_s - from_s), 0.0, 1.0)


GATHERS = aggregation(ramp(0.0, 5.0), ramp(0.0, 5.0))
EDGE_BREAKS = aggregation(ramp(0.0, 5.0), ramp(0.0, 5.0), 1.2)
LEFT = aggregation(ramp(0.0, 1.0), ramp(98.0, 99.0))
LEFT_LATE = aggregation(ramp(6.0, 7.0), ramp(98.0, 99.0))
LEFT_AND_MET = aggregation(ramp(0.0, 1.0), ramp(4.0, 9.0))
STANDS = aggregation(ramp(98.0, 99.0), ramp(98.0, 99.0))


def aggregations(
    weighted: Paths, average_22: Paths, average_26: Paths, *noise: Paths, average_noise: Paths | None = None
) -> list[FlownPlan]:
    """`noise`: the weighted law seed by seed; the first average law loses its leader then, or does `average_noise`."""
    paths: dict[LawName, Paths] = {"weighted": weighted, "average_22": average_22, "average_26": average_26}
    keys: list[tuple[Key, Paths]] = [((law, model), paths[law]) for law in COMPARED for model in PERFECT]
    noisy_keys: tuple[Key, Key] = ("weighted", Model.NOISY), ("average_22", Model.NOISY)
    return [
        *(flown(Subject.AGGREGATION, key, paths_m, AGGREGATION_END_S) for key, paths_m in keys),
        *(
            flown(Subject.AGGREGATION, key, paths_m, AGGREGATION_END_S, seed=seed)
            for seed, own_m in enumerate(noise, start=1)
            for key, paths_m in zip(noisy_keys, (own_m, average_noise or LEFT), strict=True)
        ),
        *platoons(GOOD, platoon((0.31, 0.1, 0.1)), platoon((0.5, 0.1, 0.1))),
    ]


@pytest.mark.parametrize(
    ("eq_22", "eq_26", "verdict", "words"),
    [
        (LEFT, LEFT, HOLDS, "fails with both models"),
        (GATHERS, LEFT, CONDITION, "succeeds with both models"),
        (STANDS, LEFT, CONDITION, "neither fails soon nor gathers"),
        (LEFT, LEFT_LATE, FAILS, "fails with both models"),  # 6 s are not a few
        (LEFT, LEFT_AND_MET, FAILS, "fails with both models"),  # not for good
        (GATHERS, GATHERS, FAILS, "succeeds with both models"),
        (GATHERS, STANDS, FAILS, "succeeds with both models"),
    ],
)
def test_the_average_law_loses_its_leader_within_a_few_seconds(
    eq_22: Paths, eq_26: Paths, verdict: Verdict, words: str
) -> None:
    claim = found(aggregation_claims, aggregations(GATHERS, eq_22, eq_26), "fig-4-average")
    assert claim.verdict is verdict
    assert words in claim.remark
    assert ("never alone for good" in claim.ideal) == (eq_26 is not LEFT and eq_26 is not LEFT_LATE)


def test_a_leader_alone_at_the_end_of_a_flight_of_two_seconds_is_not_alone_for_good() -> None:
    flights = aggregations(GATHERS, LEFT, LEFT)
    cut = [
        FlownPlan(f.plan, f.scenario, f.tracks, Formation(START_S, START_S + 2.0, START_S), (), None)
        if (f.plan.subject, f.plan.law) == (Subject.AGGREGATION, "average_26")
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
def test_the_weighted_law_gathers(weighted: Paths, noise: tuple[Paths, ...], verdict: Verdict) -> None:
    claim = found(aggregation_claims, aggregations(weighted, GATHERS, LEFT, *noise), "fig-4-weighted")
    assert claim.verdict is verdict
    assert ("does not gather" in claim.ideal) == (verdict is FAILS)


@pytest.mark.parametrize(
    ("weighted", "eq_22", "eq_26", "verdict", "remark"),
    [
        (GATHERS, LEFT, LEFT, HOLDS, "eq. 22 and eq. 26. With"),
        (GATHERS, EDGE_BREAKS, LEFT, HOLDS, "eq. 22 and eq. 26; against eq. 22 only in how long"),
        (GATHERS, GATHERS, LEFT, CONDITION, "eq. 26, not better than eq. 22"),
        (EDGE_BREAKS, GATHERS, LEFT, CONDITION, "eq. 26, not better than eq. 22"),
        (LEFT, LEFT_AND_MET, LEFT, FAILS, "neither average law"),
        (LEFT, LEFT, LEFT, FAILS, "neither average law"),
        (GATHERS, GATHERS, GATHERS, FAILS, "neither average law"),
    ],
)
def test_connectivity_is_compared(weighted: Paths, eq_22: Paths, eq_26: Paths, verdict: Verdict, remark: str) -> None:
    flights = aggregations(weighted, eq_22, eq_26, GATHERS, GATHERS)
    claim = found(aggregation_claims, flights, "fig-4-robust")
    assert claim.verdict is verdict
    assert claim.remark.startswith(f"With perfect sensors and both models better than {remark}")
    assert claim.ideal.startswith(f"edges out of sight: {'none (weighted)' if weighted is GATHERS else '1-2 from'}")
    assert ("nobody (weighted)" in claim.remark) == (weighted is LEFT)


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
    noise: tuple[Paths, ...], average: Paths, verdict: Verdict, remark: str
) -> None:
    flights = aggregations(GATHERS, LEFT, LEFT, *noise, average_noise=average)
    claim = found(aggregation_claims, flights, "fig-4-robust")
    assert claim.verdict is verdict
    assert remark in claim.remark


def test_better_is_worse_in_nothing() -> None:
    base = Connectivity(broken="", out_s=1.0, alone_s=1.0, apart_s=1.0, whole=True)
    later = Connectivity(broken="", out_s=0.5, alone_s=2.0, apart_s=1.0, whole=True)
    in_parts = Connectivity(broken="", out_s=0.5, alone_s=0.5, apart_s=0.5, whole=False)
    assert not base.better_than(base)
    assert not later.better_than(base)
    assert not base.better_than(later)
    assert not in_parts.better_than(base)
    assert Connectivity(broken="", out_s=1.0, alone_s=1.0, apart_s=1.0, whole=True).better_than(
        Connectivity(broken="", out_s=1.0, alone_s=1.0, apart_s=1.0, whole=False)
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
def test_one_average_law(eq_26: Paths, eq_26_peaks: Peaks, verdict: Verdict) -> None:
    flights = [f for f in aggregations(GATHERS, GATHERS, eq_26) if f.plan.subject is Subject.AGGREGATION]
    flights += platoons(GOOD, platoon((0.31, 0.1, 0.1)), platoon(eq_26_peaks))
    claim = found(aggregation_claims, flights, "average-law")
    assert claim.verdict is verdict
    assert ("neither law does what figure 4 shows" in claim.remark) == (eq_26 is not LEFT)


# ---------------------------------------------------------------- the ring on the 8

RING_END_S = START_S + 50.0
RING_TIMES_S = np.arange(0.0, RING_END_S + 0.01, 0.1)
LED: tuple[tuple[int, float], ...] = ((1, START_S), (2, START_S + 20.0), (1, START_S + 35.0))
RING = {1: (2, 4), 2: (1, 3), 3: (2, 4), 4: (1, 3)}
PRCS = {1: {1: 1, 2: 2, 4: 2, 3: 3}, 2: {2: 1, 1: 2, 3: 2, 4: 3}, 3: {3: 1, 2: 2, 4: 2, 1: 3}}


def ring(off_m: Mapping[int, float], led: Sequence[tuple[int, float]] = LED) -> Paths:
    """`off_m`: hops from the leader (PrC - 1) -> how far off its place to the east a vehicle is."""
    scenario = scenario_of(Subject.FIGURE_8)
    reference = reference_of(scenario)
    r_m = np.array([reference(max(0.0, time_s - START_S)).position_enu_m for time_s in RING_TIMES_S])
    leaders = [
        next(i for i, from_s in reversed(led) if time_s >= from_s or from_s == START_S) for time_s in RING_TIMES_S
    ]
    return {
        member.id: r_m
        + np.array(member.slot_enu_m)
        + np.outer([off_m[PRCS[leader][member.id] - 1] for leader in leaders], (1.0, 0.0, 0.0))
        for member in scenario.fleet.vehicles
    }


def reports(led: Sequence[tuple[int, float]] = LED, prcs_late_s: float = 0.08) -> list[TopologyChange]:
    """Roles change at once, PrCs `prcs_late_s` later."""
    changes, before = [], dict.fromkeys(RING, 4)
    for leader, from_s in led:
        for late_s, prcs in ((0.0, before), (prcs_late_s, PRCS[leader])):
            changes += [
                TopologyChange(
                    time_s=from_s + late_s if from_s > START_S else 0.0,
                    vehicle=i,
                    role=Role.LEADER if i == leader else Role.FOLLOWER,
                    epoch=0,
                    prc=1 if i == leader else prcs[i],
                    neighbours=RING[i],
                    in_formation=True,
                )
                for i in RING
            ]
        before = PRCS[leader]
    return sorted(changes, key=lambda change: change.time_s)


NEAR, FAR = {0: 0.0, 1: 0.1, 2: 0.2}, {0: 0.0, 1: 0.2, 2: 0.3}
FOLLOWS, FOLLOWS_WORSE = ring(NEAR), ring(FAR)


def rings(
    weighted: Paths = FOLLOWS,
    average: Paths = FOLLOWS_WORSE,
    topology: Sequence[TopologyChange] | None = None,
    failure: str | None = None,
    response: Paths = GOOD,
) -> list[FlownPlan]:
    laws: list[tuple[LawName, Paths]] = [("weighted", weighted), ("average_22", average)]
    said = reports() if topology is None else topology
    return [
        *(
            flown(Subject.FIGURE_8, (law, model), paths_m, RING_END_S, topology=said, failure=failure)
            for law, paths_m in laws
            for model in PERFECT
        ),
        *platoons(response, BAD),
    ]


def test_what_follows_the_8_holds() -> None:
    claims = ring_claims(Book(rings()))
    assert {claim.verdict for claim in claims} == {HOLDS}
    measured = claims[0].measured
    assert measured["leader_rms_m_full"] == pytest.approx(0.0, abs=0.005)
    assert measured["all_rms_m_full"] == pytest.approx(np.sqrt((0.1**2 + 0.1**2 + 0.2**2) / 4), abs=0.005)
    assert measured["side_deviation_m_full"] == pytest.approx(0.1, abs=0.01)
    assert (measured["bound_leader_rms_m"], measured["bound_all_rms_m"]) == pytest.approx((0.3, 0.6))
    assert measured["bound_side_deviation_m"] == pytest.approx(1 / 3)


def frozen(paths_m: Paths = FOLLOWS) -> Paths:
    return {i: np.repeat(path_m[:1], len(path_m), axis=0) for i, path_m in paths_m.items()}


def late(seconds_s: float) -> Paths:
    return {i: np.roll(path_m, round(10 * seconds_s), axis=0) for i, path_m in FOLLOWS.items()}


def stretched(at_once_m: float) -> Paths:
    aside = np.outer((RING_TIMES_S > 30.0) & (RING_TIMES_S < 31.0), (-at_once_m, 0.0, 0.0))
    return FOLLOWS | {3: FOLLOWS[3] + aside}


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
        rings(failure="UAV 3 has failed"),
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
def test_what_does_not_follow_the_8_fails(flights: list[FlownPlan]) -> None:
    assert found(ring_claims, flights, "fig-9").verdict is FAILS


@pytest.mark.parametrize("claim_id", ["fig-10-matrices", "fig-10-at-once"])
def test_weights_that_never_follow_fail(claim_id: str) -> None:
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
        (reports([(1, START_S)]), FAILS, FAILS),  # nobody else ever led
        (reports([(1, START_S), (3, START_S + 20.0)]), FAILS, FAILS),  # the paper prints nothing for UAV 3
    ],
)
def test_weights_are_judged_by_lead(topology: list[TopologyChange], at_once: Verdict, matrices: Verdict) -> None:
    assert found(ring_claims, rings(topology=topology), "fig-10-at-once").verdict is at_once
    assert found(ring_claims, rings(topology=topology), "fig-10-matrices").verdict is matrices


@pytest.mark.parametrize("off_m", [{0: 0.0, 1: 0.2, 2: 0.1}, {0: 0.0, 1: 0.1, 2: 0.08}])
def test_the_vehicle_across_must_be_farther_off(off_m: dict[int, float]) -> None:
    assert found(ring_claims, rings(ring(off_m)), "latency-diagonal").verdict is FAILS


def test_latency_must_grow_from_hop_to_hop() -> None:
    assert found(ring_claims, rings(response=platoon((0.0, 0.0, 0.0))), "latency-hops").verdict is FAILS
    assert found(ring_claims, rings(response=frozen(GOOD)), "latency-hops").verdict is FAILS


@pytest.mark.parametrize("average", [FOLLOWS, ring({0: 0.0, 1: 0.2, 2: 0.15}), ring({0: 0.0, 1: 0.05, 2: 0.3})])
def test_latency_must_be_less_at_every_hop(average: Paths) -> None:
    assert found(ring_claims, rings(average=average), "latency-reduced").verdict is FAILS


# ---------------------------------------------------------------- all of them


def test_every_claim_from_flights_is_tried_here_both_ways() -> None:
    good = aggregations(GATHERS, LEFT, LEFT, GATHERS) + rings() + noisy((GOOD, BAD))
    good = [f for f in good if f.plan.subject is not Subject.PLATOON or f.plan.model is Model.NOISY]
    weighted, average = platoon((0.2, 0.24, 0.2), 6.0), platoon((0.31, 0.2, 0.15), 14.0)
    good += platoons(weighted, average)
    claims = flight_claims(Book(good))
    assert [claim.id for claim in claims if claim.verdict is not HOLDS] == []
    worst, wrong_way = platoon((0.4, 0.3, 0.3), 14.0), frozen(ring({0: 0.0, 1: 0.2, 2: 0.1}))
    bad = aggregations(STANDS, STANDS, STANDS, STANDS) + rings(wrong_way, wrong_way, reports([(1, START_S)]))
    bad = [f for f in bad if f.plan.subject is not Subject.PLATOON] + platoons(worst, GOOD) + noisy((worst, GOOD))
    worse = {claim.id: claim.verdict for claim in flight_claims(Book(bad))}
    assert {claim_id for claim_id, verdict in worse.items() if verdict is HOLDS} == {"latency-hops"}
    assert len(claims) == len(worse) == 18


def test_starts_of_the_aggregation_see_each_other_as_the_paper_has_it() -> None:
    starts = scenario_of(Subject.AGGREGATION).starts_enu_m
    assert dist(starts[1], starts[2]) < 3.0 < dist(starts[1], starts[4]) < inf
