"""Families of flights in which something fails or is extreme: the kinds of flights in which vehicles once came too close.

Vehicles that leave a moving formation, split networks, late telemetry, lost GPS, shared homes and settings at their bounds.
Most take what else happens from the other families. `combined` has several of them at once; only the search flies it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from random import Random

from companion.types.autopilot import AutopilotKind
from sitl.gauntlet.families import (
    FAMILIES,
    FORM_S,
    Content,
    Family,
    FamilyPlan,
    confine,
    exchange,
    fast,
    form_crossing,
    formation_change,
    leader_change,
    reference_handover,
    reference_step,
    slow,
    step,
    turning,
)
from sitl.gauntlet.fleets import DrawnFleet, direction, moved, to_thousandth
from sitl.gauntlet.liars import LIARS

ALL_HOVER_S = FORM_S - 1.0  # armed by now: arming sets the home again
ALL_APART = 0.25  # of the splits: no vehicle receives any other one
FORMS_AGAIN_AFTER_S = 3.0  # of a split


def at(after_s: float) -> float:
    """Time of the flight, this long after FORM_S."""
    return to_thousandth(FORM_S + after_s)


# ---------------------------------------------------------------- leaving in motion


def hold_in_motion(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """One or two vehicles leave a moving formation: they hold, land, return, a pilot takes over, or the battery is low."""
    way = direction(random, random.uniform(15.0, 40.0))
    points = [[0.0, 0.0, fleet.height_m], [way[0], way[1], fleet.height_m]]
    speed_m_s = to_thousandth(random.uniform(0.8, 3.0))
    acceleration_m_s2 = to_thousandth(random.uniform(0.4, 1.5))
    limits = {"max_speed_m_s": speed_m_s, "max_acceleration_m_s2": acceleration_m_s2}
    plan = FamilyPlan({"kind": "waypoints", "points_enu_m": points, **limits}, lasts_s=32.0, judges_hand_over=True)
    first_s, gap_s = random.uniform(3.5, 9.0), random.choice((0.0, random.uniform(0.3, 2.0)))
    leaving = random.sample(fleet.ids, random.choice((1, 1, 2)))
    leave = random.choice(LEAVE)
    for index, vehicle_id in enumerate(leaving):
        leave(random, plan, vehicle_id, to_thousandth(first_s + index * gap_s))
    plan.expected = [i for i in fleet.ids if i not in leaving]
    return plan


def _commanded(command: str) -> Callable[[Random, FamilyPlan, int, float], None]:
    def leave(_random: Random, plan: FamilyPlan, vehicle_id: int, after_s: float) -> None:
        plan.steps.append(step(command, after_s, vehicles=[vehicle_id], timeout_s=0.3))

    return leave


def _piloted(random: Random, plan: FamilyPlan, vehicle_id: int, after_s: float) -> None:
    """The pilot brakes, or flies on slowly in any direction."""
    velocity = direction(random, random.choice((0.0, random.uniform(0.2, 1.5))))
    pilot = {"vehicle": vehicle_id, "at_s": at(after_s), "velocity_enu_m_s": list(velocity)}
    plan.stand_in.setdefault("pilots", []).append(pilot)


def _low_battery(random: Random, plan: FamilyPlan, vehicle_id: int, after_s: float) -> None:
    plan.settings["leave_below_percent"] = 30.0
    plan.settings["low_battery_action"] = random.choice(("hold", "return", "land"))
    level = {"vehicle": vehicle_id, "at_s": at(after_s), "percent": 20}
    plan.stand_in.setdefault("batteries", []).append(level)


# ---------------------------------------------------------------- split networks


def split_in_exchange(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The network splits for 1.5 to 4.8 s while vehicles exchange their slots crosswise."""
    plan = exchange(random, fleet)
    return _split(random, fleet, plan, random.uniform(5.5, 11.0), random.uniform(1.5, 4.8))


