"""One episode: a fleet flies under a hostile stream; after it the true operator and the true peers must work again."""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Collection, Mapping
from random import Random

from msgspec import Struct
from msgspec.structs import replace

from companion.ground.changes import change_to, reference_change
from companion.types.autopilot import LandedState
from companion.types.commands import CommandName, Described, Lead, ReferenceChange, next_epoch
from companion.types.flight import COOPERATING, FlightPhase
from companion.types.formation import FormationChange
from companion.types.notices import Code
from tests.fuzz.fleet import HostileFleet, InvariantError
from tests.fuzz.plant import TICK_S
from tests.fuzz.stream import HostileStream

STEPS = (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM)
HOSTILE_TICKS = 400
SETTLE_S = 4.0  # from the end of the hostile stream to the checks
LANDS_WITHIN_S = 40.0
MAX_OBJECTS = 20_000
# A displaced fleet may have no room for a change: these refusals are decisions, not locks.
NO_ROOM = {
    Code.SLOT_OUTSIDE_FENCE,
    Code.SLOT_TOO_CLOSE,
    Code.SLOT_TOO_FAST,
    Code.SLOTS_NOT_FOLLOWED,
    Code.CHANGE_IN_PROGRESS,
    Code.REFERENCE_INVALID,
    Code.REFERENCE_DIFFERS,
    Code.REFERENCE_OFF_FLEET,
    Code.VEHICLE_IN_THE_WAY,
}
CAN_CHANGE = COOPERATING - {FlightPhase.RELEASE} | {FlightPhase.OBSERVE, FlightPhase.READY, FlightPhase.ARMED}


class Outcome(Struct, kw_only=True):
    """What one episode did. `failures` has one line for each exception, broken invariant and lock."""

    seed: int
    ticks: int
    refused: Counter[str]
    passed: Counter[str]
    phases: Counter[str]
    failures: list[str]
    vehicles: int
    longest_tick_s: float
    longest_tick: str  # what it received
    tick_seconds: float
    most_objects: int


def fly(seed: int) -> Outcome:
    """Fly the episode of this seed.

    All have hostile packets, targets and traffic; every second one hostile commands, two of four hostile telemetry. Every third
    fleet is a chain of six, every second one of these wide.
    """
    rng = Random(seed)
    fleet = HostileFleet(rng, is_chain=seed % 3 == 2, is_wide=seed % 6 == 5)
    stream = HostileStream(rng, fleet, gives_commands=seed % 2 == 1, sends_telemetry=seed % 4 >= 2)
    failures: list[str] = []
    phases: Counter[str] = Counter()
    most_objects = 0
    try:
        _set_off(fleet, rng)
        for _ in range(HOSTILE_TICKS):
            fleet.tick(stream.next())
            phases.update(agent.phase.value for agent in fleet.agents.values())
        most_objects = max(_objects_in(agent) for agent in fleet.agents.values())
        if most_objects > MAX_OBJECTS:
            failures.append(f"state grows: {most_objects} objects")
        failures += _locks(fleet)
    except Exception as error:  # noqa: BLE001 -- every exception is a finding
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = (
            "" if isinstance(error, InvariantError) else f" at {last.filename.partition('companion/')[2]}:{last.lineno}"
        )
        failures.append(f"{type(error).__name__}{place}: {str(error)[:160]}")
    return Outcome(
        seed=seed,
        ticks=fleet.ticks,
        refused=stream.refused,
        passed=stream.passed,
        phases=phases,
        failures=failures,
        vehicles=len(fleet.agents),
        longest_tick_s=fleet.longest_tick_s,
        longest_tick=fleet.longest_tick,
        tick_seconds=fleet.tick_seconds,
        most_objects=most_objects,
    )


def _set_off(fleet: HostileFleet, rng: Random) -> None:
    """Into formation, or only to one of the phases before it."""
    for _ in range(10):
        fleet.tick()
    for name in STEPS[: rng.choice((0, 2, 3, 4, 4, 4, 4, 4))]:
        replies = fleet.command(name)
        refused = [reply for reply in replies.values() if not reply.accepted]
        if refused:
            raise InvariantError(f"{name} refused before any hostile message: {refused[0].code} {refused[0].reason}")
        for _ in range(80 if name is CommandName.TAKEOFF else 30):
            fleet.tick()


