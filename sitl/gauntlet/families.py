"""The families of flights: what happens to a random fleet after take-off.

A family takes the generator and the fleet, may change slots and starts, and returns a Plan. Times of plans are after FORM_S,
when the vehicles are commanded to form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import dist, pi, radians
from random import Random
from typing import Any

from companion.geometry.curves import PEAK_SPEED
from companion.geometry.formations import SHAPES, slots_of
from companion.ground.changes import assign_slots
from companion.types.autopilot import AutopilotKind
from companion.types.values import Vector3
from sitl.gauntlet.fleets import START_SPACING, DrawnFleet, direction, moved, on_grid, scattered, to_thousandth

FORM_S = 8.5  # by then all hover
GIVEN_UP_AFTER_S = 3.0  # a command is repeated for so long
LONGEST_S = 60.0  # of a flight; a change that takes longer is not flown to its end
ENTERED_WITHIN_S = 12.0  # so long may the paths into the slots last: until then a change of formation is refused
RESTARTS_AFTER_S = (2.0, 6.0)  # RestartSec of the service and the start of the process; with a wide margin
STAYS_DEAD = 0.3  # share of agents that do not start again, like a computer without power
Content = dict[str, Any]


@dataclass
class FamilyPlan:
    """Commands after take-off, and what is particular to this flight.

    `stays_out`: vehicles that take off and are not commanded to form at first. `slots_from_s`: the time from which vehicles
    fly to the slots that they are to reach. `expected`: the vehicles that are to be in their slots at the end; None: all.
    `settings` of the fleet by path, `stand_in` and `links` are added to those that are drawn. `judges_hand_over`: pairs of
    which both fly by their autopilots count as well, because agents chose to hand over.
    """

    reference: Content
    steps: list[Content] = field(default_factory=list)
    lasts_s: float = 22.0
    stays_out: tuple[int, ...] = ()
    slots_from_s: float = 0.0
    expected: list[int] | None = None
    partitions: list[Content] = field(default_factory=list)
    agent_ends: list[Content] = field(default_factory=list)
    turns: bool = False
    settings: Content = field(default_factory=dict)
    stand_in: Content = field(default_factory=dict)
    links: Content = field(default_factory=dict)
    judges_hand_over: bool = False


Family = Callable[[Random, DrawnFleet], FamilyPlan]


def step(command: str, after_s: float, **content: object) -> Content:
    """A step that may fail, this long after FORM_S."""
    fields = {key: value for key, value in content.items() if value is not None}
    at_s = to_thousandth(FORM_S + after_s)
    return {"command": command, "at_s": at_s, "may_fail": True, "timeout_s": GIVEN_UP_AFTER_S, **fields}


def point(fleet: DrawnFleet, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Content:
    return {"kind": "point", "point_enu_m": [at[0], at[1], to_thousandth(fleet.height_m + at[2])]}


def slow(random: Random, fleet: DrawnFleet) -> Content:
    """A reference that rests or moves slowly."""
    if random.random() < 0.5:
        return point(fleet)
    way = direction(random, random.uniform(5.0, 15.0))
    points = [[0.0, 0.0, fleet.height_m], [way[0], way[1], fleet.height_m]]
    speed_m_s = to_thousandth(random.uniform(0.3, 1.0))
    return {"kind": "waypoints", "points_enu_m": points, "max_speed_m_s": speed_m_s, "max_acceleration_m_s2": 0.4}


def shape_change(random: Random, fleet: DrawnFleet) -> Content:
    shape = random.choice(("line", "column", "v", "diamond", "rectangle", "circle", "grid"))
    heading_deg = random.choice((0.0, 90.0, to_thousandth(random.uniform(-180.0, 180.0))))
    speed_m_s = to_thousandth(random.uniform(0.5, 0.98) * fleet.slot_speed_m_s)
    return {"shape": shape, "spacing_m": fleet.spacing_m, "heading_deg": heading_deg, "speed_m_s": speed_m_s}


# ---------------------------------------------------------------- forming


def form_near(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Random starts within several metres of the slots, each vehicle with the slot that suits its start."""
    starts = scattered(random, fleet.size, START_SPACING * fleet.separation_m)
    # So that few straight paths to the slots cross, as an operator would place them.
    fleet.starts_enu_m = assign_slots(fleet.slots_enu_m, starts)
    return FamilyPlan(slow(random, fleet))


