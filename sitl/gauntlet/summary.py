"""Statistics of the flights of each family, as data and as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from sitl.gauntlet.flight import FlightOutcome
from sitl.report.table import Column

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
