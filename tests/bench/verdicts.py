"""`make verdicts`: what `companion analyze` says of random formations and settings, against their flights in virtual time.

Formations are drawn as in the gauntlet, with gains and weights of every law, ideal sensors and links of 0.1 s. Each forms from
rest and flies on for FLOWN_S. Exit code 1 where an accepted one swings.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from msgspec import Struct

from companion.analysis.interaction import FloatArray
from companion.analysis.prediction import settle_time_s
from companion.cli.options import whole_number
from companion.config.file import ConfigError
from companion.config.law import LawName
from companion.ground.changes import assign_slots
from companion.tools.analysis import LAW_NAMES, analyse
from companion.tools.subject import subject_of
from sitl.flight.scenario import Scenario, scenario_from
from sitl.flight.virtual_flight import fly_without_landing
from sitl.gauntlet.fleets import START_SPACING, direction, moved, random_fleet, scattered, sections, to_thousandth
from sitl.report.progress import FlightProgress
from sitl.workers import LocalWorkers

SEED, FLIGHTS = 3, 200
LINK_S = 0.1
FLOWN_S = 30.0
STEP_S = 0.02
SWINGS_M, SHRINKS = 0.1, 0.8
RATIO, APART_M = 1.5, 0.15
ABOUT_S = 0.3  # added to both settling times: of a vehicle that begins near its slot a tick counts otherwise


def draw(seed: int, number: int, flown_s: float = FLOWN_S) -> tuple[Scenario, dict[str, Any]]:
    """A formation that forms, and the content of its scenario file."""
    random = Random(f"{seed} {number} verdicts")
    while True:
        fleet = random_fleet(random, "ideal")
        if fleet.size > 8 and random.random() < 0.6:
            continue  # the time of a flight
        if random.random() < 0.33:
            starts = scattered(random, fleet.size, START_SPACING * fleet.separation_m)
            fleet.starts_enu_m = assign_slots(fleet.slots_enu_m, starts)
        else:
            away = direction(random, random.uniform(0.3, 2.0))
            fleet.starts_enu_m = {i: moved(start, away) for i, start in fleet.starts_enu_m.items()}
        content = sections(fleet, random)
        content["fleet"]["law"] = _law(random)
        content["reference"] = {"kind": "point", "point_enu_m": [0.0, 0.0, fleet.height_m]}
        content["links"] = {"peer_delay_s": LINK_S}
        content["timeline"] = [
            {"command": "prepare"},
            {"command": "arm"},
            {"command": "takeoff", "for_s": 2.0},
            {"command": "form", "for_s": flown_s},
        ]
        try:
            return scenario_from(Path(f"verdict {number}"), content), content
        except ConfigError:
            continue  # vehicles refuse it


def _law(random: Random) -> dict[str, Any]:
    name = random.choice(LAW_NAMES)
    law: dict[str, float] = {}
    if random.random() < 0.7:
        law["position_gain_1_s2"] = to_thousandth(random.uniform(0.5, 5.0))
        law["velocity_gain_1_s"] = to_thousandth(random.uniform(0.6, 5.0))
    if name in ("weighted", "cooperative") and random.random() < 0.6:
        law["exponent"] = to_thousandth(random.uniform(0.0, 6.0))
        law["weight_ratio"] = to_thousandth(random.choice((1.0, random.uniform(0.01, 1.0))))
        law["feedforward"] = to_thousandth(random.choice((0.0, random.uniform(0.0, 0.99))))
    return {"name": name, "parameters": law}


class Verdict(Struct, frozen=True, kw_only=True):
    """What was said of one setting, and what its flight was. `flown_settle_s` is None where it has not settled in time."""

    number: int
    flown_s: float
    law: LawName
    accepted: bool
    swings: bool
    said_settle_s: float | None
    flown_settle_s: float | None
    said_nearest_m: float | None
    flown_nearest_m: float

    @property
    def flies_well(self) -> bool:
        return self.flown_settle_s is not None and not self.swings

    @property
    def ratio(self) -> float:
        """How many times longer one settling time is than the other; 1 where both are beyond the flight."""
        said_s, flown_s = (
            min(time_s or self.flown_s, self.flown_s) + ABOUT_S for time_s in (self.said_settle_s, self.flown_settle_s)
        )
        return max(said_s / flown_s, flown_s / said_s)

    @property
    def apart_m(self) -> float:
        return abs((self.said_nearest_m or 0.0) - self.flown_nearest_m)


def judge(seed: int, number: int, flown_s: float = FLOWN_S) -> Verdict:
    """Analyse and fly one setting."""
    scenario, content = draw(seed, number, flown_s)
    subject = subject_of(Path(f"verdict {number}"), content)
    analysis = analyse(subject)
    said = analysis.laws.get(analysis.law)
    errors_m, nearest_m = flown_figures(scenario)
    times_s = np.arange(len(errors_m), dtype=np.float64) * STEP_S
    return Verdict(
        number=number,
        flown_s=flown_s,
        law=analysis.law,
        accepted=analysis.converges,
        swings=bool(errors_m.size) and _swings(errors_m),
        said_settle_s=said.predicted_settle_s if said else None,
        flown_settle_s=settle_time_s(times_s, errors_m) if errors_m.size else None,
        said_nearest_m=said.predicted_smallest_distance_m if said else None,
        flown_nearest_m=nearest_m,
    )


def flown_figures(scenario: Scenario) -> tuple[FloatArray, float]:
    """The largest error of any vehicle over time in formation, none where `form` fails, and the least distance of any two."""
    flown = fly_without_landing(scenario, FlightProgress("verdicts", True, 0.0))
    formation, tracks = flown.watch.formation, flown.tracks()
    if formation is None:
        return np.empty(0), 0.0
    times_s = np.arange(formation.start_s, formation.end_s, STEP_S)
    positions_m = {i: track.at(times_s) for i, track in tracks.items()}
    slots = {member.id: np.array(member.slot_enu_m) for member in scenario.fleet.vehicles}
    reference_m = np.array(scenario.reference.start_enu_m)
    off_m = [np.linalg.norm(positions_m[i] - reference_m - slots[i], axis=1) for i in slots]
    pairs = combinations(positions_m.values(), 2)
    return np.max(off_m, axis=0), float(min(np.linalg.norm(one - other, axis=1).min() for one, other in pairs))


def _swings(errors_m: FloatArray) -> bool:
    """Whether the error of the last quarter is large, and hardly smaller than that of the quarter before."""
    quarter = len(errors_m) // 4
    last_m, before_m = float(errors_m[-quarter:].max()), float(errors_m[-2 * quarter : -quarter].max())
    return last_m > SWINGS_M and last_m > SHRINKS * before_m


HEAD = (
    "| law | settings | accepted | of these swing | refused | of these fly well | settling within 1.5 | largest ratio"
    " | distance within 0.15 m | largest difference |"
)


def table(verdicts: Sequence[Verdict]) -> list[str]:
    """One row for each law, and one for all."""
    rows = [HEAD, "|" + "---|" * 10]
    for name in (*LAW_NAMES, "all"):
        of = [one for one in verdicts if name in (one.law, "all")]
        accepted = [one for one in of if one.accepted]
        refused = [one for one in of if not one.accepted]
        cells = (
            name,
            len(of),
            len(accepted),
            sum(one.swings for one in accepted),
            len(refused),
            sum(one.flies_well for one in refused),
            sum(one.ratio <= RATIO for one in accepted),
            f"{max((one.ratio for one in accepted), default=1.0):.2f}",
            sum(one.apart_m <= APART_M for one in accepted),
            f"{max((one.apart_m for one in accepted), default=0.0):.2f} m",
        )
        rows.append("| " + " | ".join(map(str, cells)) + " |")
    return rows


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.verdicts", description=__doc__)
    parser.add_argument("--flights", type=whole_number(1, 10**6), default=FLIGHTS, metavar="N")
    parser.add_argument("--seed", type=whole_number(0, 10**9), default=SEED, metavar="N")
    parser.add_argument(
        "--jobs", type=whole_number(1, 1000), default=None, metavar="N", help="processes, one for each core"
    )
    parsed = parser.parse_args()
    jobs = [(parsed.seed, number) for number in range(parsed.flights)]
    with LocalWorkers(parsed.jobs).running(_judge, jobs) as running:
        verdicts = running.results()
    for one in verdicts:
        if (
            one.accepted and (one.swings or one.ratio > RATIO or one.apart_m > APART_M)
        ) or one.flies_well > one.accepted:
            print(one)
    print("\n".join(table(verdicts)))
    return 1 if any(one.accepted and one.swings for one in verdicts) else 0


def _judge(job: tuple[int, int]) -> Verdict:
    return judge(*job)


if __name__ == "__main__":
    sys.exit(main())
