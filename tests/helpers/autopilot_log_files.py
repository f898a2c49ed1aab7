"""Logs as autopilots write them in a flight of `flown_records`, with more topics than the stand-ins' logs have."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, radians
from pathlib import Path
from typing import Any

from companion.recording.records import DecisionRecord
from companion.report.load import StartRecords

MAGIC = b"ULog\x01\x12\x35\x01"
DEGREES_PER_METRE = 1.0 / 111_319.5
LATITUDE_DEG, LONGITUDE_DEG = 47.397742, 8.545594
AT_S = 1234.5  # clock of the autopilot at the begin of the flight


@dataclass(frozen=True, kw_only=True)
class LoggedFaults:
    """By time since the begin of the flight."""

    vibration_m_s2: Callable[[float], float] = lambda _time_s: 2.0
    satellites: Callable[[float], int] = lambda _time_s: 14
    failsafe: Callable[[float], bool] = lambda _time_s: False
    messages: Sequence[tuple[float, int, str]] = ()  # with the level of syslog; of PX4


WELL = LoggedFaults()


def write_ulog(path: Path, start: StartRecords, faults: LoggedFaults = WELL) -> Path:
    """What PX4 logs of this start, in the fleet frame."""
    topics = (
        ("vehicle_local_position", "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;"),
        ("battery_status", "uint64_t timestamp;float voltage_v;"),
        ("vehicle_imu_status", "uint64_t timestamp;float accel_vibration_metric;"),
        ("sensor_gps", "uint64_t timestamp;float eph;float epv;uint8_t satellites_used;"),
        ("vehicle_status", "uint64_t timestamp;bool failsafe;"),
    )
    parts = [MAGIC, struct.pack("<Q", round(AT_S * 1e6)), _ulog("B", bytes(40))]
    parts += [_ulog("F", f"{name}:{fields}".encode()) for name, fields in topics]
    parts += [_ulog("A", struct.pack("<BH", 0, i) + name.encode()) for i, (name, _) in enumerate(topics)]
    for time_s, position, velocity in _motion(start):
        time_us = round((time_s + AT_S) * 1e6)
        (x, y, z), (vx, vy, vz) = position, velocity
        rows = (
            struct.pack("<HQ6f", 0, time_us, y, x, -z, vy, vx, -vz),
            struct.pack("<HQf", 1, time_us, 16.4 - 0.01 * time_s),
            struct.pack("<HQf", 2, time_us, faults.vibration_m_s2(time_s)),
            struct.pack("<HQffB", 3, time_us, 0.8, 1.2, faults.satellites(time_s)),
            struct.pack("<HQ?", 4, time_us, faults.failsafe(time_s)),
        )
        parts += [_ulog("D", row) for row in rows]
    for time_s, level, text in faults.messages:
        parts.append(_ulog("L", struct.pack("<BQ", ord(str(level)), round((time_s + AT_S) * 1e6)) + text.encode()))
    path.write_bytes(b"".join(parts))
    return path


def write_dataflash(path: Path, start: StartRecords, faults: LoggedFaults = WELL) -> Path:
    """What ArduPilot logs of this start."""
    formats = (
        (128, "FMT", "<BB4s16s64s", "BBnNZ", "Type,Length,Name,Format,Columns"),
        (1, "POS", "<Qiiff", "QLLff", "TimeUS,Lat,Lng,Alt,RelHomeAlt"),
        (2, "BAT", "<QBf", "QBf", "TimeUS,Inst,Volt"),
        (3, "VIBE", "<QBfff", "QBfff", "TimeUS,IMU,VibeX,VibeY,VibeZ"),
        (4, "GPS", "<QBB", "QBB", "TimeUS,I,NSats"),
        (5, "ERR", "<QBB", "QBB", "TimeUS,Subsys,ECode"),
        (6, "MSG", "<Q64s", "QZ", "TimeUS,Message"),
    )
    packed = {name: (number, struct.Struct(fields)) for number, name, fields, _, _ in formats}

    def message(name: str, *values: Any) -> bytes:
        number, fields = packed[name]
        return b"\xa3\x95" + bytes([number]) + fields.pack(*values)

    parts = [
        message("FMT", number, 3 + struct.calcsize(fields), name.encode(), form.encode(), columns.encode())
        for number, name, fields, form, columns in formats
    ]
    was_failsafe = False
    for time_s, (x, y, z), _ in _motion(start):
        time_us = round((time_s + AT_S) * 1e6)
        latitude_deg = LATITUDE_DEG + y * DEGREES_PER_METRE
        longitude_deg = LONGITUDE_DEG + x * DEGREES_PER_METRE / cos(radians(LATITUDE_DEG))
        vibration, failsafe = faults.vibration_m_s2(time_s), faults.failsafe(time_s)
        parts += [
            message("POS", time_us, round(latitude_deg * 1e7), round(longitude_deg * 1e7), 488.0 + z, z),
            message("BAT", time_us, 0, 16.4 - 0.01 * time_s),
            message("VIBE", time_us, 0, vibration, vibration, vibration),
            message("GPS", time_us, 0, faults.satellites(time_s)),
        ]
        if failsafe != was_failsafe:
            was_failsafe = failsafe
            parts.append(message("ERR", time_us, 6, 1 if failsafe else 0))
    path.write_bytes(b"".join(parts))
    return path


def _motion(start: StartRecords) -> list[tuple[float, Any, Any]]:
    """(time since the begin, position, velocity), ten a second; the velocity is that of the positions."""
    records: list[DecisionRecord] = start.decisions[::5]
    begin_s = start.header.monotonic_s
    rows = []
    for before, record in pairwise(records):
        seconds = record.now_s - before.now_s
        velocity = [(b - a) / seconds for a, b in zip(before.position_enu_m, record.position_enu_m, strict=True)]
        rows.append((record.now_s - begin_s, record.position_enu_m, velocity))
    return rows


def _ulog(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload
