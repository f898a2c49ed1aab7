"""What an agent does by itself because of a health flag, in words, from the failsafe matrix."""

from __future__ import annotations

from companion.config.fleet import FleetSettings
from companion.core.safety.failsafe import FAILSAFES, Step
from companion.types.flight import FailsafeAction, HealthFlag

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
