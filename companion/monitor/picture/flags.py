"""Health flags for people: how severe each is, what the agent does, and what the operator should do."""

from __future__ import annotations

from functools import lru_cache

from companion.config.fleet import FleetSettings
from companion.monitor.api import FlagView, Severity
from companion.tools.explanations.table import EXPLANATIONS
from companion.tools.failsafe_words import action_words
from companion.types.flight import FLAG_TEXTS, HealthFlag

# In flight these leave time, or pass by themselves. Every other flag is critical there.
WARNINGS = frozenset({HealthFlag.LEADER_AWAITED, HealthFlag.BATTERY_LOW, HealthFlag.TICK_LATE})


# They count while the vehicle flies by its neighbours: in hold it only cannot begin to.
IN_FORMATION = frozenset({HealthFlag.LEADER_LOST, HealthFlag.FLEET_LINK_LOST})


def severity_of(flag: HealthFlag, armed: bool, streaming: bool) -> Severity:
    """On the ground a flag only keeps a vehicle from flying."""
    if flag in WARNINGS or not armed or (flag in IN_FORMATION and not streaming):
        return "warning"
    return "critical"


@lru_cache(maxsize=1024)
def flag_view(flag: HealthFlag, armed: bool, streaming: bool, fleet: FleetSettings | None) -> FlagView:
    """A flag of a vehicle of this fleet. `streaming`: its agent sends setpoints."""
    return FlagView(
        code=flag,
        severity=severity_of(flag, armed, streaming),
        text=FLAG_TEXTS[flag],
        action=action_words(flag, fleet),
        advice=advice_of(flag),
    )


def advice_of(code: str) -> str:
    """What the operator should do; "" where nothing is known of the code."""
    entry = EXPLANATIONS.get(code)
    return entry.remedy if entry else ""
