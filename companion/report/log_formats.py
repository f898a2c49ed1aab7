"""Reads the log formats of ArduPilot (DataFlash, .bin) and PX4 (ULog)."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from math import cos, radians
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import DFReader
from pyulog import ULog
from pyulog.exceptions import ULogException

from companion.geometry.frames import wrap_degrees
from companion.report.autopilot_logs import AutopilotLog, LogError, LogMessage, Series
from companion.report.flight import Floats

DATAFLASH_TYPES = ("POS", "XKF1", "BAT", "VIBE", "GPS", "GPA", "MSG", "ERR")
DATAFLASH_VIBRATION_M_S2 = 30.0  # limit for the VIBE message
METRES_PER_DEGREE = 111_319.5
FIRST_ONLY = {"XKF1": "C", "BAT": "Inst", "VIBE": "IMU", "GPS": "I", "GPA": "I"}  # field that counts instances
# Subsystems of ERR that are failsafes; a code of 0 is their end.
FAILSAFES = {
    5: "radio control",
    6: "battery",
    7: "GPS",
    8: "ground station",
    9: "fence",
    12: "crash check",
    16: "EKF check",
    17: "EKF",
    20: "ADS-B",
    25: "thrust loss",
    26: "sensors",
    29: "vibration",
    31: "dead reckoning",
}
# What the libraries raise for files that are damaged.
DAMAGED = (TypeError, ValueError, KeyError, IndexError, AttributeError, EOFError, struct.error, OSError)
ULOG_TOPICS = (
    "vehicle_local_position",
    "battery_status",
    "vehicle_imu_status",
    "sensor_gps",
    "vehicle_gps_position",
    "vehicle_status",
)
SEVERE = frozenset({"EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING"})
ULOG_VIBRATION_M_S2 = 9.81  # limit for accel_vibration_metric
Rows = dict[str, list[Any]]


def read_dataflash(path: Path) -> AutopilotLog:
    """Raises LogError."""
    rows = _rows(path)
    velocity = _by_filter(rows) or _by_position(rows)
    if velocity is None:
        raise LogError("it has neither POS nor XKF1")
    altitude_m, velocity_enu_m_s = velocity
    return AutopilotLog(
        name=path.name,
        make="ArduPilot",
        altitude_m=altitude_m,
        velocity_enu_m_s=velocity_enu_m_s,
        voltage_v=_row_series(rows, "BAT", lambda row: row.Volt),
        vibration_m_s2=_row_series(rows, "VIBE", lambda row: max(row.VibeX, row.VibeY, row.VibeZ)),
        vibration_limit_m_s2=DATAFLASH_VIBRATION_M_S2,
        satellites=_row_series(rows, "GPS", lambda row: row.NSats),
        position_error_m=_row_series(rows, "GPA", lambda row: row.HAcc),
        messages=tuple(_messages(rows)),
    )


def _rows(path: Path) -> Rows:
    """The rows of each type, of its first instance. Raises LogError."""
    rows: Rows = {name: [] for name in DATAFLASH_TYPES}
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):  # the library prints what it skips
            log = DFReader.DFReader_binary(str(path), zero_time_base=True)
            while (row := log.recv_match(type=list(DATAFLASH_TYPES))) is not None:
                name = row.get_type()
                if getattr(row, FIRST_ONLY.get(name, ""), 0) == 0:
                    rows[name].append(row)
    except DAMAGED as error:
        raise LogError(f"not a DataFlash log that can be read: {str(error) or type(error).__name__}") from error
    return rows


def _row_series(rows: Rows, name: str, value_of: Callable[[Any], float]) -> Series:
    """Empty where this version of the type has no such field."""
    try:
        values = np.array([value_of(row) for row in rows[name]], dtype=np.float64)
    except AttributeError:
        return Series()
    return Series(_row_times_s(rows[name]), values)


def _row_times_s(rows: list[Any]) -> Floats:
    return np.array([row.TimeUS for row in rows], dtype=np.float64) / 1e6


def _by_filter(rows: Rows) -> tuple[Series, Floats] | None:
    """(altitude, velocity) of the EKF's first core."""
    found = rows["XKF1"]
    if len(found) < 2:
        return None
    velocity = np.array([(row.VE, row.VN, -row.VD) for row in found], dtype=np.float64)
    return Series(_row_times_s(found), -np.array([row.PD for row in found], dtype=np.float64)), velocity


