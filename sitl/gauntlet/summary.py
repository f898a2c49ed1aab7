"""Statistics of the flights of each family as data, as a table and as a page, and the worst flights as scenario files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path

import msgspec
import numpy as np
import yaml
from msgspec import Struct

from companion.config.fleet import FleetConfig
from sitl.gauntlet.drawing import draw_flight
from sitl.gauntlet.families import RESTARTS_AFTER_S, STAYS_DEAD
from sitl.gauntlet.faults import ALL_FAMILIES
from sitl.gauntlet.fleets import SensorsName
from sitl.gauntlet.flight import SENSOR_FACTOR, FlightOutcome
from sitl.report.folder import Column

KEPT = 10  # of the worst flights
PAGE_FILE = Path(__file__).with_name("page.md")
IN_TIME = 2.0  # times the undisturbed time
GRACE_S = 1.0  # more than that, for slots that are near
ALREADY_THERE_S = 1.0  # who takes less undisturbed was in its slot from the beginning: no time to compare


class FamilySummary(Struct, frozen=True, kw_only=True):
    """Statistics of one family. Ratios are true distances in units of `separation_m`; None without a pair that counts.

    `expected` vehicles were to be in their slots at the end: `reached` were, `refused` had refused a command, `left` were not
    in formation. `timed` of all have an undisturbed time and refused nothing, and `in_time` reached their slots in at most
    twice that. In `braked` flights the last check of commands braked a vehicle.
    """

    family: str
    flights: int
    runaways: int
    violations: int
    worst: float | None
    percent_1: float | None
    percent_10: float | None
    median: float | None
    automatic: float | None
    expected: int
    refused: int
    left: int
    reached: int
    timed: int
    in_time: int
    braked: int
    not_flown: int
    exceptions: int


def summarize(outcomes: Sequence[FlightOutcome]) -> list[FamilySummary]:
    """One summary per family in the order of the first flight, and one of all flights."""
    families: dict[str, list[FlightOutcome]] = {}
    for outcome in outcomes:
        families.setdefault(outcome.family, []).append(outcome)
    return [*(_summary(name, own) for name, own in families.items()), _summary("all", outcomes)]


def _summary(family: str, outcomes: Sequence[FlightOutcome]) -> FamilySummary:
    ratios = [o.ratio for o in outcomes if o.ratio is not None]
    automatic = [
        o.distances.automatic.distance_m / o.separation_m for o in outcomes if o.distances and o.distances.automatic
    ]
    vehicles = [fate for outcome in outcomes for fate in fates(outcome)]
    ended = [fate.outcome for fate in vehicles]
    timed = [fate.in_time for fate in vehicles if fate.in_time is not None]
    return FamilySummary(
        family=family,
        flights=len(outcomes),
        runaways=sum(o.runaway is not None for o in outcomes),
        violations=sum(o.violation for o in outcomes),
        worst=round(min(ratios), 3) if ratios else None,
        percent_1=_percentile(ratios, 1.0),
        percent_10=_percentile(ratios, 10.0),
        median=_percentile(ratios, 50.0),
        automatic=round(min(automatic), 3) if automatic else None,
        expected=len(vehicles),
        refused=ended.count("refused"),
        left=ended.count("left"),
        reached=ended.count("reached"),
        timed=len(timed),
        in_time=sum(timed),
        braked=sum(bool(o.braked) for o in outcomes),
        not_flown=sum(o.vehicles == 0 for o in outcomes),
        exceptions=sum(bool(o.exception) for o in outcomes),
    )


class Fate(Struct, frozen=True):
    """What became of a vehicle that was to reach its slot: "refused", "left", "reached" or "not reached".

    `in_time`: None where its time is not compared: without an undisturbed time, where it was in its slot all the time, or
    where it refused a command.
    """

    outcome: str
    in_time: bool | None


def fates(outcome: FlightOutcome) -> list[Fate]:
    """One of each vehicle. A vehicle that refused a command and is in a slot nevertheless has reached it."""
    if outcome.arrivals is None:
        return []
    refused = {refusal.vehicle for refusal in outcome.refusals}
    left = outcome.arrivals.not_in_formation
    reached_s = dict.fromkeys(left) | outcome.arrivals.reached_s
    found = []
    for vehicle_id, in_s in reached_s.items():
        undisturbed_s = outcome.undisturbed_s.get(vehicle_id)
        if vehicle_id in refused or undisturbed_s is None or undisturbed_s < ALREADY_THERE_S:
            in_time = None
        else:
            in_time = in_s is not None and in_s <= IN_TIME * undisturbed_s + GRACE_S
        if in_s is not None:
            found.append(Fate("reached", in_time))
        elif vehicle_id in refused:
            found.append(Fate("refused", None))
        else:
            found.append(Fate("left" if vehicle_id in left else "not reached", in_time))
    return found


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return round(float(np.percentile(values, percent)), 3) if values else None


def cells(summary: FamilySummary) -> tuple[str, ...]:
    """A row of the table."""
    return tuple(cell(summary) for _, cell in TABLE)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


TABLE: tuple[tuple[Column, Callable[[FamilySummary], str]], ...] = (
    (("family", "", -20), lambda s: s.family),
    (("", "flights", 8), lambda s: str(s.flights)),
    (("with", "runaway", 9), lambda s: str(s.runaways)),
    (("viola-", "tions", 7), lambda s: str(s.violations)),
    (("worst", "ratio", 7), lambda s: _number(s.worst)),
    (("", "1 %", 7), lambda s: _number(s.percent_1)),
    (("", "10 %", 7), lambda s: _number(s.percent_10)),
    (("", "median", 8), lambda s: _number(s.median)),
    (("auto-", "matic", 7), lambda s: _number(s.automatic)),
    (("vehicles", "to slots", 10), lambda s: str(s.expected)),
    (("", "refused", 9), lambda s: str(s.refused)),
    (("", "left", 6), lambda s: str(s.left)),
    (("", "reached", 9), lambda s: str(s.reached)),
    (("in", "time", 8), lambda s: f"{100.0 * s.in_time / s.timed:.1f} %" if s.timed else "-"),
    (("last", "check", 7), lambda s: str(s.braked)),
    (("excep-", "tions", 8), lambda s: str(s.exceptions)),
)
COLUMNS = tuple(column for column, _ in TABLE)
MEANING = f"""\
ratio: smallest true distance of a flight in units of separation_m, of pairs where an agent commands at least one vehicle: the
worst flight and percentiles; automatic: the worst of the other pairs, which both fly by autopilots or pilots; violations:
flights with a ratio below 1 (sensors ideal), 0.8 (default) or 0.6 (px4_sih), or a vehicle beyond a wall; vehicles to slots:
that were to be in their slots at the end; refused: those that were not, and had refused a command; left: no longer in
formation; reached: in their slots; last check: flights in which it braked a vehicle; in time: share of those that flew to
their slots in an undisturbed flight and refused nothing, which took at most {IN_TIME:g} times as long as there, plus
{GRACE_S:g} s; those that left or did not reach them are not in time"""


def page(seed: int, families: Sequence[FamilySummary], outcomes: Sequence[FlightOutcome]) -> str:
    """The whole page as Markdown: `page.md` with the figures in it."""
    first_s, last_s = RESTARTS_AFTER_S
    return PAGE_FILE.read_text(encoding="utf-8").format(
        flights=len(outcomes),
        seed=seed,
        vehicles=_vehicles(outcomes),
        table="\n".join(_table(families)),
        in_time=IN_TIME,
        grace_s=GRACE_S,
        first_s=first_s,
        last_s=last_s,
        dead_percent=100 * STAYS_DEAD,
        families="\n".join(
            f"| `{name}` | {_first_sentence(family.__doc__)} |" for name, family in ALL_FAMILIES.items()
        ),
    )


def _vehicles(outcomes: Sequence[FlightOutcome]) -> str:
    sizes = [outcome.vehicles for outcome in outcomes if outcome.vehicles]
    return f"{min(sizes)} to {max(sizes)} vehicles each" if sizes else "none of them possible"


def _table(families: Sequence[FamilySummary]) -> list[str]:
    head = "| " + " | ".join(" ".join(filter(None, (a, b))).replace("- ", "") for a, b, _ in COLUMNS) + " |"
    rows = ["| " + " | ".join(cells(family)) + " |" for family in families]
    return [head, "|" + "---|" * len(COLUMNS), *rows]


def _first_sentence(text: str | None) -> str:
    return " ".join((text or "").split()).split(". ")[0].rstrip(".")


def write_worst(
    folder: Path, outcomes: Sequence[FlightOutcome], sensors: SensorsName | None, own: FleetConfig | None
) -> list[str]:
    """Write a scenario file for each of the KEPT flights nearest to a violation, and those with an exception.

    Returns a line for each of them.
    """
    lines = []
    for outcome in worst_of(outcomes):
        scenario = draw_flight(outcome.seed, outcome.number, sensors, own).scenario
        path = folder / f"{outcome.family}_{outcome.number}.yaml"
        content = yaml.safe_dump(msgspec.to_builtins(scenario), sort_keys=False)
        path.write_text(f"# {line_of(outcome)}\n{content}", encoding="utf-8")
        if outcome.exception:
            path.with_suffix(".txt").write_text(outcome.exception, encoding="utf-8")
        lines.append(f"{line_of(outcome)}: sitl run {path}")
    return lines


def worst_of(outcomes: Sequence[FlightOutcome]) -> list[FlightOutcome]:
    """Flights with an exception first, then those with the smallest ratio for their sensors."""
    failed = [outcome for outcome in outcomes if outcome.exception]
    shares = [(o.ratio / SENSOR_FACTOR[o.sensors], o) for o in outcomes if o.ratio is not None]
    return [*failed, *(outcome for _, outcome in sorted(shares, key=itemgetter(0)))][:KEPT]


def line_of(outcome: FlightOutcome) -> str:
    """The flight, and what was worst in it."""
    name = f"flight {outcome.number}, {outcome.family}, {outcome.law}, {outcome.autopilot}, {outcome.sensors}"
    if outcome.exception:
        return f"{name}: exception {outcome.exception.strip().splitlines()[-1]}"
    closest = outcome.distances.commanded if outcome.distances else None
    if closest is None:
        return name
    return (
        f"{name}: vehicles {closest.vehicles[0]} and {closest.vehicles[1]} {closest.distance_m:.2f} m apart at"
        f" {closest.time_s:.1f} s, separation_m {outcome.separation_m:g}"
    )
