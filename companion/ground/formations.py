"""From a formation's name to a command for every vehicle: which slots, whose is which, when and for how long."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import radians

import numpy as np
from scipy.optimize import linear_sum_assignment

from companion.arguments import COMMAND_LINE
from companion.config.fleet import FleetConfig
from companion.config.slots import load_slots
from companion.config_file import ConfigError
from companion.fleet_where_options import FormationWish
from companion.geometry.curves import duration_s
from companion.geometry.shapes import SHAPES, slots_of, turned
from companion.geometry.transition import ROUNDING_M, closest, longest_way_m
from companion.ground.fleet_time import AHEAD_S, fleet_time_s
from companion.types import FlightPhase, FormationChange, Status, Vector3

MAX_ACCELERATION_M_S2 = 1.0  # of a slot


def named_slots(shape: str, n: int, spacing_m: float, heading_deg: float) -> list[Vector3]:
    """Raises KeyError for a name that is none of SHAPES."""
    return slots_of(SHAPES[shape], n, spacing_m, radians(heading_deg))


def check_wish(wish: FormationWish, fleet: FleetConfig) -> None:
    """What can be said of it before any vehicle is heard. Raises ConfigError."""
    if wish.shape and wish.slots_file:
        raise ConfigError(COMMAND_LINE, "--slots", f"is a formation of its own; expected it, or {wish.shape}, not both")
    if bool(wish.shape) is (wish.spacing_m is None):
        raise ConfigError(COMMAND_LINE, "--spacing", "goes with a SHAPE, and with nothing else")
    if wish.slots_file:
        load_slots(wish.slots_file, fleet)
    elif not wish.shape and wish.scale == 1.0 and wish.heading_deg == 0.0:
        raise ConfigError(
            COMMAND_LINE, "SHAPE", "missing; expected one, --slots FILE, or --scale or --heading of what is flown"
        )


def wished_slots(wish: FormationWish, statuses: Sequence[Status], fleet: FleetConfig) -> dict[int, Vector3]:
    """Whose slot is where: a file's and those flown stay whose they are, a shape's are assigned. Raises ConfigError."""
    if wish.shape and wish.spacing_m is not None:
        slots = named_slots(wish.shape, len(statuses), wish.spacing_m * wish.scale, wish.heading_deg)
        return assigned(places_enu_m(statuses), slots)
    flown_enu_m = {status.vehicle_id: status.slot.position_enu_m for status in statuses}
    slots_enu_m = load_slots(wish.slots_file, fleet) if wish.slots_file else flown_enu_m
    return {i: turned(slot, radians(wish.heading_deg), wish.scale) for i, slot in slots_enu_m.items()}


def places_enu_m(statuses: Sequence[Status]) -> dict[int, Vector3]:
    """Where the vehicles are in the formation's frame: by the slots that they fly, or before a formation by their places.

    Places are about no RFT, which changes neither who is nearest to which slot nor how near two come to each other.
    """
    if any(status.phase is FlightPhase.FORMATION for status in statuses):
        return {status.vehicle_id: status.slot.position_enu_m for status in statuses}
    return {status.vehicle_id: turned(status.position_enu_m, -status.heading.angle_rad, 1.0) for status in statuses}


def assigned(flown_enu_m: Mapping[int, Vector3], slots_enu_m: Sequence[Vector3]) -> dict[int, Vector3]:
    """A slot for each vehicle, with the least sum of squared distances: then no two straight ways cross (see transition.py)."""
    ids = sorted(flown_enu_m)
    cost_m2 = [
        [sum((a - b) ** 2 for a, b in zip(flown_enu_m[i], slot, strict=True)) for slot in slots_enu_m] for i in ids
    ]
    _, chosen = linear_sum_assignment(np.array(cost_m2))
    return {vehicle_id: slots_enu_m[place] for vehicle_id, place in zip(ids, chosen.tolist(), strict=True)}


def refusal_of(
    slots_enu_m: Mapping[int, Vector3], flown_enu_m: Mapping[int, Vector3], separation_m: float
) -> str | None:
    """Why the vehicles would not go there from what they fly: none is asked then."""
    distance_m, i, j = closest(flown_enu_m, slots_enu_m)
    if distance_m >= separation_m - ROUNDING_M:
        return None
    return (
        f"the slots of vehicles {i} and {j} come within {distance_m:.2f} m of each other, on the way or there;"
        f" expected at least separation_m, {separation_m:g} m"
    )


def change_to(slots_enu_m: Mapping[int, Vector3], statuses: Sequence[Status], slot_speed_m_s: float) -> FormationChange:
    """A command for all vehicles that the statuses are of, in the next number and soon by the fleet's own time."""
    flown = {status.vehicle_id: status.slot.position_enu_m for status in statuses}
    lasts_s = duration_s(longest_way_m(flown, slots_enu_m), slot_speed_m_s, MAX_ACCELERATION_M_S2)
    return FormationChange(
        number=max(status.slot.waiting for status in statuses) + 1,
        slots_enu_m=tuple(sorted(slots_enu_m.items())),
        begins_s=fleet_time_s(statuses) + AHEAD_S,
        lasts_s=max(lasts_s, 0.1),
    )
