"""Reads PX4's log format (ULog)."""

from __future__ import annotations

import io
import struct
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from pyulog import ULog
from pyulog.exceptions import ULogException

from companion.report.arrays import Floats
from companion.report.autopilot.log import AutopilotLog, LogError, LogMessage, Series

ULOG_TOPICS = (
    "vehicle_local_position",
    "battery_status",
    "vehicle_imu_status",
    "sensor_gps",
    "vehicle_gps_position",
    "vehicle_status",
)
SEVERE = frozenset({"EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING"})
ULOG_VIBRATION_M_S2 = 9.81  # of accel_vibration_metric
# What the library raises for files that are damaged.
DAMAGED_ULOG = (
    ULogException,
    TypeError,
    ValueError,
    KeyError,
    IndexError,
    AttributeError,
    EOFError,
    struct.error,
    OSError,
)


def read_ulog(path: Path) -> AutopilotLog:
    """Raises LogError."""
    try:
        with redirect_stdout(io.StringIO()):  # the library prints what it skips
            log = ULog(str(path), list(ULOG_TOPICS))
    except DAMAGED_ULOG as error:
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
    return [
        LogMessage(
            one.timestamp / 1e6,
            one.message,
            failsafe="failsafe" in one.message.lower() and one.log_level_str() in SEVERE,
            severe=one.log_level_str() in SEVERE,
        )
        for one in log.logged_messages
    ]
