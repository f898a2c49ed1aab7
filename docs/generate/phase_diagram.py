"""The flight phases of docs/architecture/phases.md, from the table RULES in companion/core/command/phase.py."""

from __future__ import annotations

from companion.types.flight import RULES

DRAWN_SINGLY = 4  # a command that is allowed in more phases gets one arrow from a state that stands for them all


def diagram() -> str:
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


def table() -> str:
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
