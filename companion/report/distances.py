"""Distances between vehicles, in the metric of `separation_m` (a metre of height counts half), and errors to the slots."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from companion.geometry.formations import HEIGHT_WEIGHT
from companion.report.flight import Bools, FlightRecords, Floats, VehicleLog
from companion.types.flight import FlightPhase

GRID_S = 0.02
LONGEST_GAP_S = 0.5  # across a longer gap of a recording there is no position


@dataclass(frozen=True, slots=True)
class TimeGrid:
    """Positions of all vehicles at common times (n,): (n, 3) by vehicle id, NaN where there is none."""

    time_s: Floats
    position_enu_m: dict[int, Floats]
    in_air: dict[int, Bools]


@dataclass(frozen=True, slots=True)
class PairDistance:
    """Distance of a pair over the grid (n,). `judged`: both vehicles are in the air. `smallest_m` is NaN if they never are."""

    pair: tuple[int, int]
    time_s: Floats
    distance_m: Floats
    judged: Bools

    @property
    def smallest_m(self) -> float:
        return float(np.nanmin(self.distance_m, where=self.judged, initial=np.inf)) if self.judged.any() else np.nan

    @property
    def smallest_at_s(self) -> float:
        return float(self.time_s[int(np.nanargmin(np.where(self.judged, self.distance_m, np.inf)))])


def grid_of(flight: FlightRecords) -> TimeGrid:
    """Positions every 20 ms, interpolated between the ticks of each vehicle."""
    vehicles = [vehicle for vehicle in flight.vehicles if vehicle.ticks.time_s.size]
    if not vehicles:
        return TimeGrid(np.empty(0), {}, {})
    ends_s = max(float(vehicle.ticks.time_s[-1]) for vehicle in vehicles)
    time_s = np.arange(0.0, ends_s + GRID_S / 2.0, GRID_S)
    positions = {vehicle.vehicle_id: sample_at(vehicle, vehicle.ticks.position_enu_m, time_s) for vehicle in vehicles}
    in_air = {vehicle.vehicle_id: vehicle.in_air_at(time_s) for vehicle in vehicles}
    return TimeGrid(time_s, positions, in_air)


def sample_at(vehicle: VehicleLog, values: Floats, time_s: Floats) -> Floats:
    """Values of the ticks (m, k) at other times (n, k), linear in between; NaN before, after and in long gaps."""
    own_s = vehicle.ticks.time_s
    if own_s.size < 2:
        return np.full((time_s.size, values.shape[1]), np.nan)
    columns = [np.interp(time_s, own_s, column, left=np.nan, right=np.nan) for column in values.T]
    return np.where(_near(own_s, time_s)[:, None], np.stack(columns, axis=1), np.nan)


def _near(own_s: Floats, time_s: Floats) -> Bools:
    """Whether each time (n,) lies between two samples that are at most LONGEST_GAP_S apart."""
    after = np.clip(np.searchsorted(own_s, time_s, side="left"), 1, own_s.size - 1)
    return np.asarray(own_s[after] - own_s[after - 1] <= LONGEST_GAP_S, dtype=np.bool_)


def pair_distances(flight: FlightRecords, grid: TimeGrid) -> list[PairDistance]:
    """Of every pair, the one that came nearest first."""
    weights = np.array([1.0, 1.0, 0.0 if _keeps_altitudes(flight) else HEIGHT_WEIGHT])
    pairs = []
    for a, b in combinations(sorted(grid.position_enu_m), 2):
        offset_m = (grid.position_enu_m[a] - grid.position_enu_m[b]) * weights
        distance_m = np.sqrt(np.einsum("nk,nk->n", offset_m, offset_m))
        judged = grid.in_air[a] & grid.in_air[b] & ~np.isnan(distance_m)
        pairs.append(PairDistance((a, b), grid.time_s, distance_m, judged))
    return sorted(pairs, key=lambda pair: (np.nan_to_num(pair.smallest_m, nan=np.inf), pair.pair))


def _keeps_altitudes(flight: FlightRecords) -> bool:
    """With `law.altitude: hold` each vehicle keeps its own altitude, and only the horizontal distance counts."""
    return flight.fleet is not None and flight.fleet.law.altitude == "hold"


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
        other.vehicle_id: sample_at(other, other.ticks.reference_enu_m, ticks.time_s)
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
