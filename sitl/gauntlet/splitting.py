"""Rare events by multilevel splitting: a simulation is split where its score first falls below a level, and weighs less.

A score below EVENT is the event. Without splitting, a probability of 1e-8 takes 1e8 simulations. With it, each that comes
below a level goes on as BRANCHES simulations with new random numbers, each with 1/BRANCHES of the weight: where one in BRANCHES
reaches the next level, as many simulations run at each level, and n levels see BRANCHES^-n with a few hundred. The sum of the
weights of the events over the number of first simulations has the probability as its mean, whatever the levels are. They only
decide the variance, so a pilot chooses them, two at a time: each is the quantile 1/BRANCHES of the scores below the one before
(adaptive multilevel splitting; Cerou and Guyader, Stochastic Analysis and Applications 25(2), 2007; here the levels are fixed).

A simulation is split by os.fork: its state is in the call stack and in hundreds of objects, and a copy of the process has all
of it. A branch flies on in the child, while the parent waits: one process computes at a time, and the order decides nothing.

A simulation that is on its way to the event passes level after level with all its branches, 4^12 of them. So one first
simulation is split MOST_SPLITS times at most. What passes a level after that goes on alone with its whole weight, which leaves
the mean as it is.
"""

from __future__ import annotations

import mmap
import os
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp, inf, log, sqrt
from statistics import NormalDist

import msgspec
from msgspec import Struct

EVENT = 1.0  # a score below it is the event
BRANCHES = 4
MOST_LEVELS = 12
MOST_SPLITS = 64  # of one first simulation; 3 are usual with so many levels
FEWEST = 12  # scores below a level, for the quantile of the next one
CONFIDENCE = 0.95


class Seed(Struct, frozen=True):
    """The random numbers of a simulation are those of this seed from `at_s` on, when it had passed so many levels."""

    at_s: float
    seed: str
    passed: int = 0


class Leaf(Struct, frozen=True):
    """A simulation that ended: how many levels it passed, its least score, and the seeds by which it runs again."""

    passed: int
    least: float
    seeds: tuple[Seed, ...]

    @property
    def weight(self) -> float:
        """It stands for so many simulations: one, divided by BRANCHES at each split."""
        return float(BRANCHES ** -(len(self.seeds) - 1))


class _Split(BaseException):
    """Ends a simulation whose branches have run."""


class Splitter:
    """Runs one simulation and its branches. The simulation calls `look` with its score as it goes on."""

    def __init__(self, levels: Sequence[float], seed: str, reseed: Callable[[str], None]) -> None:
        """`levels` fall, the last is EVENT; `reseed` gives the simulation new random numbers from a seed."""
        self._levels, self._reseed = levels, reseed
        self._seeds: tuple[Seed, ...] = (Seed(0.0, seed),)
        self._passed, self._least = 0, inf
        self._leaves: list[Leaf] = []
        self._splits = mmap.mmap(-1, 4)  # how many there were, shared with all branches
        self._out: int | None = None  # of a branch: the pipe to its parent

    def look(self, at_s: float, score: float) -> None:
        """At a point of a simulation: its score now. Does not return where it was split, or at the event."""
        if score < self._least:
            self._least = score
        if self._passed == len(self._levels) or score >= self._levels[self._passed]:
            return
        while self._passed < len(self._levels) and score < self._levels[self._passed]:
            self._passed += 1
        if self._passed == len(self._levels):
            self._leaves = [self._leaf()]
            raise _Split
        splits = int.from_bytes(self._splits[:], "big")
        if splits == MOST_SPLITS:
            return
        self._splits[:] = (splits + 1).to_bytes(4, "big")
        for branch in range(BRANCHES):
            if self._became_branch(at_s, f"{self._seeds[-1].seed}.{branch}"):
                return
        raise _Split

    def run(self, simulate: Callable[[], None]) -> list[Leaf]:
        """The leaves of the simulation. Returns in the first process alone. Raises what the simulation raised in it."""
        try:
            simulate()
            self._leaves = [self._leaf()]
        except _Split:
            pass
        except BaseException:
            if self._out is None:
                raise
            traceback.print_exc()
            os._exit(1)
        if self._out is None:
            return self._leaves
        content = msgspec.json.encode(self._leaves)
        while content:
            content = content[os.write(self._out, content) :]
        os._exit(0)

    def _became_branch(self, at_s: float, seed: str) -> bool:
        """In a new process True; in this one False, once that one has ended, with its leaves."""
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(ours)
            self._out, self._leaves = theirs, []
            self._seeds += (Seed(at_s, seed, self._passed),)
            self._reseed(seed)
            return True
        os.close(theirs)
        with os.fdopen(ours, "rb") as pipe:
            content = pipe.read()
        _, status = os.waitpid(child, 0)
        if status:
            raise RuntimeError(f"a branch of the simulation ended with {os.waitstatus_to_exitcode(status)}")
        self._leaves += msgspec.json.decode(content, type=list[Leaf])
        return False

    def _leaf(self) -> Leaf:
        return Leaf(self._passed, self._least, self._seeds)


