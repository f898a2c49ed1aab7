"""Reads the log formats of ArduPilot (DataFlash, .bin) and PX4 (ULog)."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Sequence
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
from companion.report.px4_failsafes import EVENT, FLAGS, STATUS, TopicRows, failsafes_of, is_told_by

FILTERS = (("XKF1", "XKF4"), ("NKF1", "NKF4"))  # of each EKF: its motion, and which of its cores is the primary one
DATAFLASH_TYPES = ("POS", *(name for pair in FILTERS for name in pair), "BAT", "VIBE", "GPS", "GPA", "MSG", "ERR")
DATAFLASH_VIBRATION_M_S2 = 30.0  # limit for the VIBE message
METRES_PER_DEGREE = 111_319.5
# The field that counts the instances of a type, where the log does not say which (FMTU): by its names in all versions.
INSTANCES = {"BAT": ("Inst", "Instance"), "VIBE": ("IMU", "I"), "GPS": ("I", "Inst"), "GPA": ("I", "Inst")}
VELOCITY_OVER_S = 0.2  # POS counts in centimetres, up to 50 times a second
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
    STATUS,
    EVENT,
    FLAGS,
)
SEVERE = frozenset({"EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING"})
ULOG_VIBRATION_M_S2 = 9.81  # limit for accel_vibration_metric
Rows = dict[str, list[Any]]


def read_dataflash(path: Path) -> AutopilotLog:
    """Raises LogError."""
    rows = _rows(path)
    velocity = _by_position(rows) or _by_filters(rows)
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
                rows[row.get_type()].append(row)
    except DAMAGED as error:
        raise LogError(f"not a DataFlash log that can be read: {str(error) or type(error).__name__}") from error
    return rows | {name: _of_first_instance(rows[name], fields) for name, fields in INSTANCES.items()}


def _of_first_instance(rows: list[Any], fields: Sequence[str]) -> list[Any]:
    """Those of the instance with the smallest number: a vehicle may have its second battery monitor alone."""
    instances = [_instance(row, fields) for row in rows]
    first = min(instances, default=0)
    return [row for row, instance in zip(rows, instances, strict=True) if instance == first]


def _instance(row: Any, fields: Sequence[str]) -> int:
    """0 where this version counts none."""
    field = row.fmt.instance_field or next((name for name in fields if name in row.fmt.columns), None)
    return int(getattr(row, field)) if field else 0


def _row_series(rows: Rows, name: str, value_of: Callable[[Any], float]) -> Series:
    """Empty where this version of the type has no such field."""
    try:
        values = np.array([value_of(row) for row in rows[name]], dtype=np.float64)
    except AttributeError:
        return Series()
    return Series(_row_times_s(rows[name]), values)


def _row_times_s(rows: list[Any]) -> Floats:
    return np.array([row.TimeUS for row in rows], dtype=np.float64) / 1e6


def _by_filters(rows: Rows) -> tuple[Series, Floats] | None:
    """(altitude, velocity) of the EKF's core that was the primary one at each time, where the log says; else of its first."""
    for motion, lanes in FILTERS:
        found = _of_primary_core(rows[motion], rows[lanes])
        if len(found) < 2:
            found = _of_first_instance(rows[motion], ("C",))
        if len(found) >= 2:
            velocity = np.array([(row.VE, row.VN, -row.VD) for row in found], dtype=np.float64)
            return Series(_row_times_s(found), -np.array([row.PD for row in found], dtype=np.float64)), velocity
    return None


def _of_primary_core(motion: list[Any], lanes: list[Any]) -> list[Any]:
    """Those rows of the motion whose core flew, by the newest PI before them. A lane switch is a change from core to core."""
    lanes = [row for row in lanes if "PI" in row.fmt.columns]
    if not lanes or not motion:
        return []
    newest = np.searchsorted(_row_times_s(lanes), _row_times_s(motion), side="right") - 1
    primary = [int(lanes[max(int(at), 0)].PI) for at in newest]
    return [row for row, core in zip(motion, primary, strict=True) if _instance(row, ("C",)) == core]


def _by_position(rows: Rows) -> tuple[Series, Floats] | None:
    """(altitude, velocity) from the positions that were flown by, whatever estimated them: their differences."""
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
    begins_s, ends_s = (np.clip(rising + side * VELOCITY_OVER_S / 2.0, rising[0], rising[-1]) for side in (-1.0, 1.0))
    moved = [np.interp(ends_s, rising, column) - np.interp(begins_s, rising, column) for column in position[first].T]
    return Series(rising, position[first, 2]), np.stack(moved, axis=1) / (ends_s - begins_s)[:, np.newaxis]


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
    failsafes = _failsafes(log)
    told_s = [one.time_s for one in failsafes]
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
        messages=(*failsafes, *(one for one in _logged(log) if not is_told_by(one.time_s, one.text, told_s))),
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
    """When the autopilot's failsafe began, with its cause and its action."""
    tables = {}
    for name in (STATUS, EVENT, FLAGS):
        if (topic := _topic(log, name)) is not None:
            order = np.argsort(_topic_times_s(topic), kind="stable")
            columns = {field: np.asarray(values)[order] for field, values in topic.data.items() if field != "timestamp"}
            tables[name] = TopicRows(_topic_times_s(topic)[order], columns)
    return [
        LogMessage(failsafe.time_s, str(failsafe), failsafe=True, severe=True)
        for failsafe in failsafes_of(tables.get(STATUS), tables.get(EVENT), tables.get(FLAGS))
    ]


def _logged(log: ULog) -> list[LogMessage]:
    found = []
    for one in log.logged_messages:
        severe = one.log_level_str() in SEVERE
        failsafe = severe and "failsafe" in one.message.lower()
        found.append(LogMessage(one.timestamp / 1e6, one.message, failsafe, severe))
    return found
