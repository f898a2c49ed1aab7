"""`sitl gauntlet --rare`: how probable it is in an hour that two vehicles in formation come too close, for named missions.

The event: two vehicles in formation are nearer, in truth, than `separation_m` less three sigmas of the pair, horizontal, as
their estimators report and their filters read. All missions have loss, delay, gusts and sensor noise. The method is that of
`splitting.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from math import hypot, inf
from pathlib import Path
from statistics import fmean

import msgspec
import yaml
from msgspec import Struct
from msgspec.structs import replace

from companion.geometry.vectors import dot, minus
from companion.types.errors import EXIT_DONE, EXIT_FAILED
from companion.types.flight import FlightPhase
from sitl.autopilots.autopilot import DT_S
from sitl.cluster import workers_of
from sitl.flight.director import Director
from sitl.flight.lockstep import TELEMETRY_STEPS, Lockstep
from sitl.flight.orders import FlightFailure
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.virtual_flight import collecting_seldom
from sitl.flight.watch import watch_of
from sitl.gauntlet.splitting import KEPT_OF, MOST_LEVELS, Branching, Estimate, Leaf, Seed, Splitter, estimate
from sitl.report.folder import Column, results_folder, table_text
from sitl.report.progress import FlightProgress, ShareProgress
from sitl.stopping import StopNow, StopRequest
from sitl.vehicle.config import Reseed
from sitl.workers import POLL_S, Workers

SIGMAS = 3.0
AHEAD_S = 0.6  # branches begin where vehicles approach: beside the smallest distance they would differ by millimetres
GOAL_1_H = 1e-6  # upper bound of the probability per hour
SEEDS_APART = 1_000_000  # those of two seeds of the command have no flight in common
FORMATION = FlightPhase.FORMATION
DISTURBED = (
    "stand_in.sensors=default",
    "stand_in.wind={mean_enu_m_s: [3.0, 1.0, 0.0], gust_sd_m_s: 1.0}",
    "links={peer_delay_s: 0.03, peer_jitter_s: 0.03, peer_loss: 0.1}",
)
START = "{command: prepare}, {command: arm}, {command: takeoff, for_s: 3.0}"
MISSIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "platoon": ("platoon", (f"timeline=[{START}, {{command: form, for_s: 40.0}}]",)),
    "exchange": ("exchange", ()),
    "joining": ("leaving", ()),
    "leader_lost": (
        "leaving",
        (
            f"timeline=[{START}, {{command: form, may_fail: true, for_s: 30.0}}]",
            "agent_ends=[{vehicle: 1, at_s: 22.0, restarts_after_s: 4.0}]",
        ),
    ),
}
"""Shipped scenarios by name, and what differs from them."""


def mission(name: str, seed: int) -> Scenario:
    """A named mission with its disturbances, without its landing."""
    shipped, overrides = MISSIONS[name]
    scenario = load_scenario(Path(shipped), (*DISTURBED, *overrides, f"stand_in.seed={seed}"))
    last = len(scenario.timeline) - 1
    while scenario.timeline[last].command in ("hold", "land"):
        last -= 1
    return replace(scenario, timeline=scenario.timeline[: last + 1])


class RareJob(Struct, frozen=True):
    """A flight of a mission by its seeds, with its branches. The first seed is that of its stand-ins."""

    mission: str
    branching: Branching


class WatchedLockstep(Lockstep):
    """A fleet whose distances are given to a splitter at 50 Hz. `formation_s`: how long two were in formation."""

    def __init__(self, scenario: Scenario, branching: Branching) -> None:
        super().__init__(scenario)
        self.splitter = Splitter(branching, self.reseed)
        self.formation_s = 0.0
        self._separation_m = scenario.fleet.separation_m

    def _step(self) -> None:
        super()._step()
        if self._steps % TELEMETRY_STEPS == 0:
            least, soon = self._least_shares()
            self.formation_s += TELEMETRY_STEPS * DT_S if least < inf else 0.0
            self.splitter.look(self._now_s, soon, least)

    def _least_shares(self) -> tuple[float, float]:
        """The smallest distance of two vehicles in formation as a share of what the event allows, now and after AHEAD_S.

        Infinite without two.
        """
        least = soon = inf
        flying = [
            (status.motion.position_error.horizontal_m, stand_in.autopilot.quad)
            for stand_in, vehicle in zip(self.stand_ins, self.in_order, strict=True)
            if vehicle.agent.phase is FORMATION and (status := vehicle.status) and status.motion.position_error
        ]
        for (one_m, one), (other_m, other) in combinations(flying, 2):
            required_m = self._separation_m - SIGMAS * hypot(one_m, other_m)
            if required_m > 0.0:
                apart_m = minus(one.position_enu_m, other.position_enu_m)
                distance_m = hypot(*apart_m)
                velocity_m_s = minus(one.velocity_enu_m_s, other.velocity_enu_m_s)
                closing_m_s = max(0.0, -dot(apart_m, velocity_m_s) / distance_m)
                least = min(least, distance_m / required_m)
                soon = min(soon, (distance_m - AHEAD_S * closing_m_s) / required_m)
        return least, soon


class RareFlight(Struct, frozen=True):
    """What became of a flight or its branches; `formation_s` of the flight, up to its end or its branches."""

    leaves: list[Leaf]
    formation_s: float


def fly_rare(job: RareJob) -> RareFlight:
    """Fly a mission with these random numbers, up to its end or its branches."""
    seeds = job.branching.seeds
    return fly_split(reseeded(mission(job.mission, int(seeds[0].seed)), seeds), job.branching)


def fly_split(scenario: Scenario, branching: Branching) -> RareFlight:
    """Fly a scenario, which has these seeds, up to its end or its branches."""
    fleet = WatchedLockstep(scenario, branching)
    director = Director(
        fleet, watch_of(scenario, fleet.now_s()), FlightProgress("", True, 0.0), lambda: None, tuple, fleet
    )

    def fly() -> None:
        with suppress(FlightFailure):  # the flight ends there: its distances until then count
            director.fly(scenario.timeline)

    with collecting_seldom():
        leaves = fleet.splitter.run(fly)
    return RareFlight(leaves, round(fleet.formation_s, 3))


@dataclass(frozen=True, slots=True)
class Probability:
    """Of one mission: the estimate for one flight, and the hours in formation of one."""

    mission: str
    found: Estimate
    hours: float

    @property
    def per_hour(self) -> tuple[float, float]:
        """Probability and upper bound per hour in formation."""
        return self.found.probability / self.hours, self.found.upper / self.hours


def run_rare(arguments: argparse.Namespace, missions: Sequence[str]) -> int:
    """Estimate all missions, print the table and write the worst flight of each; returns the exit code."""
    with (
        StopRequest("stopped at once; nothing was written") as stop,
        ShareProgress(arguments.quiet) as progress,
        workers_of(arguments.cluster, arguments.jobs) as workers,
    ):
        flights = Flights(workers, progress, stop, arguments.seed)
        probabilities = [flights.estimated(name, arguments.flights) for name in missions]
    folder = results_folder(arguments.out, "gauntlet-rare")
    print(f"{table_text(COLUMNS, map(_row, probabilities))}\n\n{MEANING}\n")
    for estimated in probabilities:
        print(_written(folder, estimated, arguments.seed))
    return EXIT_DONE if all(estimated.per_hour[1] <= GOAL_1_H for estimated in probabilities) else EXIT_FAILED


class Flights:
    """Flies missions on all cores, each with random numbers of its own."""

    def __init__(self, workers: Workers, progress: ShareProgress, stop: StopRequest, seed: int) -> None:
        self._workers, self._progress, self._stop, self._next_seed = workers, progress, stop, seed * SEEDS_APART

    def estimated(self, name: str, count: int) -> Probability:
        """By stages of `count` flights."""
        whole_s: list[float] = []
        stages = 0

        def fly(branchings: Sequence[Branching]) -> list[Leaf]:
            nonlocal stages
            flown = self._fly(name, branchings, f"{name}, {stages} levels of at most {MOST_LEVELS}")
            stages += 1
            whole_s.extend(
                flight.formation_s for flight, one in zip(flown, branchings, strict=True) if not one.branches
            )
            return [leaf for flight in flown for leaf in flight.leaves]

        found = estimate(fly, count, self._next_seed)
        self._next_seed += count
        return Probability(name, found, fmean(whole_s) / 3600.0)

    def _fly(self, name: str, branchings: Sequence[Branching], stage: str) -> list[RareFlight]:
        jobs = [RareJob(name, branching) for branching in branchings]
        self._progress.begin(stage)
        with self._workers.running(fly_rare, jobs) as in_progress:
            while not in_progress.wait(POLL_S):
                self._progress.show(in_progress.share_done)
                if self._stop.number:
                    raise StopNow("stopped; nothing was written", self._stop.exit_code)
            return in_progress.results()


COLUMNS: tuple[Column, ...] = (
    ("mission", "", -12),
    ("", "levels", 7),
    ("", "flights", 8),
    ("least", "share", 7),
    ("probability", "per flight", 12),
    ("per hour in", "formation", 12),
    ("upper", "95 %", 9),
)
MEANING = f"""\
The event: two vehicles in formation nearer than separation_m less {SIGMAS:g} sigmas of the pair. least share: the smallest
distance of all flights as a share of that; levels: each is passed by one in {KEPT_OF}, at most {MOST_LEVELS}; flights: with
all branches, each of which flies on from its level; upper 95 %: per hour"""


def _row(estimated: Probability) -> tuple[str, ...]:
    per_hour, upper = estimated.per_hour
    found = estimated.found
    return (
        estimated.mission,
        str(len(found.levels)),
        str(found.simulations),
        f"{found.worst.least:.2f}",
        *(f"{value:.1e}" if value else "0" for value in (found.probability, per_hour, upper)),
    )


def reseeded(scenario: Scenario, seeds: Sequence[Seed]) -> Scenario:
    """The scenario with the random numbers of these seeds, the first of which is that of its stand-ins."""
    reseeds = tuple(Reseed(at_s=one.at_s, seed=one.seed) for one in seeds[1:])
    return replace(scenario, stand_in=replace(scenario.stand_in, reseeds=reseeds))


def _written(folder: Path, estimated: Probability, seed: int) -> str:
    """Write the worst flight as a scenario file, and return its line."""
    worst = estimated.found.worst
    scenario = reseeded(mission(estimated.mission, int(worst.seeds[0].seed)), worst.seeds)
    path = folder / f"{estimated.mission}.yaml"
    line = f"{estimated.mission}, seed {seed}: two vehicles at {worst.least:.3f} of the distance of the event"
    path.write_text(f"# {line}\n{yaml.safe_dump(msgspec.to_builtins(scenario), sort_keys=False)}", encoding="utf-8")
    return f"{line}: sitl run {path}"
