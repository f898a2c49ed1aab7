"""The failsafe matrix of docs/safety.md, from companion/core/safety/failsafe.py."""

from __future__ import annotations

from collections.abc import Sequence

from companion.core.safety.audit_parameters import RULES
from companion.core.safety.failsafe import FAILSAFES, OTHER_FAILSAFES, RELIED_ON, Failsafe, Step
from companion.types.autopilot import AutopilotKind
from companion.types.flight import FLAG_TEXTS, FailsafeAction, HealthFlag

NAMES = {AutopilotKind.PX4: "PX4", AutopilotKind.ARDUPILOT: "ArduCopter"}


def table() -> str:
    """One row for each health flag, the strongest first action first, then the other conditions."""
    rows = ["| flag | condition | raised | action | escalation | cleared by |", "|---|---|---|---|---|---|"]
    for row in sorted(FAILSAFES, key=lambda row: -_first(row)):
        text = FLAG_TEXTS[HealthFlag(row.condition)]
        rows.append(f"| `{row.condition}` | {text} | {row.raised} | {_steps(row)} | {row.clears} |")
    rows += [f"| `{row.condition}` | | {row.raised} | {_steps(row)} | {row.clears} |" for row in OTHER_FAILSAFES]
    return "\n".join(rows)


def parameters() -> str:
    """The autopilots' parameters that decide what follows when setpoints end."""
    rows = ["| autopilot | parameter | wanted |", "|---|---|---|"]
    for kind, names in RELIED_ON.items():
        wanted = {rule.name: rule.wanted for rule in RULES[kind]}
        rows += [f"| {NAMES[kind]} | `{name}` | {wanted[name]} |" for name in names]
    return "\n".join(rows)


def _first(row: Failsafe) -> FailsafeAction:
    action = row.steps[0].action
    assert isinstance(action, FailsafeAction)
    return action


def _steps(row: Failsafe) -> str:
    """First action | the later ones."""
    if not row.ardupilot:
        return _columns(row.steps)
    first, later = _columns(row.steps).split(" | ")
    other, _ = _columns(row.ardupilot).split(" | ")
    return f"{first}; {NAMES[AutopilotKind.ARDUPILOT]}: {other} | {later}"


def _columns(steps: Sequence[Step]) -> str:
    actions = [
        f"**{step.action.name}**" if isinstance(step.action, FailsafeAction) else f"`{step.action}`" for step in steps
    ]
    later = [f"{action} after {_time(step)}" for action, step in zip(actions[1:], steps[1:], strict=True)]
    return f"{actions[0]} | {', then '.join(later)}"


def _time(step: Step) -> str:
    return f"`{step.after_s}`" if isinstance(step.after_s, str) else f"{step.after_s:g} s"
