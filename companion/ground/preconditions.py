"""Check of all reports before a command that must reach all vehicles or none: takeoff and return. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from companion.ground.answers import AnswerKind, Outcome
from companion.ground.reports import no_report
from companion.ground.text import id_list
from companion.types.commands import CommandName
from companion.types.flight import FLAG_TEXTS, OF_THE_FLEET, FlightPhase, HealthFlag
from companion.types.notices import Code, Notice
from companion.types.status import Status

F = HealthFlag

ALL_OR_NONE = (CommandName.TAKEOFF, CommandName.RETURN)
PHASES = {  # in which a vehicle accepts the command, or has begun or finished the action
    CommandName.TAKEOFF: frozenset({FlightPhase.ARMED, FlightPhase.TAKEOFF, FlightPhase.HOLD}),
    CommandName.RETURN: frozenset(
        {FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE, FlightPhase.HOLD, FlightPhase.RETURN}
    ),
}
STILL_CHANGING = frozenset({FlightPhase.PREPARE, FlightPhase.ARM})  # for seconds at most: worth waiting for
NEXT_STEP = {
    CommandName.TAKEOFF: "send arm first and wait until it has finished",
    CommandName.RETURN: "it returns from hold or formation; send hold or land to a vehicle in another phase",
}
POSITION_FLAGS = frozenset({F.POSITION_STALE, F.FRAME_UNKNOWN, F.FRAME_CONTRADICTED, F.POSITION_JUMPED})
WHAT_NEXT = {
    CommandName.TAKEOFF: "remove the reason, then takeoff --only {rest}; or land --only {begun}",
    CommandName.RETURN: "return --only {rest} after the others are home, or land --only {rest}; hold --only {begun} stops them",
}


def check_all(
    name: CommandName, ids: Sequence[int], statuses: Mapping[int, Status], operator: str, wait_s: float
) -> dict[int, Outcome]:
    """Empty where all vehicles can begin; else NOT_SENT or MISSING for each of them, with its reason."""
    reasons = {i: _obstacle(name, statuses[i], operator) for i in ids if i in statuses}
    failed = [i for i in ids if i not in statuses or reasons[i]]
    if not failed:
        return {}
    others = Notice(Code.NOT_SENT, f"{name} is for all vehicles or none, and {id_list(failed)} cannot begin")
    outcomes = {}
    for i in ids:
        if i in statuses:
            outcomes[i] = Outcome(AnswerKind.NOT_SENT, reasons[i] or others)
        else:
            outcomes[i] = Outcome(AnswerKind.MISSING, no_report(wait_s))
    return outcomes


def _obstacle(name: CommandName, status: Status, operator: str) -> Notice | None:
    """Why the vehicle would refuse, as far as its report shows."""
    if status.holder not in ("", operator):
        return Notice(
            Code.OTHER_HOLDS_COMMAND, f"{status.holder} holds command; take it over with: companion fleet take"
        )
    if status.phase not in PHASES[name]:
        return Notice(Code.WRONG_PHASE, f"{name} is not possible in phase {status.phase}; {NEXT_STEP[name]}")
    flags = set(status.flags) - OF_THE_FLEET if name is CommandName.TAKEOFF else set(status.flags) & POSITION_FLAGS
    if flags:
        flag = min(flags)
        return Notice(Code(flag), FLAG_TEXTS[flag])
    return status.refuses_return if name is CommandName.RETURN else None


def divided(name: CommandName, outcomes: Mapping[int, Outcome]) -> Notice | None:
    """What to do where some vehicles began and others refused after the check; None where the fleet is not divided."""
    begun = [i for i, outcome in outcomes.items() if outcome.kind is AnswerKind.ACCEPTED]
    rest = [i for i in outcomes if i not in begun]
    if name not in ALL_OR_NONE or not begun or not rest:
        return None
    lists = {"begun": " ".join(map(str, sorted(begun))), "rest": " ".join(map(str, sorted(rest)))}
    return Notice(
        Code.FLEET_DIVIDED,
        f"{id_list(begun)} began {name}, {id_list(rest)} did not. Next: {WHAT_NEXT[name].format(**lists)}",
    )
