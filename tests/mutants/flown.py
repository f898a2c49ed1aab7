"""`make mutants-flown`: flies fleets whose filter is wrong, with the last check and without it.

The filter is switched off, or is one of the mutants that the last run of `make mutants` left (those of equivalent.txt
included), or any of its mutants, most of which the tests notice. Of each the smallest distance of two cooperating vehicles is
measured, in units of `separation_m`. Prints a table; exit code 1 where a pair came nearer than HALF behind the check.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from itertools import combinations, count, islice
from multiprocessing import get_context
from os import cpu_count
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from tests.mutants.__main__ import SURVIVED, listed
from tests.mutants.mutate import Mutant, mutants_of
from tests.mutants.trial import Changed, forget_imports

FILTER = Path("companion/core/filter")
HALF = 0.5  # of separation_m
FAMILIES = ("exchange", "form_crossing", "formation_change")  # of the gauntlet, with ideal sensors
FLIGHTS_OFF = 10  # of each family with the filter switched off; of a mutant one
SEED, MOST_VEHICLES = 1, 6
MOST_CPU_S = 100.0
OFF, LEFT, ANY = "switched off", "mutants that the tests leave", "any mutants"


Place = tuple[str, int]
"""A family, and which of its small flights."""


@dataclass(frozen=True)
class Wrong:
    """A filter that is wrong: a mutant, or none where it is switched off."""

    group: str
    mutant: Mutant | None


@dataclass(frozen=True)
class Result:
    """The smallest ratio of one flight, infinite where it did not end; `acted`: whether the check did."""

    wrong: Wrong
    place: Place
    checked: bool
    ratio: float
    acted: bool


def fly(wrong: Wrong, place: Place, checked: bool) -> Result:
    """Run in a process of its own: the mutant has to be there when the modules are imported.

    A flight that raises, or takes too long, has no ratio: its agent would have failed.
    """
    signal.signal(signal.SIGVTALRM, _ends)
    signal.setitimer(signal.ITIMER_VIRTUAL, MOST_CPU_S)
    forget_imports()
    if wrong.mutant:
        sys.meta_path.insert(0, Changed(wrong.mutant))
    from companion.core.filter.filter import NOTHING_SEEN, Filtered, SafetyFilter
    from companion.core.safety.assurance import CommandMonitor
    from companion.types.notices import Code
    from sitl.flight.virtual_flight import JobProgress, fly_without_landing

    if not wrong.mutant:
        SafetyFilter.step = lambda *given: Filtered(given[6], NOTHING_SEEN)  # type: ignore[method-assign]
    if not checked:
        CommandMonitor.acceleration = lambda *given: given[4]  # type: ignore[method-assign]
    scenario = scenario_of(*place)
    try:
        flight = fly_without_landing(scenario, JobProgress(60.0))
    except Exception:  # noqa: BLE001 -- of a mutant anything
        return Result(wrong, place, checked, np.inf, acted=False)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    statuses = [status for i in flight.watch.vehicle_ids if (status := flight.watch.status(i))]
    acted = any(str(Code.COMMAND_BRAKED) in status.rejected for status in statuses)
    return Result(wrong, place, checked, smallest_ratio(scenario, flight), acted)


def _ends(*_: object) -> None:
    raise TimeoutError


def scenario_of(family: str, place: int) -> Any:
    """The small flight of this family without a runaway that has this place among them."""
    from sitl.gauntlet.drawing import draw_flight, family_of

    flights = (draw_flight(SEED, number, "ideal") for number in count() if family_of(number) == family)
    small = (
        each.scenario for each in flights if each.runaway is None and len(each.scenario.fleet.vehicles) <= MOST_VEHICLES
    )
    return next(islice(small, place, None))


def smallest_ratio(scenario: Any, flight: Any) -> float:
    """Of two vehicles while agents command both."""
    least_m = np.inf
    for one, other in combinations(flight.stand_ins, 2):
        both = one.commanded() & other.commanded()
        apart_m = np.linalg.norm(one.track().position_enu_m - other.track().position_enu_m, axis=1)
        least_m = min(least_m, apart_m[both].min(initial=np.inf))
    return float(least_m) / float(scenario.fleet.separation_m)


def drawn_mutants(most: int, seed: int) -> list[Wrong]:
    """As many of those that the last run left and of all, and the filter switched off."""
    mutants = [mutant for path in sorted(FILTER.glob("[a-z]*.py")) for mutant in mutants_of(path)]
    survived = (
        {tuple(line.split("\t")) for line in SURVIVED.read_text(encoding="utf-8").splitlines()}
        if SURVIVED.exists()
        else set()
    )
    left = [mutant for mutant in mutants if mutant.key in survived or mutant.key in listed()]
    random = Random(seed)
    groups = ((LEFT, random.sample(left, min(most, len(left)))), (ANY, random.sample(mutants, most)))
    return [Wrong(OFF, None), *(Wrong(group, mutant) for group, chosen in groups for mutant in chosen)]


def _places(wrong: Wrong) -> list[Place]:
    return [(family, place) for family in FAMILIES for place in range(1 if wrong.mutant else FLIGHTS_OFF)]


def results_of(wrongs: Sequence[Wrong], jobs: int) -> Iterator[Result]:
    """With the check, and where it acted without it: else that flight is the same one."""
    with ProcessPoolExecutor(jobs, get_context("spawn"), max_tasks_per_child=1) as pool:
        pending = {pool.submit(fly, wrong, place, True) for wrong in wrongs for place in _places(wrong)}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for result in (future.result() for future in done):
                yield result
                if result.acted and result.checked:
                    pending.add(pool.submit(fly, result.wrong, result.place, False))


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutants.flown", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=30, metavar="N", help="mutants of each kind (default 30)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the draw (default 1)")
    parser.add_argument(
        "--jobs", type=int, default=cpu_count() or 1, metavar="N", help="processes (default: one per core)"
    )
    parsed = parser.parse_args()
    results: list[Result] = []
    for result in results_of(drawn_mutants(parsed.count, parsed.seed), parsed.jobs):
        results.append(result)
        if result.checked and result.ratio < HALF:
            print(*result.place, result.ratio, *(result.wrong.mutant.key if result.wrong.mutant else (OFF,)), sep="\t")
        print(f"\r{len(results)} flights ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return print_table(results)


def print_table(results: Sequence[Result]) -> int:
    """The exit code."""
    print("| filter | filters | flights | check acted | smallest ratio | below half | without check | below half |")
    print("|---|---|---|---|---|---|---|---|")
    for group in (OFF, LEFT, ANY):
        of_group = [result for result in results if result.wrong.group == group]
        checked = [result for result in of_group if result.checked]
        bare = [result for result in of_group if not (result.checked and result.acted)]
        filters, acted = len({result.wrong for result in checked}), sum(result.acted for result in checked)
        flown = sum(result.ratio < np.inf for result in checked)
        print(f"| {group} | {filters} | {flown} | {acted} | {_ratios(checked)} | {_ratios(bare)} |")
    return int(any(result.checked and result.ratio < HALF for result in results))


def _ratios(results: Sequence[Result]) -> str:
    ratios = [result.ratio for result in results]
    return f"{min(ratios, default=np.inf):.2f} | {sum(ratio < HALF for ratio in ratios)}"


if __name__ == "__main__":
    sys.exit(main())
