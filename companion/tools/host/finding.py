"""One finding about the companion computer."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class HostVerdict(StrEnum):
    """How a finding is judged. Missing information is never a problem."""

    OK = "ok"
    UNKNOWN = "not known"
    WARNING = "warning"
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True)
class HostFinding:
    """One line of the report: what was checked, what was found, and what to do about it."""

    subject: str
    verdict: HostVerdict
    found: str
    remedy: str = ""


def ok(subject: str, found: str) -> HostFinding:
    return HostFinding(subject, HostVerdict.OK, found)


def unknown(subject: str, found: str, remedy: str = "") -> HostFinding:
    return HostFinding(subject, HostVerdict.UNKNOWN, found, remedy)


def warning(subject: str, found: str, remedy: str) -> HostFinding:
    return HostFinding(subject, HostVerdict.WARNING, found, remedy)


def problem(subject: str, found: str, remedy: str) -> HostFinding:
    return HostFinding(subject, HostVerdict.PROBLEM, found, remedy)
