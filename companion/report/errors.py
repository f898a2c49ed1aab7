"""Errors to the slots as the ground defines them: |(x_i - d_i0) - r|, with the leader's reference at that time."""

from __future__ import annotations

import numpy as np

from companion.report.arrays import Bools, Floats
from companion.report.distances import sampled
from companion.report.flight import FlightRecords, VehicleLog
from companion.types.flight import FlightPhase


def errors_to_slot_m(flight: FlightRecords) -> dict[int, Floats]:
    """Per vehicle and tick (n,): NaN on the ground and where no leader has a reference."""
    return {vehicle.vehicle_id: _error_m(flight, vehicle) for vehicle in flight.vehicles}


def in_formation(vehicle: VehicleLog) -> Bools:
    """Per tick: the errors that count for the largest and the mean error."""
    return np.asarray(vehicle.ticks.phase == FlightPhase.FORMATION, dtype=np.bool_)


def _error_m(flight: FlightRecords, vehicle: VehicleLog) -> Floats:
    ticks = vehicle.ticks
    flown_reference_enu_m = ticks.position_enu_m - ticks.slot_offset_enu_m
    error_m = np.linalg.norm(flown_reference_enu_m - _reference_enu_m(flight, vehicle), axis=1)
    return np.where(vehicle.in_air(), error_m, np.nan)


def _reference_enu_m(flight: FlightRecords, vehicle: VehicleLog) -> Floats:
    """Per tick (n, 3): the own reference, else that of the known leader, else of any leader."""
    ticks = vehicle.ticks
    reference = ticks.reference_enu_m.copy()
    others = {
        other.vehicle_id: sampled(other, other.ticks.reference_enu_m, ticks.time_s)
        for other in flight.vehicles
        if other is not vehicle
    }
    for other_id, theirs in others.items():
        rows = np.isnan(reference[:, 0]) & (ticks.leader_id == other_id)
        reference[rows] = theirs[rows]
    for theirs in others.values():
        rows = np.isnan(reference[:, 0])
        reference[rows] = theirs[rows]
    return reference
