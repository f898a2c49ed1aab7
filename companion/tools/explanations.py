"""Codes for people: their entries in a terminal, and in words what an agent does by itself because of a health flag."""

from __future__ import annotations

import textwrap

from companion.config.fleet import FleetSettings
from companion.core.safety.failsafe import FAILSAFES, Step
from companion.types.code_table import code_entries, code_table
from companion.types.flight import FailsafeAction, HealthFlag

COLUMNS = 100
CODE_COLUMNS = 33
A = FailsafeAction
WORDS = {
    A.NONE: "nothing",
    A.WARN: "warns",
    A.HOLD: "goes into hold",
    A.RETURN: "returns home",
    A.LAND: "lands",
    A.LEAVE: "leaves the vehicle to its pilot",
    A.STOP_STREAM: "sends no setpoint, so that the autopilot's failsafe acts",
}
_STEPS = {HealthFlag(row.condition): row.steps for row in FAILSAFES}


def report(code: str) -> str:
    """The entry of a code, wrapped to COLUMNS. Raises KeyError."""
    entry = code_entries()[code]
    lines = [code]
    for name, text in (("symptom", entry.symptom), ("cause", entry.cause), ("remedy", entry.remedy)):
        lines += textwrap.wrap(text, COLUMNS, initial_indent=f"  {name:<9}", subsequent_indent=" " * 11)
    return "\n".join(lines)


def listing() -> str:
    """All codes by subject, each with its symptom in one line of at most COLUMNS."""
    lines = []
    for title, entries in code_table().sections.items():
        lines.append(f"{title}:")
        for code, entry in entries.items():
            symptom = textwrap.shorten(entry.symptom, COLUMNS - 2 - CODE_COLUMNS, placeholder=" ...")
            lines.append(f"  {code:<{CODE_COLUMNS}}{symptom}")
    return "\n".join(lines)


def action_words(flag: HealthFlag, fleet: FleetSettings | None) -> str:
    """Like "warns, after 3 s lands". Without the fleet file its settings are named; a step that it leaves out is left out."""
    return ", ".join(text for step in _STEPS[flag] if (text := _step_words(step, fleet)))


def _step_words(step: Step, fleet: FleetSettings | None) -> str:
    action = step.action
    if isinstance(action, FailsafeAction):
        what = WORDS[action]
    else:
        what = WORDS[FailsafeAction[getattr(fleet, action).upper()]] if fleet else f"acts by {action}"
    if not isinstance(step.after_s, str):
        return f"after {step.after_s:g} s {what}" if step.after_s else what
    if fleet is None:
        return f"after {step.after_s} {what}"
    after_s = getattr(fleet, step.after_s)
    return "" if after_s is None else f"after {after_s:g} s {what}"
