"""Statistics of the flights of each family, as data and as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import yaml
from msgspec import Struct

from companion.config.fleet import FleetConfig
from sitl.gauntlet.families import FAMILIES, RESTARTS_AFTER_S, STAYS_DEAD
from sitl.gauntlet.fleets import SensorsName
from sitl.gauntlet.flight import SENSOR_FACTOR, FlightOutcome, drawn
from sitl.report.folder import Column

IN_TIME = 2.0  # times the undisturbed time
GRACE_S = 1.0  # more than that, for slots that are near
ALREADY_THERE_S = 1.0  # who takes less undisturbed was in its slot from the beginning: no time to compare


class FamilySummary(Struct, frozen=True, kw_only=True):
    """Statistics of one family. Ratios are true distances in units of `separation_m`; None without a pair that counts.

    `expected` vehicles were to be in their slots at the end: `reached` were, `refused` had refused a command, `left` were not
    in formation. `timed` of all have an undisturbed time and refused nothing, and `in_time` reached their slots in at most
    twice that.
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


COLUMNS: tuple[Column, ...] = (
    ("family", "", -20),
    ("", "flights", 8),
    ("with", "runaway", 9),
    ("viola-", "tions", 7),
    ("worst", "ratio", 7),
    ("", "1 %", 7),
    ("", "10 %", 7),
    ("", "median", 8),
    ("auto-", "matic", 7),
    ("vehicles", "to slots", 10),
    ("", "refused", 9),
    ("", "left", 6),
    ("", "reached", 9),
    ("in", "time", 8),
    ("excep-", "tions", 8),
)