def next_levels(leaves: Sequence[Leaf], levels: Sequence[float]) -> tuple[float, ...]:
    """The next levels of a pilot with these levels, up to two; EVENT is the last, also where too few come below the others.

    One in BRANCHES comes below the first of them, and one in BRANCHES of these below the second.
    """
    scores = sorted(leaf.least for leaf in leaves if leaf.passed == len(levels))
    if len(scores) < FEWEST or len(levels) >= MOST_LEVELS - 1:
        return (EVENT,)
    first, second = (max(scores[len(scores) // share], EVENT) for share in (BRANCHES, BRANCHES * BRANCHES))
    return (first, second) if first > second else (first,)


@dataclass(frozen=True, slots=True)
class Estimate:
    """The probability of the event in one simulation, with an upper bound of CONFIDENCE.

    `shares`: of the simulations that passed a level, the share that passed the next one. `simulations`: all, with branches.
    """

    probability: float
    upper: float
    shares: tuple[float, ...]
    simulations: int


def estimate(roots: Sequence[Sequence[Leaf]], levels: int) -> Estimate:
    """From the leaves of each first simulation. These are independent, the branches of one split are not quite.

    So the variance of a share is taken as if all branches of one split were one trial, and the levels are taken as independent.
    Where no simulation passed a level, its share is bounded as Clopper and Pearson do, and those before with the other half
    of the error probability.
    """
    leaves = [leaf for root in roots for leaf in root]
    weights = [sum(leaf.weight for leaf in leaves if leaf.passed >= level) for level in range(levels + 1)]
    trials = [len(roots), *(len(_passing(leaves, level)) for level in range(1, levels))]
    shares = tuple(after / before if before else 0.0 for before, after in pairwise(weights))
    return Estimate(weights[-1] / len(roots), _upper(shares, trials), shares, len(leaves))


def _passing(leaves: Sequence[Leaf], level: int) -> set[str]:
    """The seeds of the simulations that passed this level, as they were then."""
    return {[one for one in leaf.seeds if one.passed < level][-1].seed for leaf in leaves if leaf.passed >= level}


def _upper(shares: Sequence[float], trials: Sequence[int]) -> float:
    """The upper bound of the product of these shares, each of so many independent trials."""
    error = 1.0 - CONFIDENCE
    logarithm = variance = 0.0
    for share, count in zip(shares, trials, strict=False):
        if share == 0.0:
            last = 1.0 - (0.5 * error) ** (1.0 / count) if count else 1.0
            return min(1.0, last * exp(logarithm + NormalDist().inv_cdf(1.0 - 0.5 * error) * sqrt(variance)))
        logarithm += log(share)
        variance += (1.0 - share) / (share * count)
    return min(1.0, exp(logarithm + NormalDist().inv_cdf(CONFIDENCE) * sqrt(variance)))
