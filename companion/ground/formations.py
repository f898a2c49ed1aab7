"""From a formation's name to a command for every vehicle: which slots, whose is which, when and for how long."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import radians

import numpy as np
from scipy.optimize import linear_sum_assignment

from companion.geometry.curves import duration_s
from companion.geometry.shapes import SHAPES, slots_of
from companion.geometry.transition import longest_way_m
from companion.types import FormationChange, Status, Vector3

AHEAD_S = 1.0  # from the command to the first movement: time for every vehicle to get it
MAX_ACCELERATION_M_S2 = 1.0  # of a slot


def named_slots(shape: str, n: int, spacing_m: float, heading_deg: float) -> list[Vector3]:
    """Raises KeyError for a name that is none of SHAPES."""
    return slots_of(SHAPES[shape], n, spacing_m, radians(heading_deg))


def assigned(flown_enu_m: Mapping[int, Vector3], slots_enu_m: Sequence[Vector3]) -> dict[int, Vector3]:
    """A slot for each vehicle, with the least sum of squared distances: then no two straight ways cross (see transition.py)."""
    ids = sorted(flown_enu_m)
    cost_m2 = [
        [sum((a - b) ** 2 for a, b in zip(flown_enu_m[i], slot, strict=True)) for slot in slots_enu_m] for i in ids
    ]
    _, chosen = linear_sum_assignment(np.array(cost_m2))
    return {vehicle_id: slots_enu_m[place] for vehicle_id, place in zip(ids, chosen.tolist(), strict=True)}


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


def fleet_time_s(statuses: Sequence[Status]) -> float:
    """How far into the RFT the fleet is, by what these vehicles last said; it stands while no leader is in formation."""
    return max(status.reference_s for status in statuses)
