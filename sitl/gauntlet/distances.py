"""True distances of all pairs of a flight, and which of them count."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from msgspec import Struct

from sitl.flight.lockstep import VirtualStandIn

SENSOR_FACTOR = {"ideal": 1.0, "default": 0.8, "px4_sih": 0.6}
"""Share of `separation_m` below which a true distance is a violation, by the sensors of the flight."""


class Closest(Struct, frozen=True, kw_only=True):
    """The smallest distance of a kind of pairs."""

    distance_m: float
    time_s: float
    vehicles: tuple[int, int]


class Distances(Struct, frozen=True, kw_only=True):
    """`commanded`: of pairs where an agent commands the attitude of at least one vehicle.

    `automatic`: of other pairs in the air, which both fly by their autopilots or pilots. None: there were none.
    """

    commanded: Closest | None
    automatic: Closest | None


def distances(stand_ins: Sequence[VirtualStandIn]) -> Distances:
    """Over the whole flight, at 50 Hz."""
    tracks = {s.vehicle_id: s.track() for s in stand_ins}
    commanded = {s.vehicle_id: s.commanded() for s in stand_ins}
    flies = {s.vehicle_id: s.flies() for s in stand_ins}
    closest: dict[bool, Closest | None] = {True: None, False: None}
    for i, j in combinations(sorted(tracks), 2):
        apart_m = np.linalg.norm(tracks[i].position_enu_m - tracks[j].position_enu_m, axis=1)
        either = commanded[i] | commanded[j]
        for kind, counts in ((True, either), (False, ~either & flies[i] & flies[j])):
            if not counts.any():
                continue
            row = int(np.where(counts, apart_m, np.inf).argmin())
            before = closest[kind]
            if before is None or apart_m[row] < before.distance_m:
                time_s = round(float(tracks[i].time_s[row]), 3)
                closest[kind] = Closest(distance_m=round(float(apart_m[row]), 4), time_s=time_s, vehicles=(i, j))
    return Distances(commanded=closest[True], automatic=closest[False])
