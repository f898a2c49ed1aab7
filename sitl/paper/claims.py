"""What a claim of the paper, its verdict and a misprint look like: everything that the report is made of."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

import msgspec

Progress = Callable[[float], None]  # told the share that is done, 0 to 1


class Verdict(StrEnum):
    """What our computation or flight says to a claim."""

    HOLDS = "holds"
    CONDITION = "holds with a condition"
    FAILS = "does not hold"


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """One claim of the paper beside what came out here."""

    id: str  # "lemma-1", "eq-27", "fig-6"
    where: str  # "Lemma 1", "eq. 27", "figure 6"
    claim: str  # what the paper says, in our own words
    paper: str  # the paper's figure, as text
    ideal: str  # ours with the ideal model, or by exact computation, as text
    full: str  # ours with the full quadrotor; "-" where it does not apply
    verdict: Verdict
    remark: str = ""  # the condition, the counterexample, the correction
    measured: dict[str, float] = {}  # every number behind the texts, by a telling name with its unit


class Erratum(msgspec.Struct, frozen=True, kw_only=True):
    """A place where the printed paper is wrong or silent."""

    place: str  # "eq. 8"
    printed: str
    right: str
    shown: str = ""  # what the printed form comes to when it is computed; empty where that says nothing


def no_progress(_share: float) -> None:
    """For callers that need not know how far it is."""
