"""When the vehicles of a flight reach their slots, by their own reports."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from companion.stability.arrays import FloatArray
from companion.types.flight import FlightPhase
from companion.types.vectors import Vector3
from sitl.flight.virtual_flight import Flown
from sitl.flight.watch import FlightWatch
from sitl.gauntlet.drawn import Drawn
from sitl.report.tracks import Track, reported_track

ARRIVED_M = 0.5
SAMPLE_S = 0.1


class Arrivals(Struct, frozen=True, kw_only=True):
    """`expected`: number of vehicles that were to be in their slots at the end of the flight.

    `not_in_formation`: those of them that were not in formation then; `reached_s`: of each vehicle by id, the time that it took
    to come within ARRIVED_M of its slot and stay there; None where it did not.
    """

    expected: int
    not_in_formation: list[int]
    reached_s: dict[int, float | None]


def arrivals(flight: Drawn, flown: Flown) -> Arrivals:
    """The error of a vehicle is that about the reference; of a follower, the smaller one of that and that about the leader."""
    watch = flown.watch
    out = [i for i in flight.expected if not _in_formation(watch, i)]
    times_s = np.arange(flight.slots_from_s, flown.flight_s - SAMPLE_S, SAMPLE_S)
    present = [i for i in flight.expected if i not in out]
    if not present or len(watch.led_enu_m) < 2 or not times_s.size:
        return Arrivals(expected=len(flight.expected), not_in_formation=out, reached_s=dict.fromkeys(present))
    errors_m = _errors_m(watch, present, times_s)
    return Arrivals(
        expected=len(flight.expected),
        not_in_formation=out,
        reached_s={i: _reached_s(errors_m[i]) for i in present},
    )


def _in_formation(watch: FlightWatch, vehicle_id: int) -> bool:
    status = watch.status(vehicle_id)
    return status is not None and status.phase is FlightPhase.FORMATION


def _errors_m(watch: FlightWatch, ids: list[int], times_s: FloatArray) -> dict[int, FloatArray]:
    slots = watch.slots()
    centre = _track(watch.led_enu_m).at(times_s)
    about = {i: _track(watch.reported[i]).at(times_s) - slots[i].at(times_s) for i in ids}
    return {i: np.linalg.norm(about[i] - centre, axis=1) for i in ids}


def _track(reported: list[tuple[float, Vector3]]) -> Track:
    return reported_track(0, reported)


def _reached_s(error_m: FloatArray) -> float | None:
    """Time after which the error stays within ARRIVED_M."""
    late = np.flatnonzero(error_m > ARRIVED_M)
    if late.size and late[-1] == error_m.size - 1:
        return None
    return round(float(late[-1] + 1) * SAMPLE_S, 2) if late.size else 0.0
