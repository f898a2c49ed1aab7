"""The failsafe matrix of docs/safety.md, from companion/core/safety/failsafe.py."""

from __future__ import annotations

from collections.abc import Sequence

from companion.core.safety.failsafe import FAILSAFES, OTHER_FAILSAFES, Failsafe, Step
from companion.mavlink.autopilot_types import DIALECTS, PROFILES
from companion.types.flight import FLAG_TEXTS, FailsafeAction, HealthFlag


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
    for kind, profile in PROFILES.items():
        wanted = {rule.name: rule.wanted for rule in profile.parameters}
        rows += [f"| {DIALECTS[kind].NAME} | `{name}` | {wanted[name]} |" for name in profile.decide_in_silence]
    return "\n".join(rows)


def _first(row: Failsafe) -> FailsafeAction:
    action = row.steps[0].action
    assert isinstance(action, FailsafeAction)
    return action


def _steps(row: Failsafe) -> str:
    """First action | the later ones."""
    if not row.flies_on:
        return _columns(row.steps)
    first, later = _columns(row.steps).split(" | ")
    other, _ = _columns(row.flies_on).split(" | ")
    flying_on = ", ".join(DIALECTS[kind].NAME for kind, profile in PROFILES.items() if profile.flies_on_in_silence)
    return f"{first}; {flying_on}: {other} | {later}"


def _columns(steps: Sequence[Step]) -> str:
    actions = [
        f"**{step.action.name}**" if isinstance(step.action, FailsafeAction) else f"`{step.action}`" for step in steps
    ]
    later = [f"{action} after {_time(step)}" for action, step in zip(actions[1:], steps[1:], strict=True)]
    return f"{actions[0]} | {', then '.join(later)}"


def _time(step: Step) -> str:
    return f"`{step.after_s}`" if isinstance(step.after_s, str) else f"{step.after_s:g} s"