def _by_position(rows: Rows) -> tuple[Series, Floats] | None:
    """(altitude, velocity) from the positions: their differences."""
    found = rows["POS"]
    if len(found) < 3:
        return None
    time_s = _row_times_s(found)
    east = METRES_PER_DEGREE * cos(radians(found[0].Lat))
    position = np.array(
        [
            (wrap_degrees(row.Lng - found[0].Lng) * east, (row.Lat - found[0].Lat) * METRES_PER_DEGREE, row.Alt)
            for row in found
        ],
        dtype=np.float64,
    )
    rising, first = np.unique(time_s, return_index=True)
    if rising.size < 3:
        return None
    velocity = np.gradient(position[first], rising, axis=0)
    return Series(rising, position[first, 2]), velocity


def _messages(rows: Rows) -> list[LogMessage]:
    found = [LogMessage(row.TimeUS / 1e6, str(row.Message), False, False) for row in rows["MSG"]]
    for row in rows["ERR"]:
        if row.ECode and row.Subsys in FAILSAFES:
            text = f"failsafe: {FAILSAFES[row.Subsys]} (ERR {row.Subsys}, {row.ECode})"
            found.append(LogMessage(row.TimeUS / 1e6, text, failsafe=True, severe=True))
        elif row.ECode:
            found.append(LogMessage(row.TimeUS / 1e6, f"error {row.Subsys}, {row.ECode} (ERR)", severe=True))
    return sorted(found, key=lambda one: one.time_s)


def read_ulog(path: Path) -> AutopilotLog:
    """Raises LogError."""
    try:
        with redirect_stdout(io.StringIO()):  # the library prints what it skips
            log = ULog(str(path), list(ULOG_TOPICS))
    except (ULogException, *DAMAGED) as error:
        raise LogError(f"not a ULog that can be read: {str(error) or type(error).__name__}") from error
    position = _topic(log, "vehicle_local_position")
    if position is None:
        raise LogError("it has no vehicle_local_position")
    gps = "sensor_gps" if _topic(log, "sensor_gps") is not None else "vehicle_gps_position"
    return AutopilotLog(
        name=path.name,
        make="PX4",
        altitude_m=Series(_topic_times_s(position), -_column(position, "z")),
        velocity_enu_m_s=np.stack([_column(position, "vy"), _column(position, "vx"), -_column(position, "vz")], axis=1),
        voltage_v=_topic_series(log, "battery_status", "voltage_v"),
        vibration_m_s2=_topic_series(log, "vehicle_imu_status", "accel_vibration_metric"),
        vibration_limit_m_s2=ULOG_VIBRATION_M_S2,
        satellites=_topic_series(log, gps, "satellites_used"),
        position_error_m=_topic_series(log, gps, "eph"),
        messages=(*_failsafes(log), *_logged(log)),
    )


def _topic(log: ULog, name: str) -> Any | None:
    """The first instance of a topic with rows; None without one."""
    found = [one for one in log.data_list if one.name == name and len(one.data.get("timestamp", ()))]
    return min(found, key=lambda one: one.multi_id, default=None)


def _topic_times_s(topic: Any) -> Floats:
    return np.asarray(topic.data["timestamp"], dtype=np.float64) / 1e6


def _column(topic: Any, name: str) -> Floats:
    """NaN where this version of the topic has no such field."""
    values = topic.data.get(name)
    return np.full(len(topic.data["timestamp"]), np.nan) if values is None else np.asarray(values, dtype=np.float64)


def _topic_series(log: ULog, topic_name: str, field: str) -> Series:
    topic = _topic(log, topic_name)
    return (
        Series() if topic is None or field not in topic.data else Series(_topic_times_s(topic), _column(topic, field))
    )


def _failsafes(log: ULog) -> list[LogMessage]:
    """When the autopilot's failsafe began."""
    status = _topic(log, "vehicle_status")
    if status is None or "failsafe" not in status.data:
        return []
    active = _column(status, "failsafe") > 0.0
    begins = np.flatnonzero(active & ~np.concatenate(([False], active[:-1])))
    time_s = _topic_times_s(status)
    return [LogMessage(float(time_s[row]), "vehicle_status.failsafe", failsafe=True, severe=True) for row in begins]


def _logged(log: ULog) -> list[LogMessage]:
    found = []
    for one in log.logged_messages:
        severe = one.log_level_str() in SEVERE
        failsafe = severe and "failsafe" in one.message.lower()
        found.append(LogMessage(one.timestamp / 1e6, one.message, failsafe, severe))
    return found
