"""When the vehicles of a flight reach their slots, by their own reports."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.stability.arrays import FloatArray
from companion.types.flight import FlightPhase
from companion.types.values import Vector3
from sitl.flight.virtual_flight import Flown
from sitl.flight.watch import FlightWatch
from sitl.gauntlet.drawn import Drawn
from sitl.report.tracks import Track, reported_track

WITHIN_M = {"ideal": 0.5, "default": 0.5, "px4_sih": 1.0}
"""Error of a vehicle in its slot, by the sensors of the flight: with `px4_sih` the attitude error alone moves it by 0.5 m."""
SAMPLE_S = 0.1
SETTLED = 20  # samples in its slot in a row, until a vehicle has reached it
RESTS_WITHIN_M = 0.1  # of its last place: from then on the reference rests


class SlotArrivals(Struct, frozen=True, kw_only=True):
    """`expected`: number of vehicles that were to be in their slots at the end of the flight.

    `not_in_formation`: those of them that were not in formation then; `reached_s`: of each other vehicle by id, the time that
    it took to its slot; None where it was not in it at the end.
    """

    expected: int
    not_in_formation: list[int]
    reached_s: dict[int, float | None]


def arrivals(flight: Drawn, flown: Flown) -> SlotArrivals:
    """A vehicle is in its slot where the slot and a reference that comes to rest move no more, and its error is small."""
    watch = flown.watch
    out = [i for i in flight.expected if not _in_formation(watch, i)]
    times_s = np.arange(flight.slots_from_s, flown.flight_s - SAMPLE_S, SAMPLE_S)
    present = [i for i in flight.expected if i not in out]
    reached_s: dict[int, float | None] = dict.fromkeys(present)
    if present and len(watch.led_enu_m) > 1 and times_s.size:
        within_m = WITHIN_M[str(flight.scenario.stand_in.sensors)]
        rests_from_s = reference_rests_from_s(_track(watch.led_enu_m).at(times_s), times_s)
        for i, errors_m in _errors_m(watch, present, times_s).items():
            from_s = max(rests_from_s, watch.slot_moved_s.get(i, 0.0))
            reached_s[i] = settled_s((errors_m <= within_m) & (times_s >= from_s))
    return SlotArrivals(expected=len(flight.expected), not_in_formation=out, reached_s=reached_s)


def _in_formation(watch: FlightWatch, vehicle_id: int) -> bool:
    status = watch.status(vehicle_id)
    return status is not None and status.phase is FlightPhase.FORMATION


def _errors_m(watch: FlightWatch, ids: list[int], times_s: FloatArray) -> dict[int, FloatArray]:
    """The smaller one of the errors about the reference and about the median of the fleet, which lags behind a fast one."""
    slots = watch.slots()
    about = {i: _track(watch.reported[i]).at(times_s) - slots[i].at(times_s) for i in ids}
    reference, fleet = _track(watch.led_enu_m).at(times_s), np.median(list(about.values()), axis=0)
    return {
        i: np.minimum(np.linalg.norm(own - reference, axis=1), np.linalg.norm(own - fleet, axis=1))
        for i, own in about.items()
    }


def _track(reported: list[tuple[float, Vector3]]) -> Track:
    return reported_track(0, reported)


def reference_rests_from_s(reference_enu_m: FloatArray, times_s: FloatArray) -> float:
    """Time from which the reference, shape (samples, 3), stays at its last place; the first time if it moves to the end.

    A fleet that follows its reference has small errors on all of the way, also while the reference goes to its place.
    """
    moves = np.flatnonzero(np.linalg.norm(reference_enu_m - reference_enu_m[-1], axis=1) > RESTS_WITHIN_M)
    if not moves.size or moves[-1] >= times_s.size - SETTLED:
        return float(times_s[0])
    return float(times_s[moves[-1] + 1])


def settled_s(in_slot: NDArray[np.bool_]) -> float | None:
    """Time from which the vehicle is in its slot for SETTLED samples in a row; None where it is not at the end."""
    if in_slot.size < SETTLED:
        return None
    settled = np.flatnonzero(np.convolve(in_slot, np.ones(SETTLED), "valid") == SETTLED)
    if not settled.size or settled[-1] < in_slot.size - SETTLED:
        return None
    return round(float(settled[0]) * SAMPLE_S, 2)
