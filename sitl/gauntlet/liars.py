"""Families of flights in which admitted vehicles say false things of themselves: all that a lie holds is drawn.

The liars fly as their agents do, by the truth. No other vehicle knows where they really are: distances to them do not count.
"""

from __future__ import annotations

from math import exp, log
from random import Random

from companion.types.flight import FlightPhase
from sitl.gauntlet.families import (
    FORM_S,
    Content,
    Family,
    FamilyPlan,
    confine,
    exchange,
    fast,
    form_crossing,
    formation_change,
    hold_and_land,
    joining,
    leader_change,
    slow,
    turning,
)
from sitl.gauntlet.fleets import DrawnFleet, direction, moved, to_thousandth

NUMBERS: dict[str, tuple[float, ...]] = {
    "prc": (-3.0, -1.0, 1.0, 4.0),
    "epoch": (1.0, 2.0, 7.0, 1000.0),
    "claim": (1.0, 2.0),
    "stamp": (-5000.0, -100.0, 250.0, 100_000.0),
    "mission_time": (-20.0, -1.0, 1.0, 20.0),
    "heading": (-1.5, -0.3, 0.5, 3.0),
    "sequence": (-100.0, -1.0, 1.0, 1000.0),
    "age": (0.05, 0.1, 0.2, 2.0),
    "sent": (-1.0, -0.1, 0.1, 1.0),
    "error": (0.0, 1.0, 5.0, 50.0),
    "formation": (1.0, 2.0, 5.0),
}
"""What is false in single numbers, and by how much."""
VECTORS_MOST = {"velocity": 12.0, "acceleration": 15.0, "slot": 10.0, "rft": 20.0}
FROM_S, LASTS_S, OVER_S = (0.5, 15.0), (0.5, 15.0), (0.4, 12.0)
POSITION_M = (0.3, 15.0)
KINDS = ("constant", "drift", "jump", "swing", "mirror", "frozen")
PHASES = tuple(FlightPhase)


def liar(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """A vehicle says false things of itself: while it hovers, forms, joins, exchanges slots, changes the leader or lands."""
    return _with_liars(random, fleet, 1)


def two_liars(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Two vehicles say false things of themselves in one flight, often at once."""
    return _with_liars(random, fleet, 2)


def _hovers(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    return FamilyPlan(slow(random, fleet))


SITUATIONS: tuple[Family, ...] = (
    _hovers,
    exchange,
    joining,
    leader_change,
    hold_and_land,
    formation_change,
    form_crossing,
    turning,
    fast,
)


def _with_liars(random: Random, fleet: DrawnFleet, count: int) -> FamilyPlan:
    liars, situation = random.sample(fleet.ids, count), random.choice(SITUATIONS)
    begins_s, lies_of_each, confined = random.uniform(*FROM_S), random.choice((1, 1, 2)), random.random() < 0.5
    lies = [_lie(random, fleet, vehicle_id, begins_s) for vehicle_id in liars for _ in range(lies_of_each)]
    plan = situation(random, fleet)
    if confined:
        confine(random, fleet, plan)
    plan.links["lies"] = lies
    plan.expected = []  # followers of a liar are off their slots
    return plan


def _lie(random: Random, fleet: DrawnFleet, vehicle_id: int, begins_s: float) -> Content:
    from_s = FORM_S + begins_s + random.choice((0.0, random.uniform(0.0, 3.0)))
    lie: Content = {"vehicle": vehicle_id, "from_s": to_thousandth(from_s)}
    lie["until_s"] = to_thousandth(from_s + random.uniform(*LASTS_S))
    lie["over_s"] = to_thousandth(_between(random, OVER_S))
    return lie | random.choice((_position, _position, _position, _vector, _vector, _number, _word))(
        random, fleet, vehicle_id
    )


def _between(random: Random, bounds: tuple[float, float]) -> float:
    """Small ones are as probable as large ones."""
    low, high = bounds
    return low * exp(log(high / low) * random.random())


def _towards(random: Random, size: float) -> list[float]:
    """Level, or straight up or down."""
    level, way = direction(random, size), random.random()
    return list(level) if way < 0.5 else [0.0, 0.0, to_thousandth(size if way < 0.75 else -size)]


def _position(random: Random, fleet: DrawnFleet, vehicle_id: int) -> Content:
    """A position with the velocity that belongs to it; also one that comes upon another vehicle from any side."""
    size_m = _between(random, POSITION_M)
    lie: Content = {"says": "position", "by_enu": _towards(random, size_m)}
    if random.random() < 0.3:
        other = random.choice([i for i in fleet.ids if i != vehicle_id])
        short_m = random.choice((0.0, 0.5, 1.0, 2.0)) * fleet.separation_m
        return lie | {"kind": "chase", "other": other, "by_enu": _towards(random, short_m)}
    return lie | {"kind": random.choice(KINDS)}


def _vector(random: Random, _fleet: DrawnFleet, _vehicle_id: int) -> Content:
    says = random.choice(tuple(VECTORS_MOST))
    by_enu = _towards(random, _between(random, (0.1, VECTORS_MOST[says])))
    return {"says": says, "kind": random.choice(KINDS), "by_enu": by_enu}


def _number(random: Random, _fleet: DrawnFleet, _vehicle_id: int) -> Content:
    says = random.choice(tuple(NUMBERS))
    return {
        "says": says,
        "kind": random.choice(("constant", "drift", "jump", "frozen")),
        "by": random.choice(NUMBERS[says]),
    }


def _word(random: Random, fleet: DrawnFleet, vehicle_id: int) -> Content:
    says = random.choice(("phase", "leader", "disarmed", "lost"))
    lie: Content = {"says": says}
    if says == "phase":
        lie["phase"] = str(random.choice(PHASES))
    if says == "lost":
        other = random.choice([i for i in fleet.ids if i != vehicle_id])
        place = moved(fleet.slots_enu_m[other], direction(random, random.uniform(0.0, 3.0)))
        lie |= {"other": other, "by_enu": [place[0], place[1], fleet.height_m]}
    return lie


LIARS: dict[str, Family] = {"liar": liar, "two_liars": two_liars}
