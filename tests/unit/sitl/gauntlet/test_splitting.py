"""Multilevel splitting of a random walk, whose probability to rise so high is known exactly."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from math import exp, inf
from multiprocessing import get_context
from random import Random

import pytest

from sitl.gauntlet.splitting import (
    EVENT,
    MOST_LEVELS,
    Branching,
    Estimate,
    Leaf,
    Seed,
    Splitter,
    estimate,
    next_level,
    upper_bound,
)

STEPS, HEIGHT = 60, 26  # of the walk: up or down by 1


def probability(height: int) -> float:
    """That the walk comes to this height within its steps, by recursion over the states."""
    at = {0: 1.0}
    reached = 0.0
    for _ in range(STEPS):
        after: dict[int, float] = {}
        for place, share in at.items():
            for other in (place - 1, place + 1):
                after[other] = after.get(other, 0.0) + 0.5 * share
        reached += after.pop(height, 0.0)
        at = after
    return reached


def score(place: int) -> float:
    """EVENT is passed at HEIGHT."""
    return EVENT + HEIGHT - 0.5 - place


def walk(job: Branching, event_height: int = HEIGHT) -> list[Leaf]:
    random = Random()
    splitter = Splitter(job, random.seed)

    def simulate() -> None:
        place, seeds = 0, list(job.seeds)
        for step in range(STEPS):
            if seeds and seeds[0].at_s == step:
                random.seed(seeds.pop(0).seed)
            place += 1 if random.random() < 0.5 else -1
            splitter.look(float(step + 1), score(place) + event_height - HEIGHT, score(place) + event_height - HEIGHT)

    return splitter.run(simulate)


def walks(jobs: Sequence[Branching]) -> list[Leaf]:
    return [leaf for job in jobs for leaf in walk(job)]


def first(seed: str) -> Branching:
    return Branching((Seed(0.0, seed),))


def estimates(count: int) -> list[Estimate]:
    return [estimate(walks, 100, 1000 * seed) for seed in range(count)]


def test_the_estimate_finds_a_known_probability() -> None:
    known = probability(HEIGHT)
    assert known < 1e-3
    # A process that has run thousands of tests takes fifteen times as long for each fork.
    with ProcessPoolExecutor(1, get_context("spawn")) as small:
        found = small.submit(estimates, 8).result()
    assert sum(one.probability for one in found) / len(found) == pytest.approx(known, rel=0.3)
    assert all(known < one.upper < 30.0 * known for one in found)
    assert all(one.simulations < 1000 and one.levels[-1] > EVENT > one.worst.least for one in found)


def test_where_the_event_is_frequent_it_is_plain_monte_carlo() -> None:
    found = estimate(lambda jobs: [leaf for job in jobs for leaf in walk(job, 4)], 300, 1)
    assert found.levels == ()
    assert found.probability == pytest.approx(probability(4), abs=0.06)
    assert found.simulations == 300
    assert probability(4) < found.upper < 1.3 * probability(4)


def test_the_level_is_a_quantile_of_the_scores() -> None:
    leaves = [Leaf(2.0 + 0.01 * k, 3.0, (Seed(0.0, str(k)),)) for k in range(96)]
    level, kept = next_level(leaves)
    assert level == pytest.approx(2.24)
    assert kept == leaves[:24]
    same = [Leaf(2.0, 3.0, leaf.seeds) for leaf in leaves]
    assert next_level(same) == (2.0, [])


def test_it_ends_where_all_are_equal_and_after_the_most_levels() -> None:
    def equal(jobs: Sequence[Branching]) -> list[Leaf]:
        return [Leaf(2.0, 3.0, job.seeds) for job in jobs]

    found = estimate(equal, 40, 1)
    assert (found.probability, found.levels, found.simulations) == (0.0, (), 40)

    def falling(jobs: Sequence[Branching]) -> list[Leaf]:
        seeds = [(*job.seeds, Seed(0.0, name)) for job in jobs for name in job.branches] or [job.seeds for job in jobs]
        return [Leaf(-float(len(one) * 1000 + k), 2.0, one) for k, one in enumerate(seeds)]

    found = estimate(falling, 40, 1)
    assert len(found.levels) == MOST_LEVELS
    assert 0.25**MOST_LEVELS < found.upper < 100.0 * 0.25**MOST_LEVELS


def test_where_nothing_happened_the_bound_remains() -> None:
    assert upper_bound([0.0], [60]) == pytest.approx(1.0 - 0.025 ** (1.0 / 60.0))  # Clopper and Pearson
    assert upper_bound([0.25, 0.0], [400, 100]) == pytest.approx(
        0.25 * (1.0 - 0.025**0.01) * exp(1.96 * 0.0866), rel=0.01
    )
    assert upper_bound([1.0, 1.0], [10, 10]) == 1.0


def test_a_branch_is_the_same_simulation_up_to_its_level() -> None:
    job = next(one for one in map(first, map(str, range(50))) if walk(one)[0].least < score(12))
    leaves = walk(Branching(job.seeds, score(12) + 0.25, ("a", "b")))
    assert [leaf.seeds[1].seed for leaf in leaves] == ["a", "b"]
    assert leaves[0].seeds[0] == job.seeds[0] and leaves[0].seeds[1].at_s == leaves[1].seeds[1].at_s
    assert all(leaf.least <= score(12) for leaf in leaves)
    assert walk(Branching(leaves[0].seeds)) == leaves[:1]
    again = walk(Branching(leaves[0].seeds, score(12) + 0.25, ("c",)))
    assert [one.seed for one in again[0].seeds] == [job.seeds[0].seed, "c"], "from where it branched itself"


def test_each_kept_one_has_as_many_branches() -> None:
    batches: list[Sequence[Branching]] = []

    def kept(jobs: Sequence[Branching]) -> list[Leaf]:
        batches.append(jobs)
        return walks(jobs)

    estimate(kept, 10, 5)
    assert len(batches[0]) == 10 and not batches[0][0].branches
    for jobs in batches[1:]:
        counts = sorted(len(job.branches) for job in jobs)
        assert sum(counts) >= 8 and counts[-1] - counts[0] <= 1
    seeds = [seed for jobs in batches[1:] for job in jobs for seed in job.branches]
    assert len(set(seeds)) == len(seeds)


def test_a_simulation_that_does_not_run_again_is_an_error() -> None:
    splitter = Splitter(Branching((Seed(0.0, "1"),), 2.0, ("a",)), lambda _: None)
    with pytest.raises(RuntimeError, match="did not come below"):
        splitter.run(lambda: splitter.look(0.0, 2.5, 2.5))


def test_a_defect_in_a_branch_is_an_error() -> None:
    splitter = Splitter(Branching((Seed(0.0, "1"),), 2.0, ("a",)), lambda _: None)

    def fails() -> None:
        splitter.look(0.0, 1.5, 1.5)
        raise ZeroDivisionError("in a branch")

    with pytest.raises(RuntimeError, match="a branch of the simulation ended with 1"):
        splitter.run(fails)


def test_a_simulation_without_a_score_has_an_infinite_one() -> None:
    assert Splitter(first("1"), lambda _: None).run(lambda: None) == [Leaf(inf, inf, first("1").seeds)]
