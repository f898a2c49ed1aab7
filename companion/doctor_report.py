"""A Diagnosis in words: one line for each finding, and what is to be done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from companion.core.audit import Finding, Verdict
from companion.types import AutopilotKind

MAKES = {AutopilotKind.PX4: "PX4", AutopilotKind.ARDUPILOT: "ArduCopter"}
SHOWN = {Verdict.OK: "ok", Verdict.WARNING: "warning", Verdict.REFUSAL: "REFUSAL"}
WIDEST_FOUND = 44  # characters; a longer one moves the rest of its line alone


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter that --fix set, or why it did not."""

    name: str
    found: str
    value: float
    failure: str = ""

    def __str__(self) -> str:
        outcome = f"not set: {self.failure}" if self.failure else "set, and read again"
        return f"{self.name}: {self.found} -> {self.value:g}: {outcome}"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All that the doctor has to say of one vehicle; `--json` prints just this."""

    vehicle: int
    autopilot: AutopilotKind
    mavlink: str
    verdict: Verdict
    findings: tuple[Finding, ...]
    changes: tuple[Change, ...] = ()

    @property
    def fit(self) -> bool:
        """No refusal stands, and nothing that was to be set failed."""
        return self.verdict is not Verdict.REFUSAL and not any(change.failure for change in self.changes)


def heading(diagnosis: Diagnosis) -> str:
    return f"vehicle {diagnosis.vehicle}, {MAKES[diagnosis.autopilot]} at {diagnosis.mavlink}"


def lines(findings: Sequence[Finding]) -> Iterator[str]:
    """One for each, in columns."""
    subject_width = max((len(finding.subject) for finding in findings), default=0)
    found_width = min(WIDEST_FOUND, max((len(finding.found) for finding in findings), default=0))
    for finding in findings:
        wanted = f"wanted: {finding.wanted}" + (f"; {finding.remedy}" if finding.remedy else "")
        yield f"{SHOWN[finding.verdict]:<8} {finding.subject:<{subject_width}}  {finding.found:<{found_width}}  {wanted}"


def closing_words(diagnosis: Diagnosis) -> str:
    """What it comes to, and what --fix would still set."""
    refusals = sum(finding.verdict is Verdict.REFUSAL for finding in diagnosis.findings)
    warnings = sum(finding.verdict is Verdict.WARNING for finding in diagnosis.findings)
    fixable = [f"{finding.subject} to {finding.fix:g}" for finding in diagnosis.findings if finding.fix is not None]
    words = "not fit to fly in formation" if refusals else "fit to fly in formation"
    words += f": {_count(refusals, 'refusal')}, {_count(warnings, 'warning')}"
    if fixable and not diagnosis.changes:
        words += f"; --fix would set {', '.join(fixable)}"
    return words


def _count(number: int, word: str) -> str:
    return f"{number} {word}" + ("" if number == 1 else "s")