def short_split(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The network splits for 1 to 2 s while a formation or reference changes, turns or is fast, or vehicles form."""
    situations = (formation_change, form_crossing, turning, fast, leader_change, reference_step, reference_handover)
    plan = random.choice(situations)(random, fleet)
    return _split(random, fleet, plan, random.uniform(1.0, 14.0), random.uniform(1.0, 2.0))


def _split(random: Random, fleet: DrawnFleet, plan: FamilyPlan, from_s: float, lasts_s: float) -> FamilyPlan:
    """The plan with a network that splits into two parts, or into all vehicles. Those that hold are commanded to form again."""
    part = sorted(random.sample(fleet.ids, random.randint(1, fleet.size - 1)))
    parts = [[vehicle_id] for vehicle_id in fleet.ids] if random.random() < ALL_APART else [part]
    lost = random.choice(("both", "both", "received", "sent"))
    plan.judges_hand_over = True
    plan.partitions += [
        {"vehicles": each, "from_s": at(from_s), "until_s": at(from_s + lasts_s), "lost": lost} for each in parts
    ]
    last_s = max((one["at_s"] - FORM_S for one in plan.steps), default=0.0)
    again_s = to_thousandth(max(from_s + lasts_s, last_s) + FORMS_AGAIN_AFTER_S)
    plan.steps.append(step("form", again_s))
    plan.slots_from_s = again_s
    plan.lasts_s = to_thousandth(max(plan.lasts_s, again_s + 12.0))
    return plan


# ---------------------------------------------------------------- telemetry and positions


def late_telemetry(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """The telemetry of one or two vehicles arrives 0.1 to 1 s late for some seconds."""
    plan = _something(random, fleet)
    _delay_telemetry(random, fleet, plan)
    return plan


def _delay_telemetry(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    plan.judges_hand_over = True
    late = random.sample(fleet.ids, random.choice((1, 1, 2)))
    plan.links["late_telemetry"] = [_late(random, vehicle_id) for vehicle_id in late]
    _expect_without(fleet, plan, late)


def _late(random: Random, vehicle_id: int) -> Content:
    from_s, lasts_s = random.uniform(1.0, 12.0), random.uniform(1.0, 10.0)
    delay_s = to_thousandth(random.uniform(0.1, 1.0))
    return {"vehicle": vehicle_id, "from_s": at(from_s), "until_s": at(from_s + lasts_s), "delay_s": delay_s}


def lost_gps(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """One vehicle loses GPS in flight and dead-reckons, until it has landed or for some seconds."""
    plan = _something(random, fleet)
    _lose_gps(random, fleet, plan)
    return plan


def _lose_gps(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    """Of a vehicle without a pilot: no other one knows where a piloted vehicle without GPS flies."""
    plan.judges_hand_over = True
    piloted = {pilot["vehicle"] for pilot in plan.stand_in.get("pilots", ())}
    lost = random.choice([i for i in fleet.ids if i not in piloted])
    from_s = random.uniform(1.0, 12.0)
    loss: Content = {"vehicle": lost, "at_s": at(from_s), "receiver": random.choice(("silent", "jammed"))}
    loss["drift_enu_m_s2"] = list(direction(random, random.uniform(0.02, 0.08)))
    if random.random() < 0.4:
        loss["until_s"] = at(from_s + random.uniform(1.0, 10.0))
    plan.stand_in["position_losses"] = [loss]
    _expect_without(fleet, plan, [lost])


def _something(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """A flight in which all vehicles are in formation, and move."""
    situations = (formation_change, form_crossing, exchange, turning, fast, reference_step, reference_handover)
    return random.choice(situations)(random, fleet)


def _expect_without(fleet: DrawnFleet, plan: FamilyPlan, out: Collection[int]) -> None:
    """These vehicles need not be in their slots at the end."""
    before = fleet.ids if plan.expected is None else plan.expected
    plan.expected = [i for i in before if i not in out]


# ---------------------------------------------------------------- homes


def shared_home(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Vehicles are to return at once or in turn, where a ground station has set homes, which some of them share."""
    plan = FamilyPlan(slow(random, fleet), lasts_s=50.0, judges_hand_over=True)
    place = direction(random, random.uniform(0.0, 15.0))
    changed = random.sample(fleet.ids, random.randint(2, fleet.size))
    apart_m = random.choice((0.0, 0.8, 1.5)) * fleet.separation_m
    homes = {i: moved(place, direction(random, random.uniform(0.0, apart_m))) for i in changed}
    plan.stand_in["homes"] = [
        {"vehicle": i, "at_s": ALL_HOVER_S, "position_enu_m": list(home)} for i, home in homes.items()
    ]
    if random.random() < 0.2:
        rally = moved(place, direction(random, 5.0))
        plan.stand_in["rally_points"] = [{"vehicle": changed[0], "position_enu_m": list(rally)}]
    going = sorted(random.sample(fleet.ids, random.randint(2, fleet.size)))
    gap_s = random.choice((0.0, random.uniform(0.3, 3.0)))
    groups = [going] if gap_s == 0.0 else [[i] for i in going]
    plan.steps = [
        step("return", 6.0 + k * gap_s, vehicles=group, timeout_s=max(gap_s, 0.3)) for k, group in enumerate(groups)
    ]
    plan.expected = [i for i in fleet.ids if i not in going]
    return plan


# ---------------------------------------------------------------- settings

BOUNDS: dict[str, tuple[float, ...]] = {
    "peers.max_age_s": (0.05, 0.1, 0.2, 0.3),
    "peers.leader_beacon_max_age_s": (0.1, 1.0, 10.0),
    "envelope.max_tilt_rate_deg_s": (10.0, 20.0, 50.0, 90.0, 1000.0),
    "envelope.max_tilt_deg": (3.0, 5.0, 10.0, 45.0),
    "envelope.max_speed_m_s": (0.5, 2.0, 20.0),
    "envelope.max_climb_m_s": (0.5, 15.0),
    "envelope.max_descent_m_s": (0.5, 15.0),
    "envelope.min_thrust_ratio": (0.05, 0.6, 0.95),
    "envelope.max_thrust_ratio": (1.05, 1.2, 4.0),
    "envelope.max_thrust_rate_1_s": (0.5, 2.0, 100.0),
    "envelope.clearance_m": (0.0, 5.0),
    "law.disturbance_bandwidth_1_s": (0.0, 5.0),
    "law.velocity_correction_1_s": (0.0, 10.0),
    "hand_over_speed_m_s": (0.2, 10.0),
    "hand_over_acceleration_m_s2": (0.1, 4.0),
}
"""From the smallest to the largest values. Those that a check refuses are drawn again, so the extremes that it accepts are
flown."""


def settings_at_bounds(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """One to three settings of the fleet have the smallest or largest values that the checks accept."""
    if random.random() < 0.15 and fleet.own is None:
        fleet.separation_m = fleet.spacing_m  # as far as the slots are apart
    plan = _something(random, fleet)
    _set_to_bounds(random, fleet, plan)
    if random.random() < 0.3:
        plan = _split(random, fleet, plan, random.uniform(1.0, 14.0), random.uniform(1.0, 2.0))
    return plan


def _set_to_bounds(random: Random, _fleet: DrawnFleet, plan: FamilyPlan) -> None:
    for key in random.sample(list(BOUNDS), random.choice((1, 2, 3))):
        plan.settings[key] = random.choice(BOUNDS[key])


# ---------------------------------------------------------------- several at once

WIND_M_S, GUST_SD_M_S, GUST_TIME_S = 6.0, 1.5, (0.5, 4.0)


def combined(random: Random, fleet: DrawnFleet) -> FamilyPlan:
    """Two to four things happen in one flight: splits, vehicles that leave, late telemetry, lost GPS, wind, bounds, walls."""
    plan = _something(random, fleet)
    for happens in random.sample(DISTURBANCES, random.choice((2, 3, 4))):
        happens(random, fleet, plan)
    fit_to_wind(fleet, plan)
    return plan


def fit_to_wind(fleet: DrawnFleet, plan: FamilyPlan) -> None:
    """Without what no vehicle can fly in a wind."""
    if "wind" in plan.stand_in:
        plan.settings.pop("envelope.max_tilt_deg", None)  # with a small tilt no vehicle stays in a wind
        if fleet.autopilot is AutopilotKind.ARDUPILOT:
            plan.links.pop("late_telemetry", None)  # it levels, and drifts unheard with the wind


def _split_network(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    _split(random, fleet, plan, random.uniform(1.0, 14.0), random.uniform(1.0, 4.8))


def _lose_vehicle(random: Random, fleet: DrawnFleet, plan: FamilyPlan) -> None:
    plan.judges_hand_over = True
    lost = {loss["vehicle"] for loss in plan.stand_in.get("position_losses", ())}
    vehicle_id = random.choice([i for i in fleet.ids if i not in lost])
    LEAVE[random.randrange(len(LEAVE))](random, plan, vehicle_id, to_thousandth(random.uniform(1.0, 14.0)))
    _expect_without(fleet, plan, [vehicle_id])


def _blow(random: Random, _fleet: DrawnFleet, plan: FamilyPlan) -> None:
    mean = direction(random, random.uniform(0.0, WIND_M_S))
    gusts = {"gust_sd_m_s": random.uniform(0.0, GUST_SD_M_S), "gust_time_s": random.uniform(*GUST_TIME_S)}
    plan.stand_in["wind"] = {"mean_enu_m_s": list(mean), **{key: to_thousandth(value) for key, value in gusts.items()}}


LEAVE = (_commanded("hold"), _commanded("land"), _commanded("return"), _piloted, _low_battery)
DISTURBANCES = (_split_network, _lose_vehicle, _delay_telemetry, _lose_gps, _blow, _set_to_bounds, confine)

FAULTS: dict[str, Family] = {
    "hold_in_motion": hold_in_motion,
    "split_in_exchange": split_in_exchange,
    "short_split": short_split,
    "late_telemetry": late_telemetry,
    "lost_gps": lost_gps,
    "shared_home": shared_home,
    "settings_at_bounds": settings_at_bounds,
}
"""7 of them, which has no factor in common with the 10 of the runaways either."""

ALL_FAMILIES = FAMILIES | FAULTS | LIARS
COMBINED = combined.__name__