def cells(s: FamilySummary) -> tuple[str, ...]:
    return (
        s.family,
        str(s.flights),
        str(s.runaways),
        str(s.violations),
        _number(s.worst),
        _number(s.percent_1),
        _number(s.percent_10),
        _number(s.median),
        _number(s.automatic),
        str(s.expected),
        str(s.refused),
        str(s.left),
        str(s.reached),
        f"{100.0 * s.in_time / s.timed:.1f} %" if s.timed else "-",
        str(s.exceptions),
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


MEANING = f"""\
ratio: smallest true distance of a flight in units of separation_m, of pairs where an agent commands at least one vehicle: the
worst flight and percentiles; automatic: the worst of the other pairs, which both fly by autopilots or pilots; violations:
flights with a ratio below 1 (sensors ideal), 0.8 (default) or 0.6 (px4_sih); vehicles to slots: that were to be in their slots
at the end; refused: those that were not, and had refused a command; left: no longer in formation; reached: in their slots; in
time: share of those that flew to their slots in an undisturbed flight and refused nothing, which took at most {IN_TIME:g} times
as long as there, plus {GRACE_S:g} s; those that left or did not reach them are not in time"""


def page(seed: int, families: Sequence[FamilySummary], outcomes: Sequence[FlightOutcome]) -> str:
    """The whole page as Markdown."""
    return "\n".join(
        [
            "# The gauntlet",
            "",
            f"<!-- written by `make gauntlet`: {len(outcomes)} flights with seed {seed} -->",
            "",
            INTRODUCTION,
            "",
            "## Measured",
            "",
            f"{len(outcomes)} flights with seed {seed}, {_vehicles(outcomes)}.",
            "",
            *_table(families),
            "",
            EXPLANATION,
            "",
            "## Families",
            "",
            "| family | what happens |",
            "|---|---|",
            *(f"| `{name}` | {_first_sentence(family.__doc__)} |" for name, family in FAMILIES.items()),
            "",
        ]
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


INTRODUCTION = """\
`sitl gauntlet` flies random flights of whole fleets in virtual time: the agents that fly for real,
on simulated quadrotors. Each flight draws its fleet (4 to 12 vehicles, shape, spacing,
`separation_m` from 1 to 2.5 m), the law (`weighted` or `cooperative`), the autopilot, the sensors,
the network (delay up to 0.1 s with up to 0.05 s jitter, loss up to 10 %), and what happens to it.
Every tenth flight has a runaway: a pilot takes over one vehicle and flies it straight on at up to
2 m/s. In a split network it begins while the others receive it: no vehicle can avoid another one
that begins to move unheard. The seed and the number of a flight give the same flight bit for bit.

```sh
sitl gauntlet --flights 100 --seed 7           # on all cores, some minutes
sitl gauntlet --families joining,hovering      # some families only
sitl gauntlet --fleet fleet.yaml               # your own fleet: its slots, law and limits
sitl run runs/gauntlet-DATE-TIME/FLIGHT.yaml   # one of the worst flights again, with its plot
```"""

FIRST_S, LAST_S = RESTARTS_AFTER_S
EXPLANATION = f"""\
- **Ratio**: the smallest true distance of a flight in units of `separation_m`, over all pairs where
  an agent commands the attitude of at least one vehicle. **Automatic** is the worst of all other
  pairs in the air, which both fly by their autopilots or pilots.
- **Violation**: a flight with a ratio below 1 with ideal sensors, 0.8 with `default`, 0.6 with
  `px4_sih`.
- **Vehicles to slots** were to be in their slots at the end. **Reached**: they were: neither the
  slot nor a reference that comes to rest moved any more, and they were within 0.5 m of the slot
  (1 m with `px4_sih`) for 2 s, by their own reports. **Refused**: they were not, and had refused a
  command of the flight, for example because the path was too near to another vehicle. **Left**: not
  in formation any more, by a failsafe.
- **In time**: of the vehicles that fly to their slots in the same flight undisturbed (ideal sensors
  and network, no runaway, no separation) and refused nothing, the share that took at most
  {IN_TIME:g} times as long, plus {GRACE_S:g} s. A vehicle that left or did not reach its slot is not in time.
  Vehicles that were in their slots all the time undisturbed are not counted. Every third flight is
  flown undisturbed as well.
- The undisturbed time is at least the duration of the change, of the path into the slot, or of the
  way of a reference to its place.
- In `leader_dies` a new agent starts {FIRST_S:g} to {LAST_S:g} s after the end, as systemd starts it on a vehicle.
  It observes and publishes its position, and the others make way. {100 * STAYS_DEAD:g} % of the PX4 stay without
  an agent: they brake and hold. No ArduCopter stays without one: it would level and drift, up to
  0.8 m/s with `px4_sih`, and no other vehicle would know where it is. That the filter cannot avoid."""


KEPT = 10


def write_worst(
    folder: Path, outcomes: Sequence[FlightOutcome], sensors: SensorsName | None, own: FleetConfig | None
) -> list[str]:
    """Write a scenario file for each of the KEPT flights nearest to a violation, and those with an exception.

    Returns a line for each of them.
    """
    lines = []
    for outcome in worst_of(outcomes):
        scenario = drawn(outcome.seed, outcome.number, sensors, own).scenario
        path = folder / f"{outcome.family}_{outcome.number}.yaml"
        content = yaml.safe_dump(msgspec.to_builtins(scenario), sort_keys=False)
        path.write_text(f"# {in_a_line(outcome)}\n{content}", encoding="utf-8")
        if outcome.exception:
            path.with_suffix(".txt").write_text(outcome.exception, encoding="utf-8")
        lines.append(f"{in_a_line(outcome)}: sitl run {path}")
    return lines


def worst_of(outcomes: Sequence[FlightOutcome]) -> list[FlightOutcome]:
    """Flights with an exception first, then those with the smallest ratio for their sensors."""
    failed = [outcome for outcome in outcomes if outcome.exception]
    ranked = sorted((o for o in outcomes if o.ratio is not None), key=_share_of_limit)
    return [*failed, *ranked][:KEPT]


def _share_of_limit(outcome: FlightOutcome) -> float:
    assert outcome.ratio is not None
    return outcome.ratio / SENSOR_FACTOR[outcome.sensors]


def in_a_line(outcome: FlightOutcome) -> str:
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
