"""Types of the report: a claim of the paper with its verdict, and an erratum."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

import msgspec

Progress = Callable[[float], None]  # called with the share done, 0 to 1


class ClaimVerdict(StrEnum):
    """Result of the check of a claim by computation or flight."""

    HOLDS = "holds"
    CONDITION = "holds with a condition"
    FAILS = "does not hold"


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """One claim of the paper with the results computed here."""

    id: str  # "lemma-1", "eq-27", "fig-6"
    where: str  # "Lemma 1", "eq. 27", "figure 6"
    claim: str  # the statement, in our own words
    paper: str  # the paper's figure, as text
    ideal: str  # our result with the ideal model, or by exact computation, as text
    full: str  # our result with the full quadrotor; "-" where it does not apply
    verdict: ClaimVerdict
    remark: str = ""  # the condition, the counterexample, the correction
    measured: dict[str, float] = {}  # every number behind the texts; names end in the unit


class Erratum(msgspec.Struct, frozen=True, kw_only=True):
    """An error or omission of the printed paper."""

    place: str  # "eq. 8"
    printed: str
    right: str
    shown: str = ""  # result of the printed form when computed; empty where it cannot be computed


def no_progress(_share: float) -> None:
    """Default for callers without a progress display."""
