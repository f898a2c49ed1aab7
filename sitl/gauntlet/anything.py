"""The family `anything`: flights without a plan. Slots, starts, law, commands and faults are drawn independently.

Each other family draws one situation. This one finds what none of them was written for. Only the search flies it.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from companion.types.autopilot import AutopilotKind
from sitl.gauntlet.families import RESTARTS_AFTER_S, STAYS_DEAD, FamilyPlan, fast, shape_change, slow, step, turning
from sitl.gauntlet.faults import ALL_FAMILIES, COMBINED, DISTURBANCES, at, combined, fit_to_wind
from sitl.gauntlet.fleets import START_SPACING, DrawnFleet, direction, moved, on_grid, scattered, to_thousandth

LAW_NAMES = ("weighted", "cooperative", "serial")
HEIGHTS_M = 3.0  # slots are up to this far above the reference
FROM_S, LASTS_S = (2.0, 26.0), 36.0
MOST_COMMANDS, MOST_DISTURBANCES = 5, 2
NEIGHBOUR_RANGE_M = (4.0, 40.0)


def anything(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Slots at any places, any commands to any vehicles, and up to two disturbances."""
    _place(random, fleet)
    plan = random.choice((_slow, _slow, fast, turning))(random, fleet)
    plan.lasts_s, plan.steps, plan.expected = LASTS_S, [], []
    plan.settings["law.name"] = random.choice(LAW_NAMES)
    plan.settings["law.altitude"] = random.choice(("formation", "formation", "hold"))
    if random.random() < 0.5:
        near_m = to_thousandth(random.uniform(*NEIGHBOUR_RANGE_M))
        plan.settings["neighbours"] = {"kind": "range", "range_m": near_m, "hysteresis_m": 1.0}
    for _ in range(random.randint(0, MOST_COMMANDS)):
        random.choice(COMMANDS)(random, fleet, plan)
    for happens in random.sample(ALL_DISTURBANCES, random.randint(0, MOST_DISTURBANCES)):
        happens(random, fleet, plan)
    fit_to_wind(fleet, plan)
    plan.steps.sort(key=lambda one: float(one["at_s"]))
    plan.judges_hand_over = False  # vehicles are commanded to land and return wherever they are
    return plan


def _slow(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    return FamilyPlan(slow(random, fleet))


def _place(random: Random, fleet: DrawnFleet) -> None:
    """Slots and starts at random places, the starts also those of the slots in another order, or far away."""
    tall = random.random() < 0.4
    places = scattered(random, fleet.size, fleet.spacing_m)
    heights_m = [random.uniform(0.0, HEIGHTS_M) if tall else 0.0 for _ in places]
    fleet.slots_enu_m = {i: on_grid((x, y, z)) for i, (x, y, _), z in zip(fleet.ids, places, heights_m, strict=True)}
    starts = [*places] if random.random() < 0.4 else scattered(random, fleet.size, START_SPACING * fleet.spacing_m)
    random.shuffle(starts)
    away = direction(random, random.choice((0.0, 0.0, random.uniform(3.0, 15.0))))
    fleet.starts_enu_m = {i: moved(start, away) for i, start in zip(fleet.ids, starts, strict=True)}


def _some(random: Random, fleet: DrawnFleet) -> list[int]:
    return sorted(random.sample(fleet.ids, random.randint(1, max(1, fleet.size // 2))))


def _vehicles(command: str) -> Callable[[Random, DrawnFleet, FamilyPlan], None]:
    def add(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
        plan.steps.append(step(command, random.uniform(*FROM_S), vehicles=_some(random, fleet)))

    return add


def _change(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    plan.steps.append(step("formation", random.uniform(*FROM_S), formation=shape_change(random, fleet)))


def _exchange(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    """The slots in another order, or at other places."""
    others = [*fleet.slots_enu_m.values()] if random.random() < 0.6 else scattered(random, fleet.size, fleet.spacing_m)
    random.shuffle(others)
    slots = {i: list(slot) for i, slot in zip(fleet.ids, others, strict=True)}
    speed_m_s = to_thousandth(random.uniform(0.3, 0.98) * fleet.slot_speed_m_s)
    change = {"slots_enu_m": slots, "speed_m_s": speed_m_s}
    plan.steps.append(step("formation", random.uniform(*FROM_S), formation=change))


def _reference(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    plan.steps.append(step("reference", random.uniform(*FROM_S), reference=slow(random, fleet)))


def _lead(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    plan.steps.append(step("lead", random.uniform(*FROM_S), leaders=[random.choice((fleet.leader, fleet.successor))]))


def _end_agent(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    """Not of an ArduCopter, which drifts unheard, as in `leader_dies`."""
    if fleet.autopilot is AutopilotKind.PX4:
        end = {"vehicle": random.choice(fleet.ids), "at_s": at(random.uniform(*FROM_S))}
        if random.random() >= STAYS_DEAD:
            end["restarts_after_s"] = to_thousandth(random.uniform(*RESTARTS_AFTER_S))
        plan.agent_ends = [end]


COMMANDS = (
    *(_vehicles(command) for command in ("hold", "land", "return", "form", "form")),
    _change,
    _exchange,
    _exchange,
    _reference,
    _lead,
)
ALL_DISTURBANCES = (*DISTURBANCES, _end_agent)
ANYTHING = anything.__name__
SEARCHED = ALL_FAMILIES | {COMBINED: combined, ANYTHING: anything}
