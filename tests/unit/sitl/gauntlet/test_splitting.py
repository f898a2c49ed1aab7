"""Multilevel splitting of a random walk, whose probability to rise so high is known exactly."""

from __future__ import annotations

from random import Random

import pytest

from sitl.gauntlet import splitting
from sitl.gauntlet.splitting import EVENT, Estimate, Leaf, Seed, Splitter, estimate, next_levels

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


def walk(seed: str, levels: list[float]) -> list[Leaf]:
    random = Random(seed)
    splitter = Splitter(levels, seed, random.seed)

    def simulate() -> None:
        place = 0
        for step in range(STEPS):
            place += 1 if random.random() < 0.5 else -1
            splitter.look(float(step), score(place))

    return splitter.run(simulate)


def estimated(seed: int, levels: list[float], roots: int) -> Estimate:
    return estimate([walk(f"{seed}.{root}", levels) for root in range(roots)], len(levels))


LEVELS = [score(height) + 0.25 for height in (8, 14, 20)] + [EVENT]


def test_the_estimate_finds_a_known_probability() -> None:
    known = probability(HEIGHT)
    assert known < 1e-3
    found = [estimated(seed, LEVELS, 100) for seed in range(4)]
    assert sum(one.probability for one in found) / len(found) == pytest.approx(known, rel=0.3)
    assert all(known < one.upper < 10.0 * known for one in found)
    assert all(one.simulations < 1000 for one in found)


def test_with_few_splits_the_mean_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splitting, "MOST_SPLITS", 3)
    near = [score(height) + 0.25 for height in (4, 8, 12)]
    found = [estimated(seed, near, 200) for seed in range(4)]
    assert sum(one.probability for one in found) / len(found) == pytest.approx(probability(12), rel=0.15)
    assert all(probability(12) < one.upper for one in found)
    assert max(len(walk(str(root), near)) for root in range(50)) == 1 + 3 * (splitting.BRANCHES - 1)


def test_without_levels_between_it_is_plain_monte_carlo() -> None:
    found = estimated(1, [score(12) + 0.25], 300)
    assert found.probability == pytest.approx(probability(12), abs=0.06)
    assert found.simulations == 300
    assert probability(12) < found.upper < 2.0 * probability(12)


def test_levels_are_quantiles_of_the_scores_below_the_one_before() -> None:
    leaves = [Leaf(passed=k % 2, least=2.0 + 0.01 * k, seeds=(Seed(0.0, str(k)),)) for k in range(96)]
    assert EVENT not in next_levels(leaves, [])
    assert next_levels(leaves, [9.0]) == pytest.approx((2.25, 2.07))  # of the 48 that passed: the 13th and the 4th
    assert next_levels(leaves[:20], [9.0]) == (EVENT,)  # too few
    assert next_levels(leaves, [9.0] * 11) == (EVENT,)
    near = [Leaf(1, 0.5, (Seed(0.0, "1"),))] * 20
    assert next_levels(near, [9.0]) == (EVENT,)
    beyond = [Leaf(1, 0.5 + 0.1 * k, (Seed(0.0, str(k)),)) for k in range(48)]
    assert next_levels(beyond, [9.0]) == pytest.approx((1.7, EVENT))


def test_where_nothing_happened_the_bound_remains() -> None:
    found = estimated(1, [EVENT], 60)
    assert (found.probability, found.simulations) == (0.0, 60)
    assert 0.04 < found.upper < 0.07  # Clopper and Pearson: 1 - 0.025^(1/60)


def test_a_branch_runs_again_by_its_seeds() -> None:
    levels = [score(6), score(12), EVENT]
    leaf = max((leaf for root in range(30) for leaf in walk(str(root), levels)), key=lambda one: len(one.seeds))
    assert len(leaf.seeds) >= 3
    random, place, least = Random(), 0, score(-STEPS)
    seeds = list(leaf.seeds)
    random.seed(seeds.pop(0).seed)
    for step in range(STEPS):
        place += 1 if random.random() < 0.5 else -1
        least = min(least, score(place))
        if seeds and seeds[0].at_s == step:
            random.seed(seeds.pop(0).seed)
        if least < EVENT:
            break
    assert least == leaf.least


def test_a_defect_in_a_branch_is_an_error() -> None:
    splitter = Splitter([2.0, EVENT], "1", lambda _: None)

    def fails() -> None:
        splitter.look(0.0, 1.5)
        raise ZeroDivisionError("in a branch")

    with pytest.raises(RuntimeError, match="a branch of the simulation ended with 1"):
        splitter.run(fails)
