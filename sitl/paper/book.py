"""All flights of a report with their figures, by subject, law and model; and text helpers for claims."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

from companion.config.fleet import LawName
from sitl.paper.flights import FlightSubject, FlownPlan, Model
from sitl.report.claim import ClaimVerdict
from sitl.report.metrics import FormationFigures, FormationFlight, formation_figures

PERFECT = (Model.IDEAL, Model.FULL)


class Entry:
    """One flight and its figures, computed once."""

    def __init__(self, flown: FlownPlan) -> None:
        self.flown = flown

    @cached_property
    def flight(self) -> FormationFlight:
        """Raises NoFormationError."""
        return self.flown.flight()

    @cached_property
    def figures(self) -> FormationFigures:
        """Raises NoFormationError."""
        flight = self.flight
        return formation_figures(flight.tracks, flight.slots, flight.reference, flight.formation)

    @property
    def settle_s(self) -> float:
        """Settle time; inf where the flight never settled."""
        settle_s = self.figures.settle_s
        return float("inf") if settle_s is None else settle_s


class Book:
    """All flights of a report."""

    def __init__(self, flown: Iterable[FlownPlan]) -> None:
        self._entries = [Entry(one) for one in flown]

    def all(self, subject: FlightSubject, law: LawName, model: Model) -> list[Entry]:
        """The flights with all seeds."""
        wanted = (subject, law, model)
        return [e for e in self._entries if (e.flown.plan.subject, e.flown.plan.law, e.flown.plan.model) == wanted]

    def one(self, subject: FlightSubject, law: LawName, model: Model) -> Entry:
        """The flight with the first seed. Raises LookupError."""
        found = self.all(subject, law, model)
        if not found:
            raise LookupError(f"nothing was flown of {subject}, {law}, {model}")
        return found[0]


def verdict_of(to_the_letter: bool, with_a_condition: bool = False) -> ClaimVerdict:
    """HOLDS where the claim holds to the letter, else CONDITION or FAILS by `with_a_condition`."""
    if to_the_letter:
        return ClaimVerdict.HOLDS
    return ClaimVerdict.CONDITION if with_a_condition else ClaimVerdict.FAILS


def seconds(value_s: float, digits: int = 1) -> str:
    return "never" if value_s == float("inf") else f"{value_s:.{digits}f} s"


def metres(values_m: Iterable[float], digits: int = 2) -> str:
    """ "1.75, 1.78 and 1.66 m"."""
    return listed(f"{value_m:.{digits}f}" for value_m in values_m) + " m"


def listed(parts: Iterable[str]) -> str:
    """ "a, b and c"; empty for nothing."""
    *most, last = list(parts) or [""]
    return f"{', '.join(most)} and {last}" if most else last
