"""All explanations, by subject and by code."""

from __future__ import annotations

from companion.tools.explanations import (
    analysis,
    audit,
    automatic,
    autopilot,
    commands,
    formations,
    ground,
    ground_station,
    health_flags,
    leaders,
    network,
    peers,
    phases,
    preflight,
    process,
    recorded_flight,
)
from companion.tools.explanations.explanation import Explanation

SECTIONS: dict[str, dict[str, Explanation]] = {
    "Health flags": health_flags.ENTRIES,
    "Commands and operators": commands.ENTRIES,
    "Flight phases": phases.ENTRIES,
    "Automatic hand-over and landing": automatic.ENTRIES,
    "Formations, slots and joining": formations.ENTRIES,
    "Leaders, references and targets": leaders.ENTRIES,
    "Checks before flight": preflight.ENTRIES,
    "Vehicle audit": audit.ENTRIES,
    "Refused data of the autopilot": autopilot.ENTRIES,
    "Refused packets of peers": peers.ENTRIES,
    "Refused messages of the network": network.ENTRIES,
    "Ground station on the agent's link": ground_station.ENTRIES,
    "Ground tools": ground.ENTRIES,
    "Verdicts of companion analyze": analysis.ENTRIES,
    "Process and machine": process.ENTRIES,
    "Report of a flight": recorded_flight.ENTRIES,
}

EXPLANATIONS: dict[str, Explanation] = {code: entry for section in SECTIONS.values() for code, entry in section.items()}