def form_far(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The reference begins 10 to 40 m from the starts, at most as far as slots of this speed move in 20 s at full speed."""
    plan = form_near(random, fleet)
    away = direction(random, random.uniform(10.0, min(40.0, 20.0 * fleet.slot_speed_m_s)))
    fleet.starts_enu_m = {i: moved(start, away) for i, start in fleet.starts_enu_m.items()}
    farthest_m = max(dist(start[:2], fleet.slots_enu_m[i][:2]) for i, start in fleet.starts_enu_m.items())
    plan.lasts_s = _with_delays_s(farthest_m, fleet.slot_speed_m_s)
    return plan


def form_crossing(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Vehicles start on each other's places, so that their paths cross."""
    starts = list(fleet.starts_enu_m.values())
    random.shuffle(starts)
    fleet.starts_enu_m = dict(zip(fleet.ids, starts, strict=True))
    way_m = max(dist(start[:2], fleet.slots_enu_m[i][:2]) for i, start in fleet.starts_enu_m.items())
    return FamilyPlan(slow(random, fleet), lasts_s=max(25.0, _with_delays_s(way_m, fleet.slot_speed_m_s)))


def _with_delays_s(way_m: float, speed_m_s: float) -> float:
    """Time for slots that move this far, and for vehicles that make way meanwhile."""
    return to_thousandth(min(10.0 + 1.5 * PEAK_SPEED * way_m / speed_m_s, LONGEST_S))


def hovering(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """A vehicle hovers in the way of the others, which form 6 to 12 m away."""
    away = direction(random, random.uniform(6.0, 12.0))
    out = random.choice(fleet.followers)
    fleet.starts_enu_m = {i: moved(start, away) for i, start in fleet.starts_enu_m.items()}
    others = [start for i, start in fleet.starts_enu_m.items() if i != out]
    share = random.uniform(0.0, 0.9)
    for tried in range(200):
        aside = direction(random, random.uniform(0.0, fleet.spacing_m + 0.02 * tried))
        place = on_grid((away[0] * share + aside[0], away[1] * share + aside[1], 0.0))
        if all(abs(complex(place[0] - x, place[1] - y)) > START_SPACING * fleet.separation_m for x, y, _ in others):
            fleet.starts_enu_m[out] = place
            break
    free = [i for i in fleet.ids if i == out or _is_free(fleet.slots_enu_m[i], fleet.starts_enu_m[out], fleet)]
    return FamilyPlan(point(fleet), stays_out=(out,), expected=free, lasts_s=28.0)


def _is_free(slot_enu_m: Vector3, hovering_enu_m: Vector3, fleet: DrawnFleet) -> bool:
    """Whether a vehicle can be in this slot beside one that hovers and makes no way."""
    return dist(slot_enu_m[:2], hovering_enu_m[:2]) > START_SPACING * fleet.separation_m


def joining(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """One or two vehicles join the fleet in flight."""
    late = tuple(random.sample(fleet.followers, random.choice((1, 2))))
    inside = [start for i, start in fleet.starts_enu_m.items() if i not in late]
    places = scattered(random, len(late), START_SPACING * fleet.separation_m, inside)
    fleet.starts_enu_m |= dict(zip(late, places, strict=True))
    begins_s = to_thousandth(random.uniform(5.0, 9.0))
    steps = [step("form", begins_s, vehicles=[i]) for i in late]
    return FamilyPlan(slow(random, fleet), steps, stays_out=late, slots_from_s=begins_s, lasts_s=30.0)


# ---------------------------------------------------------------- formations


def formation_change(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Two changes of the shape, the second sometimes during the first."""
    first_s = to_thousandth(random.uniform(4.0, 7.0))
    gap_s = to_thousandth(random.choice((2.0, random.uniform(6.0, 9.0))))
    steps = [step("formation", at_s, formation=shape_change(random, fleet)) for at_s in (first_s, first_s + gap_s)]
    return FamilyPlan(slow(random, fleet), steps, slots_from_s=first_s + gap_s, lasts_s=32.0)


def exchange(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Vehicles exchange their slots crosswise: each with the opposite one, or in a random order."""
    own = list(fleet.slots_enu_m.values())
    others = [*own]
    if random.random() < 0.5:
        others.reverse()
    else:
        random.shuffle(others)
    slots = {i: list(slot) for i, slot in zip(fleet.ids, others, strict=True)}
    speed_m_s = to_thousandth(random.uniform(0.5, 0.98) * fleet.slot_speed_m_s)
    change = {"slots_enu_m": slots, "speed_m_s": speed_m_s}
    steps = [step("formation", 5.0, formation=change, timeout_s=ENTERED_WITHIN_S)]
    way_m = max(dist(a, b) for a, b in zip(own, others, strict=True))
    return FamilyPlan(point(fleet), steps, slots_from_s=5.0, lasts_s=max(32.0, _with_delays_s(way_m, speed_m_s)))


def turning(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The formation turns with the course of its reference."""
    radius_m = to_thousandth(random.uniform(5.0, 12.0))
    period_s = to_thousandth(random.uniform(25.0, 60.0))
    kind = random.choice(("circle", "figure_8"))
    size = {"radius_m": radius_m} if kind == "circle" else {"width_m": 2.0 * radius_m, "height_m": radius_m}
    centre = [-radius_m if kind == "circle" else 0.0, 0.0, fleet.height_m]
    reference: Content = {"kind": kind, "centre_enu_m": centre, "period_s": period_s, "ramp_s": 8.0, **size}
    plan = FamilyPlan(reference, turns=True, lasts_s=28.0)
    if random.random() < 0.4:
        change = shape_change(random, fleet)
        plan.steps, plan.slots_from_s = [step("formation", 12.0, formation=change)], 12.0
        plan.lasts_s = max(28.0, 12.0 + _with_delays_s(_way_m(fleet, change), change["speed_m_s"]))
    return plan


def _way_m(fleet: DrawnFleet, change: Content) -> float:
    """The longest way into a slot of a new shape."""
    slots = slots_of(SHAPES[change["shape"]], fleet.size, fleet.spacing_m, radians(change["heading_deg"]))
    assigned_m = assign_slots(fleet.slots_enu_m, slots)
    return max(dist(slot, assigned_m[i]) for i, slot in fleet.slots_enu_m.items())


# ---------------------------------------------------------------- references


def fast(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """A reference near the fastest that the fleet accepts."""
    radius_m = to_thousandth(random.uniform(4.0, 15.0))
    acceleration_m_s2 = random.uniform(1.0, 4.0)
    kind = random.choice(("circle", "figure_8", "waypoints"))
    if kind == "waypoints":
        corners = [(0.0, 0.0)]
        for _ in range(6):
            x, y, _z = moved((*corners[-1], 0.0), direction(random, random.uniform(5.0, 15.0)))
            corners.append((x, y))
        points = [[x, y, fleet.height_m] for x, y in corners]
        speed_m_s = to_thousandth(random.uniform(2.0, 8.0))
        limits = {"max_speed_m_s": speed_m_s, "max_acceleration_m_s2": to_thousandth(acceleration_m_s2)}
        return FamilyPlan({"kind": kind, "points_enu_m": points, **limits}, lasts_s=25.0)
    period_s = to_thousandth(2.0 * pi * (radius_m / acceleration_m_s2) ** 0.5 * (1.0 if kind == "circle" else 1.5))
    size = {"radius_m": radius_m} if kind == "circle" else {"width_m": 2.0 * radius_m, "height_m": radius_m}
    centre = [-radius_m if kind == "circle" else 0.0, 0.0, fleet.height_m]
    return FamilyPlan(
        {"kind": kind, "centre_enu_m": centre, "period_s": max(period_s, 4.0), "ramp_s": 6.0, **size}, lasts_s=25.0
    )


def reference_step(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The reference steps by 5 to 10 m, twice."""
    first = direction(random, random.uniform(5.0, 10.0))
    second = moved(first, direction(random, random.uniform(5.0, 10.0)))
    steps = [
        step("reference", at_s, reference=point(fleet, (x, y, to_thousandth(random.uniform(-0.5, 1.0)))))
        for at_s, (x, y, _) in zip((5.0, 12.0), (first, second), strict=True)
    ]
    return FamilyPlan(point(fleet), steps, slots_from_s=12.0, lasts_s=28.0)


def reference_handover(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """From one moving reference to another, and back to rest."""
    plan = fast(random, fleet)
    plan.reference = slow(random, fleet)
    radius_m = to_thousandth(random.uniform(4.0, 10.0))
    centre = [*direction(random, random.uniform(0.0, 8.0))[:2], fleet.height_m]
    circle = {"kind": "circle", "centre_enu_m": centre, "radius_m": radius_m, "ramp_s": 4.0}
    circle |= {"period_s": to_thousandth(random.uniform(15.0, 40.0)), "clockwise": random.random() < 0.5}
    rest = point(fleet, direction(random, 5.0))
    plan.steps = [step("reference", 4.0, reference=circle), step("reference", 13.0, reference=rest)]
    plan.slots_from_s, plan.lasts_s = 13.0, 30.0
    return plan


# ---------------------------------------------------------------- leaders and leaving


def leader_change(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The leader changes while the reference moves, and sometimes while the formation changes."""
    reference = fast(random, fleet).reference if random.random() < 0.3 else slow(random, fleet)
    steps = [step("lead", 4.0, leaders=[fleet.successor]), step("lead", 9.0, leaders=[fleet.leader])]
    if random.random() < 0.5:
        steps.insert(1, step("formation", 6.0, formation=shape_change(random, fleet)))
    return FamilyPlan(reference, steps, slots_from_s=6.0, lasts_s=24.0)


def leader_leaves(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The leader holds in the middle of the fleet, then lands or stays; its successor continues."""
    steps = [step("hold", 5.0, vehicles=[fleet.leader])]
    if random.random() < 0.6:
        steps.append(step("land", 7.0, vehicles=[fleet.leader]))
    return FamilyPlan(slow(random, fleet), steps, expected=fleet.followers, lasts_s=25.0)


def leader_dies(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The leader's agent ends, and starts again after 2 to 6 s; of PX4, it sometimes never does.

    An ArduCopter without an agent drifts, and no other vehicle knows where it is: the filter cannot avoid it.
    """
    end = {"vehicle": fleet.leader, "at_s": to_thousandth(FORM_S + random.uniform(4.0, 8.0))}
    restarts_after_s = to_thousandth(random.uniform(*RESTARTS_AFTER_S))
    if random.random() >= STAYS_DEAD or fleet.autopilot is AutopilotKind.ARDUPILOT:
        end["restarts_after_s"] = restarts_after_s
    reference = fast(random, fleet).reference if random.random() < 0.5 else slow(random, fleet)
    return FamilyPlan(reference, agent_ends=[end], expected=fleet.followers, lasts_s=24.0)


def returning(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """All vehicles, or some of them, return by their autopilots."""
    some = random.sample(fleet.ids, random.randint(1, fleet.size - 1))
    going = sorted(some) if random.random() < 0.7 else fleet.ids
    expected = [i for i in fleet.ids if i not in going]
    return FamilyPlan(slow(random, fleet), [step("return", 6.0, vehicles=going)], expected=expected, lasts_s=28.0)


def hold_and_land(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Some followers hold or land in the middle of the fleet, which then changes its shape or moves on."""
    going = sorted(random.sample(fleet.followers, random.randint(1, max(1, fleet.size // 3))))
    steps = [step("hold", 4.0, vehicles=going)]
    if random.random() < 0.5:
        steps.append(step("land", 5.0, vehicles=going))
    if random.random() < 0.5:
        steps.append(step("formation", 7.0, formation=shape_change(random, fleet)))
    else:
        steps.append(step("reference", 7.0, reference=point(fleet, direction(random, random.uniform(3.0, 8.0)))))
    expected = [i for i in fleet.ids if i not in going]
    return FamilyPlan(point(fleet), steps, expected=expected, slots_from_s=7.0, lasts_s=28.0)


def partition(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The network splits into two parts and heals; vehicles that hold are commanded to form again."""
    part = sorted(random.sample(fleet.ids, random.randint(1, fleet.size - 1)))
    from_s, lasts_s = random.uniform(4.0, 6.0), random.uniform(0.2, 6.0)
    begins_s, ends_s = to_thousandth(FORM_S + from_s), to_thousandth(FORM_S + from_s + lasts_s)
    split = {"vehicles": part, "from_s": begins_s, "until_s": ends_s}
    steps = [step("form", 16.0)]
    if random.random() < 0.4:
        steps.insert(0, step("formation", to_thousandth(from_s + 0.5), formation=shape_change(random, fleet)))
    return FamilyPlan(slow(random, fleet), steps, partitions=[split], slots_from_s=16.0, lasts_s=30.0)


FENCE_ROOM_M, CEILING_ROOM_M = (2.0, 8.0), (1.5, 4.0)  # beyond all places at which vehicles are to be
OBSTACLE_RADIUS_M, OBSTACLE_AWAY_M = (0.3, 2.0), (2.0, 10.0)


def confine(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    """A fence close round the starts and the slots, and an obstacle. What the fleet cannot fly in it is refused."""
    places = [*fleet.starts_enu_m.values(), *fleet.slots_enu_m.values()]
    room_m = random.uniform(*FENCE_ROOM_M)
    lows = [to_thousandth(min(place[axis] for place in places) - room_m) for axis in (0, 1)]
    highs = [to_thousandth(max(place[axis] for place in places) + room_m) for axis in (0, 1)]
    top_m = fleet.height_m + max(place[2] for place in places) + random.uniform(*CEILING_ROOM_M)
    plan.settings["envelope.fence_min_enu_m"] = [*lows, -1.0]
    plan.settings["envelope.fence_max_enu_m"] = [*highs, to_thousandth(top_m)]
    centre = direction(random, random.uniform(*OBSTACLE_AWAY_M))
    radius_m = to_thousandth(random.uniform(*OBSTACLE_RADIUS_M))
    obstacle = {"kind": "cylinder", "centre_enu_m": list(centre[:2]), "radius_m": radius_m, "top_m": 20.0}
    plan.settings["obstacles"] = [obstacle]


FAMILIES: dict[str, Family] = {
    "formation_change": formation_change,
    "form_near": form_near,
    "form_far": form_far,
    "form_crossing": form_crossing,
    "hovering": hovering,
    "joining": joining,
    "leader_leaves": leader_leaves,
    "leader_dies": leader_dies,
    "leader_change": leader_change,
    "returning": returning,
    "fast": fast,
    "reference_step": reference_step,
    "reference_handover": reference_handover,
    "exchange": exchange,
    "turning": turning,
    "partition": partition,
    "hold_and_land": hold_and_land,
}
"""17 of them: each tenth flight has a runaway vehicle, and 17 and 10 have no common factor."""
