"""Rare events by adaptive multilevel splitting: simulations that come near the event branch, and replace the others.

A measure below EVENT is the event. A score says how near to it a simulation is, best before the measure does: where branches
begin at the last moment, they hardly differ. A stage has a fixed number of simulations, and its level is the score that one in
KEPT_OF of them comes below. These are kept. Each of the others is replaced by a branch of a kept one, which is the same
simulation up to where its score first falls below the level, and has new random numbers from there. So one level after the
other is passed, each with one in KEPT_OF of the probability. The product of the shares that were kept has the probability as
its mean, whatever the score is (Brehier, Gazeau, Goudenege, Lelievre and Rousset, Annals of Applied Probability 26(6), 2016).

A branch begins by os.fork: the state of a simulation is in the call stack and in hundreds of objects, and a copy of the process
has all of it. The kept simulation runs again for that, by its seeds, up to the level; its branches fly on in children, one
after the other.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, inf, log, prod, sqrt
from random import Random
from statistics import NormalDist

import msgspec
from msgspec import Struct

EVENT = 1.0  # a measure below it is the event
KEPT_OF = 4
MOST_LEVELS = 18  # 4^-18 = 1.5e-11
CONFIDENCE = 0.95


class Seed(Struct, frozen=True):
    """The random numbers of a simulation are those of this seed from `at_s` on."""

    at_s: float
    seed: str


class Leaf(Struct, frozen=True):
    """A simulation that ended: its least score and measure, and the seeds by which it runs again."""

    score: float
    least: float
    seeds: tuple[Seed, ...]


class Branching(Struct, frozen=True):
    """A simulation to run by its seeds. Below `level` it ends, and its branches go on with these seeds."""

    seeds: tuple[Seed, ...]
    level: float = -inf
    branches: tuple[str, ...] = ()


class _Split(BaseException):
    """Ends a simulation whose branches have run."""


class Splitter:
    """Runs one simulation or its branches. The simulation applies its seeds, and calls `look` as it goes on."""

    def __init__(self, job: Branching, reseed: Callable[[str], None]) -> None:
        """`reseed` gives the simulation new random numbers from a seed."""
        self._seeds, self._level, self._branches = job.seeds, job.level, job.branches
        self._reseed = reseed
        self._score = self._least = inf
        self._leaves: list[Leaf] = []
        self._out: int | None = None  # of a branch: the pipe to its parent

    def look(self, at_s: float, score: float, measure: float) -> None:
        """At a point of a simulation: its score and measure now. Does not return where the branches have run."""
        self._score, self._least = min(self._score, score), min(self._least, measure)
        if score >= self._level:
            return
        self._level = -inf
        before = tuple(one for one in self._seeds if one.at_s < at_s)
        for seed in self._branches:
            if self._became_branch(before, Seed(at_s, seed)):
                return
        raise _Split

    def run(self, simulate: Callable[[], None]) -> list[Leaf]:
        """The leaves: of the simulation, or of its branches. Returns in the first process alone.

        Raises what the simulation raised, and RuntimeError where a branch failed or the level was not passed.
        """
        try:
            simulate()
            if self._level > -inf:
                raise RuntimeError(f"the simulation did not come below {self._level} again")
            self._leaves = [Leaf(self._score, self._least, self._seeds)]
        except _Split:
            pass
        except BaseException:
            if self._out is None:
                raise
            traceback.print_exc()
            os._exit(1)
        if self._out is None:
            return self._leaves
        content = msgspec.msgpack.encode(self._leaves)
        while content:
            content = content[os.write(self._out, content) :]
        os._exit(0)

    def _became_branch(self, before: tuple[Seed, ...], seed: Seed) -> bool:
        """In a new process True; in this one False, once that one has ended, with its leaf."""
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(ours)
            self._out, self._leaves = theirs, []
            self._seeds = (*before, seed)
            self._reseed(seed.seed)
            return True
        os.close(theirs)
        with os.fdopen(ours, "rb") as pipe:
            content = pipe.read()
        _, status = os.waitpid(child, 0)
        if status:
            raise RuntimeError(f"a branch of the simulation ended with {os.waitstatus_to_exitcode(status)}")
        self._leaves += msgspec.msgpack.decode(content, type=list[Leaf])
        return False


@dataclass(frozen=True, slots=True)
class Estimate:
    """The probability of the event in one simulation, with an upper bound of CONFIDENCE.

    `simulations`: all, with branches; `worst`: the one of the least measure.
    """

    probability: float
    upper: float
    levels: tuple[float, ...]
    simulations: int
    worst: Leaf


def estimate(simulate: Callable[[Sequence[Branching]], list[Leaf]], count: int, first_seed: int) -> Estimate:
    """By stages of `count` simulations. The first ones have the seeds from `first_seed` on; `simulate` runs a batch."""
    random = Random(first_seed)
    leaves = simulate([Branching((Seed(0.0, str(first_seed + index)),)) for index in range(count)])
    levels: list[float] = []
    shares: list[float] = []
    trials, simulations = [count], count
    while True:
        events = sum(leaf.least < EVENT for leaf in leaves)
        level, kept = next_level(leaves)
        if KEPT_OF * events >= count or not kept or len(levels) == MOST_LEVELS:
            break
        levels.append(level)
        shares.append(len(kept) / count)
        trials.append(len(kept))
        name = f"{first_seed}.{len(levels)}"
        leaves = kept + simulate(_branchings(kept, count - len(kept), level, name, random))
        simulations += count - len(kept)
    shares.append(events / count)
    worst = min(leaves, key=lambda leaf: leaf.least)
    return Estimate(prod(shares), upper_bound(shares, trials), tuple(levels), simulations, worst)


def next_level(leaves: Sequence[Leaf]) -> tuple[float, list[Leaf]]:
    """The score that one in KEPT_OF comes below, and those that do: none where the best ones are equal."""
    level = sorted(leaf.score for leaf in leaves)[len(leaves) // KEPT_OF]
    return level, [leaf for leaf in leaves if leaf.score < level]


def _branchings(kept: Sequence[Leaf], count: int, level: float, name: str, random: Random) -> list[Branching]:
    """So many branches of the kept ones, as many of each; chance decides which have one more."""
    order = random.sample(range(len(kept)), len(kept))
    seeds = [tuple(f"{name}.{index}" for index in range(place, count, len(kept))) for place in range(len(kept))]
    return [Branching(kept[one].seeds, level, own) for one, own in zip(order, seeds, strict=True) if own]


def upper_bound(shares: Sequence[float], trials: Sequence[int]) -> float:
    """Of the product of these shares, each of so many independent trials: only the kept simulations count as such.

    The shares are taken as independent. Where the last one is 0, it is bounded as Clopper and Pearson do, and those before with
    the other half of the error probability.
    """
    error, quantile = 1.0 - CONFIDENCE, NormalDist().inv_cdf
    logarithm = variance = 0.0
    for share, count in zip(shares, trials, strict=False):
        if share == 0.0:
            logarithm += log(1.0 - exp(log(0.5 * error) / count))
            return min(1.0, exp(logarithm + quantile(1.0 - 0.5 * error) * sqrt(variance)))
        logarithm += log(share)
        variance += (1.0 - share) / (share * count)
    return min(1.0, exp(logarithm + quantile(CONFIDENCE) * sqrt(variance)))
