"""Finds the vehicle and the time of an autopilot's log by its motion: the velocities of both must agree."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.report.arrays import Floats
from companion.report.autopilot.log import AutopilotLog
from companion.report.flight import FlightRecords, VehicleLog

STEP_S = 0.1  # of the search over all offsets
FINE_S = 0.01  # and near the best one
LEAST_OVERLAP_S = 10.0
LEAST_MOTION_M_S = 0.1  # root mean square; vehicles at rest look the same at all times
ENOUGH = 0.8  # of the motion that must be explained
NAMED = re.compile(r"vehicle-(\d{1,3})_")


@dataclass(frozen=True, slots=True)
class MatchedLog:
    """A log with its vehicle: time of the flight = time of the log + `offset_s`. `agreement`: 1 where both move alike."""

    log: AutopilotLog
    vehicle_id: int
    offset_s: float
    agreement: float


def match(log: AutopilotLog, flight: FlightRecords) -> MatchedLog | None:
    """By the id in the name of the file, else the vehicle that moved most alike; None where none did."""
    named = NAMED.search(log.name)
    candidates = [one for one in flight.vehicles if not named or one.vehicle_id == int(named.group(1))]
    matches = [found for vehicle in candidates if (found := _matched(log, vehicle))]
    return max(matches, key=lambda found: found.agreement, default=None)


def _matched(log: AutopilotLog, vehicle: VehicleLog) -> MatchedLog | None:
    log_s, own_s = log.altitude_m.time_s, vehicle.ticks.time_s
    if log_s.size < 2 or own_s.size < 2:
        return None
    own = _resampled(own_s, vehicle.ticks.velocity_enu_m_s, float(own_s[0]), float(own_s[-1]))
    theirs = _resampled(log_s, log.velocity_enu_m_s, float(log_s[0]), float(log_s[-1]))
    lags, agreement, covered = _agreement(own, theirs)
    if not lags.size:
        return None
    best = int(np.argmax(agreement * covered))  # a small part of the flight must not win by chance
    if agreement[best] < ENOUGH:
        return None
    coarse_s = float(own_s[0] - log_s[0] + lags[best] * STEP_S)
    return MatchedLog(log, vehicle.vehicle_id, _refined(log, vehicle, coarse_s), float(agreement[best]))


def _resampled(time_s: Floats, velocity: Floats, begin_s: float, end_s: float) -> Floats:
    """Velocities (n, 3) every STEP_S; unknown ones count as 0."""
    at_s = np.arange(begin_s, end_s, STEP_S)
    known = np.nan_to_num(velocity)
    return np.stack([np.interp(at_s, time_s, column) for column in known.T], axis=1)


def _agreement(own: Floats, theirs: Floats) -> tuple[Floats, Floats, Floats]:
    """(lags in steps, agreement of each, share of the motion in its overlap).

    The agreement is the product of both velocities by the mean of their squares: 1 where they are the same.
    """
    length = own.shape[0] + theirs.shape[0] - 1
    size = 1 << (length - 1).bit_length()

    def correlated(a: Floats, b: Floats) -> Floats:
        """sum over i of a[i + lag] b[i], for all lags from -(len(b) - 1) on."""
        spectrum = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
        return np.asarray(np.roll(np.fft.irfft(spectrum, size), theirs.shape[0] - 1)[:length], dtype=np.float64)

    ones_own, ones_theirs = np.ones(own.shape[0]), np.ones(theirs.shape[0])
    product = np.sum([correlated(own[:, i], theirs[:, i]) for i in range(3)], axis=0)
    energy_own = correlated(np.sum(own**2, axis=1), ones_theirs)
    energy_theirs = correlated(ones_own, np.sum(theirs**2, axis=1))
    count = np.maximum(correlated(ones_own, ones_theirs), 1.0)
    motion = (energy_own + energy_theirs) / 2.0
    lags = np.arange(length) - (theirs.shape[0] - 1)
    usable = (count * STEP_S >= LEAST_OVERLAP_S) & (motion / count >= LEAST_MOTION_M_S**2)
    agreement = product / np.maximum(motion, 1e-9)
    return lags[usable].astype(np.float64), agreement[usable], motion[usable] / max(float(motion.max()), 1e-9)


def _refined(log: AutopilotLog, vehicle: VehicleLog, coarse_s: float) -> float:
    """The best offset within one step of the search."""
    own_s, own = vehicle.ticks.time_s, np.nan_to_num(vehicle.ticks.velocity_enu_m_s)
    theirs = np.nan_to_num(log.velocity_enu_m_s)
    tried: Sequence[float] = [coarse_s + FINE_S * step for step in range(-10, 11)]

    def difference(offset_s: float) -> float:
        at_s = log.altitude_m.time_s + offset_s
        inside = (at_s >= own_s[0]) & (at_s <= own_s[-1])
        expected = np.stack([np.interp(at_s[inside], own_s, column) for column in own.T], axis=1)
        return float(np.mean((theirs[inside] - expected) ** 2)) if inside.any() else np.inf

    return min(tried, key=difference)
