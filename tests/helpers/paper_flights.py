"""Tracks of the paper's experiments as if flown, for tests of the verdicts on flown claims."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.config.law import LawName
from companion.types.flight import Role
from sitl.flight.scenario import Scenario, reference_of
from sitl.paper.flights import COMPARED, NOISY_LAWS, PERFECT, Book, FlightSubject, FlownPlan, Model, PaperPlan
from sitl.report.claim import Claim, ClaimVerdict
from sitl.report.metrics import Formation, Track
from sitl.report.summary import TopologyChange

HOLDS, CONDITION, FAILS = ClaimVerdict.HOLDS, ClaimVerdict.CONDITION, ClaimVerdict.FAILS
START_S = 5.0  # of every formation here
Claims = Callable[[Book], list[Claim]]
Key = tuple[LawName, Model]


@cache
def scenario_of(subject: FlightSubject) -> Scenario:
    return PaperPlan(subject, "weighted", Model.IDEAL).scenario()


def flown(
    subject: FlightSubject,
    key: Key,
    paths_m: Mapping[int, FloatArray],
    end_s: float,
    *,
    seed: int = 1,
    topology: Sequence[TopologyChange] = (),
    failure: str | None = None,
) -> FlownPlan:
    """A flight from `paths_m`: positions (n, 3) of every vehicle from 0 to `end_s` at equal intervals."""
    tracks = {i: Track(np.linspace(0.0, end_s, len(path_m)), path_m) for i, path_m in paths_m.items()}
    formation = Formation(START_S, end_s, START_S)
    law, model = key
    plan = PaperPlan(subject, law, model, seed)
    return FlownPlan(plan, scenario_of(subject), tracks, formation, tuple(topology), failure)


def found(claims: Claims, flights: Iterable[FlownPlan], claim_id: str) -> Claim:
    """The claim with this id; all its texts must be complete."""
    claim = next(claim for claim in claims(Book(flights)) if claim.id == claim_id)
    assert "nan" not in claim.ideal + claim.full + claim.remark
    return claim


PLATOON_END_S = 35.0
TIMES_S = np.arange(0.0, PLATOON_END_S + 0.01, 0.05)
Peaks = tuple[float, float, float]
LOW: Peaks = (0.10, 0.08, 0.06)
HIGH: Peaks = (0.30, 0.20, 0.15)


def platoon(peaks_m: Peaks = LOW, settled_s: float = 6.0) -> dict[int, FloatArray]:
    """Vehicle 1 moves 1 m in the first second. Each distance grows by its peak, and is as desired after `settled_s`."""
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
    """Flights with both models. `full`: the weighted law, where it differs; `average_26`: where it differs from eq. 22."""
    paths: dict[LawName, dict[int, FloatArray]] = {
        "weighted": weighted,
        "average_22": average_22,
        "average_26": average_26 or average_22,
    }
    return [
        flown(
            FlightSubject.PLATOON,
            (law, model),
            full if full and (law, model) == ("weighted", Model.FULL) else paths[law],
            PLATOON_END_S,
        )
        for law in COMPARED
        for model in PERFECT
    ]


def noisy(*pairs: tuple[dict[int, FloatArray], dict[int, FloatArray]]) -> list[FlownPlan]:
    """Flights with noise: (weighted, eq. 22) for each seed."""
    return [
        flown(FlightSubject.PLATOON, (law, Model.NOISY), paths[law == "average_22"], PLATOON_END_S, seed=seed)
        for law in NOISY_LAWS
        for seed, paths in enumerate(pairs, start=1)
    ]


GOOD, BAD = platoon(LOW), platoon(HIGH)
AGGREGATION_END_S = 15.0
AGGREGATION_TIMES_S = np.arange(0.0, AGGREGATION_END_S + 0.01, 0.05)
SINCE_S = AGGREGATION_TIMES_S - START_S
Paths = dict[int, FloatArray]


def path(from_m: FloatArray, to_m: FloatArray, done: FloatArray) -> FloatArray:
    """Paths for `done` (n,), the share of the distance."""
    return np.asarray(from_m + done[:, np.newaxis] * (to_m - from_m))


def aggregation(leader: FloatArray, followers: FloatArray, aside_2_m: float = 0.0) -> Paths:
    """Share of the distance of each vehicle (n,); vehicle 2 is `aside_2_m` to the west from 2 s to 4 s."""
    scenario = scenario_of(FlightSubject.AGGREGATION)
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
    """`noise`: paths of the weighted law for each seed. The average law then loses its leader, or flies `average_noise`."""
    paths: dict[LawName, Paths] = {"weighted": weighted, "average_22": average_22, "average_26": average_26}
    keys: list[tuple[Key, Paths]] = [((law, model), paths[law]) for law in COMPARED for model in PERFECT]
    noisy_keys: tuple[Key, Key] = ("weighted", Model.NOISY), ("average_22", Model.NOISY)
    return [
        *(flown(FlightSubject.AGGREGATION, key, paths_m, AGGREGATION_END_S) for key, paths_m in keys),
        *(
            flown(FlightSubject.AGGREGATION, key, paths_m, AGGREGATION_END_S, seed=seed)
            for seed, own_m in enumerate(noise, start=1)
            for key, paths_m in zip(noisy_keys, (own_m, average_noise or LEFT), strict=True)
        ),
        *platoons(GOOD, platoon((0.31, 0.1, 0.1)), platoon((0.5, 0.1, 0.1))),
    ]


RING_END_S = START_S + 50.0
RING_TIMES_S = np.arange(0.0, RING_END_S + 0.01, 0.1)
LED: tuple[tuple[int, float], ...] = ((1, START_S), (2, START_S + 20.0), (1, START_S + 35.0))
RING = {1: (2, 4), 2: (1, 3), 3: (2, 4), 4: (1, 3)}
PRCS = {1: {1: 1, 2: 2, 4: 2, 3: 3}, 2: {2: 1, 1: 2, 3: 2, 4: 3}, 3: {3: 1, 2: 2, 4: 2, 1: 3}}


def ring(off_m: Mapping[int, float], led: Sequence[tuple[int, float]] = LED) -> Paths:
    """`off_m`: hops from the leader (PrC - 1) -> error of a vehicle to the east."""
    scenario = scenario_of(FlightSubject.FIGURE_8)
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
    """Reports in which roles change at once and PrCs `prcs_late_s` later."""
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
    reported = reports() if topology is None else topology
    return [
        *(
            flown(FlightSubject.FIGURE_8, (law, model), paths_m, RING_END_S, topology=reported, failure=failure)
            for law, paths_m in laws
            for model in PERFECT
        ),
        *platoons(response, BAD),
    ]


def frozen(paths_m: Paths = FOLLOWS) -> Paths:
    return {i: np.repeat(path_m[:1], len(path_m), axis=0) for i, path_m in paths_m.items()}


def late(seconds_s: float) -> Paths:
    return {i: np.roll(path_m, round(10 * seconds_s), axis=0) for i, path_m in FOLLOWS.items()}


def stretched(at_once_m: float) -> Paths:
    aside = np.outer((RING_TIMES_S > 30.0) & (RING_TIMES_S < 31.0), (-at_once_m, 0.0, 0.0))
    return FOLLOWS | {3: FOLLOWS[3] + aside}
