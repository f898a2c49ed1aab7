"""Report of `companion doctor`: one line per finding, and a summary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from companion.core.safety.audit import Finding, Verdict
from companion.types.autopilot import AutopilotKind

AUTOPILOT_NAMES = {AutopilotKind.PX4: "PX4", AutopilotKind.ARDUPILOT: "ArduCopter"}
SHOWN = {Verdict.OK: "ok", Verdict.WARNING: "warning", Verdict.REFUSAL: "REFUSAL"}
WIDEST_FOUND = 44  # characters; a longer value shifts only its own line


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter that --fix set, or the reason why it did not."""

    name: str
    found: str
    value: float
    failure: str = ""

    def __str__(self) -> str:
        outcome = f"not set: {self.failure}" if self.failure else "set and read back"
        return f"{self.name}: {self.found} -> {self.value:g}: {outcome}"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Result of the doctor for one vehicle, as `--json` prints it."""

    vehicle: int
    autopilot: AutopilotKind
    mavlink: str
    verdict: Verdict
    findings: tuple[Finding, ...]
    changes: tuple[Change, ...] = ()

    @property
    def fit(self) -> bool:
        """Whether there is no refusal and every parameter could be set."""
        return self.verdict is not Verdict.REFUSAL and not any(change.failure for change in self.changes)


def heading(diagnosis: Diagnosis) -> str:
    """The first line of the report."""
    return f"vehicle {diagnosis.vehicle}, {AUTOPILOT_NAMES[diagnosis.autopilot]} at {diagnosis.mavlink}"


def lines(findings: Sequence[Finding]) -> Iterator[str]:
    """One line per finding, in columns; the code follows where the finding is not OK."""
    subject_width = max((len(finding.subject) for finding in findings), default=0)
    found_width = min(WIDEST_FOUND, max((len(finding.found) for finding in findings), default=0))
    for finding in findings:
        wanted = f"wanted: {finding.wanted}" + (f"; {finding.remedy}" if finding.remedy else "")
        wanted += f" [{finding.code}]" if finding.code else ""
        yield f"{SHOWN[finding.verdict]:<8} {finding.subject:<{subject_width}}  {finding.found:<{found_width}}  {wanted}"


def summary(diagnosis: Diagnosis) -> str:
    """The last line: fit or not, number of findings, and what --fix would set."""
    refusals = sum(finding.verdict is Verdict.REFUSAL for finding in diagnosis.findings)
    warnings = sum(finding.verdict is Verdict.WARNING for finding in diagnosis.findings)
    fixable = [f"{finding.subject} to {finding.fix:g}" for finding in diagnosis.findings if finding.fix is not None]
    text = "not fit to fly in formation" if refusals else "fit to fly in formation"
    text += f": {_count(refusals, 'refusal')}, {_count(warnings, 'warning')}"
    if fixable and not diagnosis.changes:
        text += f"; --fix would set {', '.join(fixable)}"
    return text


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
