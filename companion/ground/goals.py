"""What the reports must show before a command for all vehicles or none, and the end state of each action. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import dist, inf

from companion.ground.answers import AnswerKind, End, Outcome, id_list
from companion.ground.reports import no_report
from companion.types.autopilot import LandedState
from companion.types.commands import CommandName, Content, Lead, ReferenceChange, is_newer
from companion.types.flight import FLAG_TEXTS, OF_THE_FLEET, FlightPhase, HealthFlag, Role
from companion.types.formation import FormationChange
from companion.types.notices import Code, Notice
from companion.types.status import Status

P, C = FlightPhase, CommandName

SLOT_REACHED_M = 0.001  # a status has its slot to 0.1 mm
SHORT_S, LONG_S = 60.0, 300.0  # --timeout by default
NOT_HELD_S = 5.0  # an accepted change that no report has had until then is cancelled; one begins after AHEAD_S


@dataclass(frozen=True, slots=True)
class Goal:
    """The end state of an action. A vehicle in a phase outside `on_the_way` that has not reached it has failed.

    `held` is whether a vehicle still has an accepted change, which waits or is flown: if it had, it has cancelled the change.
    """

    text: str  # "armed", in the plural as well
    timeout_s: float
    reached: Callable[[Status], bool]
    on_the_way: frozenset[FlightPhase] = frozenset(P)
    held: Callable[[Status], bool] = lambda _: True


def _on_ground(status: Status) -> bool:
    return not status.autopilot.armed and status.autopilot.landed is not LandedState.IN_AIR


def _in(phase: FlightPhase) -> Callable[[Status], bool]:
    return lambda status: status.phase is phase


def _in_formation(status: Status) -> bool:
    return status.phase is P.FORMATION and not status.formation.slot.moves


def _aborted(status: Status) -> bool:
    """Also a vehicle that its pilot flies: abort leaves it to the pilot."""
    return _on_ground(status) or status.phase in (P.HOLD, P.OBSERVE)


GOALS = {
    C.PREPARE: Goal("prepared", SHORT_S, _in(P.READY), frozenset({P.PREPARE})),
    C.ARM: Goal("armed", SHORT_S, _in(P.ARMED), frozenset({P.ARM})),
    C.TAKEOFF: Goal("in hold after takeoff", SHORT_S, _in(P.HOLD), frozenset({P.TAKEOFF})),
    C.FORM: Goal("in formation", SHORT_S, _in_formation, frozenset({P.ENGAGE, P.FORMATION})),
    C.HOLD: Goal("in hold", SHORT_S, _in(P.HOLD), frozenset({P.RELEASE})),
    C.LAND: Goal("on the ground and disarmed", LONG_S, _on_ground, frozenset({P.LAND})),
    C.RETURN: Goal("home, on the ground and disarmed", LONG_S, _on_ground, frozenset({P.RETURN, P.RELEASE})),
    C.DISARM: Goal("disarmed", SHORT_S, lambda status: not status.autopilot.armed, frozenset({P.LAND})),
    C.ABORT: Goal("in hold, or on the ground and disarmed", LONG_S, _aborted),
}


def goal_of(name: CommandName, content: Content | None, running: bool) -> Goal | None:
    """None for `take`, which its reply finishes. `running`: the time of the reference runs, as some vehicle is in formation."""
    match content:
        case Lead():
            return Goal("with the new leader", SHORT_S, lambda status: _follows(status, content))
        case FormationChange():
            return Goal(
                "in the new formation",
                LONG_S,
                lambda status: _flies(status, content),
                held=lambda status: _has(content.number, *_formations(status)),
            )
        case ReferenceChange():
            return Goal(
                "with the new reference",
                LONG_S,
                lambda status: _holds(status, content, running),
                held=lambda status: _has(content.number, *_references(status)),
            )
    return GOALS.get(name)


def _follows(status: Status, lead: Lead) -> bool:
    leads, known = status.agent.vehicle_id in lead.leaders, status.leadership
    return is_newer(known.epoch, lead.epoch) or (known.epoch == lead.epoch and (known.role is Role.LEADER) is leads)


def _formations(status: Status) -> tuple[int, int]:
    """Number of the formation flown, and of the one that waits."""
    return status.formation.slot.formation, status.formation.slot.waiting


def _references(status: Status) -> tuple[int, int]:
    """Number of the reference flown, and of the one that waits; 0 where the vehicle may not lead."""
    held = status.formation.reference
    return (held.flown, held.waiting) if held else (0, 0)


def _has(number: int, flown: int, waiting: int) -> bool:
    return any(one == number or is_newer(one, number) for one in (flown, waiting))


def _flies(status: Status, change: FormationChange) -> bool:
    """In its slot of the change, or at rest in that of a newer one. In the tick in which a change begins no slot moves yet."""
    flown = status.formation.slot.formation
    if flown == change.number and (left_m := way_left_m(status, change)) < inf:
        return left_m < SLOT_REACHED_M
    return (flown == change.number or is_newer(flown, change.number)) and not status.formation.slot.moves


def way_left_m(status: Status, change: FormationChange) -> float:
    """From the slot that the vehicle flies to its slot in the new formation; inf where it has none there."""
    slot_enu_m = dict(change.slots_enu_m).get(status.agent.vehicle_id)
    return inf if slot_enu_m is None else dist(status.formation.slot.position_enu_m, slot_enu_m)


def _holds(status: Status, change: ReferenceChange, running: bool) -> bool:
    """On the ground and in hold a vehicle begins with the new reference when it forms."""
    held = status.formation.reference
    if held is None:
        return False
    number = held.flown if running else held.waiting
    return number == change.number or is_newer(number, change.number)


def end_of(goal: Goal, status: Status, after_s: float) -> End | None:
    """None while the vehicle is on the way."""
    if goal.reached(status):
        return End(True, after_s, Notice(Code.ACTION_FINISHED, goal.text))
    if status.phase in goal.on_the_way:
        return None
    event = f"; last event {status.last_event}" if status.last_event else ""
    return End(False, after_s, Notice(Code.ACTION_FAILED, f"not {goal.text}: phase {status.phase}{event}"))


def end_cancelled(goal: Goal, status: Status, after_s: float) -> End:
    """The end of the wait for a vehicle that has dropped an accepted change."""
    event = f"; last event {status.last_event}" if status.last_event else ""
    return End(False, after_s, Notice(Code.ACTION_FAILED, f"not {goal.text}: the vehicle has cancelled it{event}"))


def end_timed_out(goal: Goal, status: Status | None, after_s: float, timeout_s: float) -> End:
    """The end of the wait for a vehicle that is still on the way, or does not report."""
    state = f"phase {status.phase}" if status else "no new report"
    text = f"not {goal.text} within {timeout_s:g} s: {state}; the action goes on"
    return End(False, after_s, Notice(Code.ACTION_TIMED_OUT, text))


def progress_text(goal: Goal, ends: Mapping[int, End], pending: Mapping[int, Status | None], total: int) -> str:
    """ "2 of 4 armed; vehicles 3, 4: arm"."""
    by_phase: dict[str, list[int]] = {}
    for i, status in pending.items():
        by_phase.setdefault(f"phase {status.phase}" if status else "no new report", []).append(i)
    rest = "".join(f"; {id_list(ids)}: {phase}" for phase, ids in sorted(by_phase.items()))
    return f"{sum(end.finished for end in ends.values())} of {total} {goal.text}{rest}"


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
POSITION_FLAGS = frozenset(
    {F.POSITION_STALE, F.FRAME_UNKNOWN, F.GROUND_UNKNOWN, F.FRAME_CONTRADICTED, F.POSITION_JUMPED}
)
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
    if status.command.holder not in ("", operator):
        return Notice(
            Code.OTHER_HOLDS_COMMAND,
            f"{status.command.holder} holds command; take it over: companion fleet take, or Take command on the page",
        )
    if status.phase not in PHASES[name]:
        return Notice(Code.WRONG_PHASE, f"{name} is not possible in phase {status.phase}; {NEXT_STEP[name]}")
    raised = set(status.safety.flags)
    if flags := raised - OF_THE_FLEET if name is CommandName.TAKEOFF else raised & POSITION_FLAGS:
        flag = min(flags)
        return Notice(Code(flag), FLAG_TEXTS[flag])
    return status.safety.refuses_return if name is CommandName.RETURN else None


def advise_divided_fleet(name: CommandName, outcomes: Mapping[int, Outcome]) -> Notice | None:
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