def _locks(fleet: HostileFleet) -> list[str]:
    """What does not work SETTLE_S after the end of the hostile stream."""
    _wait(fleet, SETTLE_S)
    found = [
        f"lock: vehicle {i} does not use the packets of {sorted(fleet.agents.keys() - {i} - set(status.neighbourhood.peers))}"
        for i, status in fleet.statuses.items()
        if set(status.neighbourhood.peers) != fleet.packets.keys() - {i}
    ]
    found += _refused(fleet, CommandName.TAKE, fleet.command(CommandName.TAKE))
    _wait_for_landings(fleet)
    found += _taken_back(fleet)
    _wait_for_landings(fleet)  # hold without a leader ends in a landing after `land_after_s`
    statuses = list(fleet.statuses.values())
    lead = Lead((1,), next_epoch(status.leadership.epoch for status in statuses))
    found += _refused(fleet, CommandName.LEAD, fleet.command(CommandName.LEAD, lead))
    _wait(fleet, 1.0)
    found += _without_beacon(fleet)
    found += _refused(fleet, CommandName.FORMATION, fleet.command(CommandName.FORMATION, _formation(fleet)))
    found += _refused(fleet, CommandName.REFERENCE, fleet.command(CommandName.REFERENCE, _reference(fleet)), (1, 2))
    _wait(fleet, 2.0)
    flying = [i for i, agent in fleet.agents.items() if agent.phase in COOPERATING]
    hold = fleet.command(CommandName.HOLD)
    found += _refused(fleet, CommandName.HOLD, {i: hold[i] for i in flying if i in hold})
    return found


def _without_beacon(fleet: HostileFleet) -> list[str]:
    """Vehicles that do not pass on the beacon of a neighbour. One that does not know its position sends no packet."""
    sends = [i for i, agent in fleet.agents.items() if agent.phase in COOPERATING and i in fleet.packets]
    flying = {i: status for i, status in fleet.statuses.items() if i in sends}
    have = {i for i, status in flying.items() if status.leadership.leader_beacon is not None}
    return [
        f"lock: vehicle {i} has no leader beacon, its neighbours {sorted(have & set(status.neighbourhood.neighbours))} have one"
        for i, status in flying.items()
        if i not in have and have & set(status.neighbourhood.neighbours)
    ]


def _wait_for_landings(fleet: HostileFleet) -> None:
    waited_s = 0.0
    while waited_s < LANDS_WITHIN_S and any(agent.phase not in CAN_CHANGE for agent in fleet.agents.values()):
        _wait(fleet, 0.5)
        waited_s += 0.5


def _taken_back(fleet: HostileFleet) -> list[str]:
    """Vehicles that a wrong flight mode has left to a pilot: `hold` takes them back."""
    observing = [i for i, agent in fleet.agents.items() if agent.phase is FlightPhase.OBSERVE and _flies(fleet, i)]
    if not observing:
        return []
    fleet.replies = {}
    for i in observing:
        fleet.give(i, CommandName.HOLD)
    _wait(fleet, 1.0)
    found = _refused(fleet, CommandName.HOLD, fleet.replies)
    return found + [
        f"lock: vehicle {i} is in {fleet.agents[i].phase} after hold"
        for i in observing
        if fleet.agents[i].phase is not FlightPhase.HOLD
    ]


def _flies(fleet: HostileFleet, vehicle_id: int) -> bool:
    return fleet.plants[vehicle_id].landed is LandedState.IN_AIR


def _refused(
    fleet: HostileFleet, name: CommandName, replies: Mapping[int, object], ids: Collection[int] | None = None
) -> list[str]:
    found = []
    for i, reply in fleet.replies.items():
        if (ids is None or i in ids) and i in replies and not reply.accepted and reply.code not in NO_ROOM:
            found.append(
                f"lock: {name} refused by vehicle in {fleet.agents[i].phase}: {reply.code} {reply.reason}"[:200]
            )
    return found


def _formation(fleet: HostileFleet) -> FormationChange:
    statuses = list(fleet.statuses.values())
    slots = {m.id: (m.slot_enu_m[0] * 1.1, 0.0, 0.0) for m in fleet.config.vehicles}
    return replace(change_to(slots, statuses, fleet.config.slot_speed_m_s), lasts_s=60.0)


def _reference(fleet: HostileFleet) -> ReferenceChange:
    described: Described = {"kind": "point", "point_enu_m": [0.0, 0.0, 5.0]}
    return reference_change(described, list(fleet.statuses.values()))


def _wait(fleet: HostileFleet, seconds: float) -> None:
    for _ in range(round(seconds / TICK_S)):
        fleet.tick()


def _objects_in(root: object) -> int:
    """Number of containers and instances reachable from an agent, elements of containers included."""
    seen: set[int] = set()
    count, stack = 0, [root]
    while stack:
        item = stack.pop()
        if id(item) in seen or isinstance(item, str | bytes | int | float | type | None):
            continue
        seen.add(id(item))
        if isinstance(item, Mapping):
            count += len(item)
            stack += [*item.keys(), *item.values()]
        elif isinstance(item, list | tuple | set | frozenset):
            count += len(item)
            stack += item
        else:
            names = [
                *getattr(item, "__dict__", {}),
                *getattr(type(item), "__slots__", ()),
                *getattr(item, "__struct_fields__", ()),
            ]
            count += len(names)
            stack += [getattr(item, name, None) for name in names]
    return count
