"""Tables of docs/safety.md and docs/architecture/phases.md: the failsafe matrix, and the flight phases with their commands."""

from __future__ import annotations

from collections.abc import Sequence

from companion.core.safety.failsafe import FAILSAFES, OTHER_FAILSAFES, Failsafe, Step
from companion.mavlink.autopilot_types import DIALECTS, PROFILES
from companion.types.flight import FLAG_TEXTS, RULES, FailsafeAction, HealthFlag


def failsafes() -> str:
    """One row for each health flag, the strongest first action first, then the other conditions."""
    rows = ["| flag | condition | raised | action | escalation | cleared by |", "|---|---|---|---|---|---|"]
    for row in sorted(FAILSAFES, key=lambda row: -_first(row)):
        text = FLAG_TEXTS[HealthFlag(row.condition)]
        rows.append(f"| `{row.condition}` | {text} | {row.raised} | {_steps(row)} | {row.clears} |")
    rows += [f"| `{row.condition}` | | {row.raised} | {_steps(row)} | {row.clears} |" for row in OTHER_FAILSAFES]
    return "\n".join(rows)


def parameters_relied_on() -> str:
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


DRAWN_SINGLY = 4  # a command that is allowed in more phases gets one arrow from a state that stands for them all


def phases() -> str:
    """A state diagram: one arrow to the phase meanwhile, one from there when the command is done."""
    lines = [
        "```mermaid",
        "stateDiagram-v2",
        '    state "any phase in the air" as flying',
        '    state "any phase on the ground" as ground',
        '    state "any phase, with a mode that another party set" as other',
        "    [*] --> observe",
        "    other --> observe",
    ]
    for command, rule in RULES.items():
        alone = len(rule.allowed) <= DRAWN_SINGLY
        starts = sorted(rule.allowed) if alone else ["ground" if rule.on_ground else "flying"]
        lines += [f"    {start} --> {rule.via}: {command}" for start in starts]
        lines.append(f"    {rule.via} --> {rule.to}: done")
    return "\n".join([*dict.fromkeys(lines), "```"])


def commands() -> str:
    """One row for each command that changes the phase."""
    rows = [
        "| command | allowed in | phase meanwhile | phase when done | phase after a failure | vehicle must be |",
        "|---|---|---|---|---|---|",
    ]
    for command, rule in RULES.items():
        where = "on the ground" if rule.on_ground else "in the air"
        allowed = ", ".join(sorted(rule.allowed))
        rows.append(f"| `{command}` | {allowed} | {rule.via} | {rule.to} | {rule.on_failure} | {where} |")
    return "\n".join(rows)
