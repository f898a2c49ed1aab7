"""Logs of the autopilots: found in a folder, read, and given to the vehicle and the time of their motion.

The velocities of log and recording must agree. Times of a log are seconds of the autopilot's clock.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from companion.report.findings import Finding, finding
from companion.report.flight import FlightRecords, Floats, VehicleLog
from companion.types.errors import CompanionError
from companion.types.notices import Code


class LogError(CompanionError):
    """A log that cannot be used. str() is the reason."""


@dataclass(frozen=True, slots=True)
class Series:
    """Values (n,) at times (n,); empty where the log has none."""

    time_s: Floats = field(default_factory=lambda: np.empty(0))
    values: Floats = field(default_factory=lambda: np.empty(0))

    def shifted(self, by_s: float) -> Series:
        return Series(self.time_s + by_s, self.values)


@dataclass(frozen=True, slots=True)
class LogMessage:
    """`failsafe`: the autopilot acted by itself. `severe`: a warning or worse."""

    time_s: float
    text: str
    failsafe: bool = False
    severe: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotLog:
    """`velocity_enu_m_s` is (n, 3) at the times of `altitude_m`. Vibration beyond `vibration_limit_m_s2` is a finding."""

    name: str
    make: str
    altitude_m: Series
    velocity_enu_m_s: Floats
    voltage_v: Series = Series()
    vibration_m_s2: Series = Series()
    vibration_limit_m_s2: float
    satellites: Series = Series()
    position_error_m: Series = Series()
    messages: tuple[LogMessage, ...] = ()


ULOG, DATAFLASH = ".ulg", ".bin"
SUFFIXES = (ULOG, DATAFLASH)
PARAMETERS = "eeprom.bin"  # of ArduPilot's simulation, no log
MAX_LOG_BYTES = 2_000_000_000


@dataclass(frozen=True, slots=True)
class AutopilotLogs:
    """The logs that belong to the flight, and a finding for each that does not, or of the folder that cannot be read."""

    matched: tuple[MatchedLog, ...] = ()
    left_out: tuple[Finding, ...] = ()


NO_LOGS = AutopilotLogs()


def named_logs(paths: Sequence[Path]) -> tuple[AutopilotLog, ...]:
    """Those that the command line names, each once. Raises LogError, which names the file."""
    return tuple(_named_log(path) for path in {path.resolve(): path for path in paths}.values())


def _named_log(path: Path) -> AutopilotLog:
    try:
        return read_log(path)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error


def log_files(folder: Path, named: Sequence[Path]) -> tuple[Path, ...]:
    """Those in the folder that are not named."""
    known = {path.resolve() for path in named}
    inside = sorted(folder.rglob("*")) if folder.is_dir() else []
    logs = (path for path in inside if path.suffix.lower() in SUFFIXES and path.name != PARAMETERS)
    return tuple(path for path in logs if path.resolve() not in known)


def read_logs(files: Sequence[Path], flight: FlightRecords, named: Sequence[AutopilotLog] = ()) -> AutopilotLogs:
    """All logs, and those of the command line, with their vehicles and times."""
    logs, left_out = [*named], []
    for path in files:
        try:
            logs.append(read_log(path))
        except LogError as error:
            left_out.append(_left_out(Code.LOG_UNREADABLE, f"{path.name}: {error}"))
    matched = []
    for log in logs:
        if found := match(log, flight):
            matched.append(found)
        else:
            text = f"{log.name}: no recorded vehicle moved as this log says; it is left out"
            left_out.append(_left_out(Code.LOG_NOT_ALIGNED, text))
    return AutopilotLogs(tuple(sorted(matched, key=lambda one: one.vehicle_id)), tuple(left_out))


def read_log(path: Path) -> AutopilotLog:
    """By its suffix. Raises LogError."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}") from error
    if not path.is_file() or size > MAX_LOG_BYTES:
        raise LogError(f"expected a file of at most {MAX_LOG_BYTES / 1e9:g} GB")
    if path.suffix.lower() == ULOG:
        from companion.report.log_formats import read_ulog

        return read_ulog(path)
    if path.suffix.lower() == DATAFLASH:
        from companion.report.log_formats import read_dataflash

        return read_dataflash(path)
    raise LogError(f"expected a name that ends in {ULOG} (PX4) or {DATAFLASH} (ArduPilot)")


def _left_out(code: Code, text: str) -> Finding:
    return finding(code, None, 0.0, text)


STEP_S = 0.1  # coarse search over all time offsets
FINE_S = 0.01  # fine search near the best offset
LEAST_OVERLAP_S = 10.0
LEAST_MOTION_M_S = 0.1  # root mean square; vehicles at rest look the same at all times
ENOUGH = 0.8  # this share of the motion must agree, or the log is left out
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
