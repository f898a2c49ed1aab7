"""`sitl gauntlet --adversarial`: searches for the flights that come nearest to a violation, in place of drawing them at random.

Every draw of a family (sizes, times, links, pilots, settings, wind) is a number from 0 to 1, so a flight is a point in a cube.
The search is the cross-entropy method with a kernel density: each generation is drawn round the worst flights so far, as wide
as these differ in each draw; a part of it is random. Each family is searched for itself, as its draws mean something of their
own. One seed gives the same search, on any number of processes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from random import Random
from statistics import pstdev

import msgspec
from msgspec import Struct

from companion.types.errors import UnusableError
from sitl.gauntlet.drawing import ONLY_SEARCHED, numbers_of
from sitl.gauntlet.fleets import SensorsName
from sitl.gauntlet.flight import INTRUSION_M, SENSOR_FACTOR, FlightOutcome, Job
from sitl.gauntlet.others import SPEED_MARGIN_M_S
from sitl.gauntlet.summary import fates

DRAWS = 128  # of a flight that are searched over; the few after them follow from the seed
POPULATION = 16  # flights of a family in a generation
ELITES = 5  # the worst flights of a family, from which the next generation is drawn
RANDOM_SHARE = 0.2  # of a generation after the first
CHANGED_SHARE = 0.4  # of the draws of a flight
LEAST_SPREAD, SPREAD = 0.02, 0.7  # of a changed draw; times the standard deviation among the worst
NOT_REACHED = 0.05  # a flight all of whose vehicles miss their slots counts as worse by so much
NO_PAIR, LEAD_TAKEN = 2.0, 0.0
STATE = "search.json"
SCHEMA = 1


class Point(Struct, frozen=True):
    """A flight of the search: its draws, its number, which names the family, and what came of it."""

    choices: tuple[float, ...]
    outcome: FlightOutcome

    @property
    def score(self) -> float:
        """At least 1 without a violation; the less, the worse."""
        return score_of(self.outcome)


class Search(Struct, kw_only=True):
    """The whole state of a search, content of search.json. `elites`: of each family, the worst first.

    `kept`: all flights with a violation or an exception, and those without liars in which the last check braked a vehicle.
    """

    schema: int = SCHEMA
    seed: int
    sensors: SensorsName | None
    families: tuple[str, ...]
    generation: int = 0
    elites: dict[str, list[Point]] = {}
    kept: list[Point] = []
    outcomes: list[FlightOutcome] = []

    @property
    def flights(self) -> int:
        return len(self.outcomes)

    @property
    def violations(self) -> int:
        return sum(map(is_violation, self.outcomes))

    def next_jobs(self) -> list[Job]:
        """The next generation of all families."""
        return [job for family in self.families for job in self._jobs_of(family)]

    def _jobs_of(self, family: str) -> list[Job]:
        random, elites = Random(f"{self.seed} {family} {self.generation} search"), self.elites.get(family, [])
        first = _numbers(family)
        jobs = []
        for index in range(POPULATION):
            if len(elites) < 2 or random.random() < RANDOM_SHARE:
                number, choices = first[index % len(first)], tuple(random.random() for _ in range(DRAWS))
            else:
                parent = random.choice(elites)
                number, choices = parent.outcome.number, _varied(random, parent.choices, elites)
            jobs.append(Job(self.seed, number, self.sensors, choices=choices))
        return jobs

    def take(self, jobs: Sequence[Job], outcomes: Sequence[FlightOutcome]) -> None:
        """The outcomes of a whole generation."""
        for job, outcome in zip(jobs, outcomes, strict=True):
            point, elites = Point(job.choices, outcome), self.elites.setdefault(outcome.family, [])
            elites.append(point)
            if is_violation(outcome) or (outcome.braked and not outcome.liars):
                self.kept.append(point)
        for elites in self.elites.values():
            elites.sort(key=lambda point: point.score)
            del elites[ELITES:]
        self.generation += 1
        self.outcomes += outcomes

    def worst(self, count: int) -> list[Point]:
        """Of all families, the worst first."""
        return sorted((one for elites in self.elites.values() for one in elites), key=lambda point: point.score)[:count]


def is_violation(outcome: FlightOutcome) -> bool:
    """A flight with a violation or an exception."""
    return outcome.violation or bool(outcome.exception)


def score_of(outcome: FlightOutcome) -> float:
    """The smallest distance as a share of what is allowed; below 1 it is a violation. 0: an exception; NO_PAIR: not flown."""
    if outcome.exception:
        return 0.0
    if not outcome.vehicles:
        return NO_PAIR
    score = NO_PAIR if outcome.ratio is None else outcome.ratio / SENSOR_FACTOR[outcome.sensors]
    if outcome.room is not None:
        score = min(score, 1.0 + outcome.room.distance_m + INTRUSION_M[outcome.sensors])
    if outcome.speed is not None:
        score = min(score, 1.0 + SPEED_MARGIN_M_S[outcome.sensors] - outcome.speed.over_m_s)
    if outcome.lead is not None:
        return LEAD_TAKEN
    ended = [fate.outcome for fate in fates(outcome)]
    return score - (
        NOT_REACHED * ended.count("not reached") / len(ended) if ended and score > 1.0 + NOT_REACHED else 0.0
    )


def _numbers(family: str) -> Sequence[int]:
    """Ten flights of a family, one of which has a runaway vehicle."""
    if first := ONLY_SEARCHED.get(family):
        return range(first, first + 10)
    numbers = numbers_of((family,))
    return [next(numbers) for _ in range(10)]


def _varied(random: Random, choices: Sequence[float], elites: Sequence[Point]) -> tuple[float, ...]:
    """Some of the draws changed, as far as those of the worst flights differ; reflected into 0 to 1."""
    varied = []
    for index, choice in enumerate(choices):
        if random.random() < CHANGED_SHARE:
            spread = max(LEAST_SPREAD, SPREAD * pstdev(one.choices[index] for one in elites))
            choice = abs(random.gauss(choice, spread)) % 2.0
            choice = min(choice if choice < 1.0 else 2.0 - choice, 1.0 - 1e-12)
        varied.append(choice)
    return tuple(varied)


def read_search(folder: Path) -> Search:
    """The state of a search that was stopped. Raises UnusableError."""
    file = folder / STATE
    try:
        search = msgspec.json.decode(file.read_bytes(), type=Search)
    except (OSError, msgspec.DecodeError) as error:
        raise UnusableError(f"--resume: {file}: expected the state of a search ({error})") from error
    if search.schema != SCHEMA:
        raise UnusableError(f"--resume: {file}: schema: {search.schema}, expected {SCHEMA}")
    return search


def write_search(folder: Path, search: Search) -> None:
    """Replace the state as a whole: a stop in between leaves the one before."""
    part = folder / f"{STATE}.part"
    part.write_bytes(msgspec.json.encode(search))
    part.replace(folder / STATE)
