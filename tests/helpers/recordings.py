"""Recordings as an agent writes them and logs as its autopilot does; the recorder, its disk, and all that a tick can have."""

from __future__ import annotations

import errno
import os
import struct
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import cos, radians
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import msgspec
import pytest
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from msgspec import Struct
from msgspec.structs import fields, replace

import companion.recording.files as files
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.reference import PointReference
from companion.config.vehicle import AgentConfig, RecordingSettings, VehicleConfig
from companion.geometry.frames import wrap_degrees
from companion.recording.codec import encode, encode_inbox, encode_outbox, log_time_ns, metadata_of
from companion.recording.recorder import Recorder, recorder_of
from companion.recording.records import (
    FORMAT,
    INBOX,
    MESSAGE_ENCODING,
    OUTBOX,
    SCHEMA_ENCODING,
    TYPES,
    DecisionRecord,
    Header,
    schema,
)
from companion.recording.writing import Writing
from companion.report.load import StartRecords
from companion.types.autopilot import (
    AutopilotRequest,
)
from companion.types.flight import Role
from companion.types.tick import Inbox, Outbox

HEADER = Header(
    software="1.2",
    fleet="pair",
    vehicle_id=1,
    session=7,
    part=1,
    unix_s=1_700_000_000.0,
    monotonic_s=100.0,
    fleet_file="{}",
    vehicle_file="{}",
)
TICK_S = 0.02


class RecordingFile:
    """An open file. `chunk_bytes`: of a chunk before it is compressed."""

    def __init__(self, path: Path, header: Header = HEADER, chunk_bytes: int = 4000) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._header = header
        self._writer = Writer(str(path), chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(library="test")
        self._writer.add_metadata(FORMAT, metadata_of(header))
        self._channels = {}
        for topic in TYPES:
            name, text = schema(topic)
            schema_id = self._writer.register_schema(name, SCHEMA_ENCODING, text)
            self._channels[topic] = self._writer.register_channel(topic, MESSAGE_ENCODING, schema_id)

    def write(self, topic: str, now_s: float, message: Any, number: int = 0) -> None:
        """A message of any topic but /inbox and /outbox."""
        self._add(topic, now_s, encode(message), number)

    def tick(self, number: int, now_s: float, inbox: Inbox, outbox: Outbox | None) -> None:
        self._add(INBOX, now_s, encode_inbox(now_s, inbox), number)
        if outbox is not None:
            self._add(OUTBOX, now_s, encode_outbox(now_s, outbox), number)

    def raw(self, topic: str, now_s: float, data: bytes, number: int = 0) -> None:
        self._add(topic, now_s, data, number)

    def close(self) -> None:
        self._writer.finish()

    def _add(self, topic: str, now_s: float, data: bytes, number: int) -> None:
        time_ns = log_time_ns(self._header, now_s)
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, number)


def write_ticks(path: Path, numbers: Iterable[int], header: Header = HEADER) -> Path:
    """A file with ticks of these numbers, without input; tick 1 begins at `monotonic_s` of the standard header."""
    file = RecordingFile(path, header)
    for number in numbers:
        file.tick(number, time_of(number), Inbox(late_s=number / 1e3), Outbox())
    file.close()
    return path


def time_of(number: int) -> float:
    return HEADER.monotonic_s + TICK_S * (number - 1)


REQUESTS = get_args(AutopilotRequest)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(
    ["null", '"not_finite":', "é\n"]
)
FLOATS = st.floats() | st.sampled_from([0.0, -0.0, 1.0, 0.1])


def inboxes() -> st.SearchStrategy[Inbox]:
    return _values(Inbox)


def outboxes() -> st.SearchStrategy[Outbox]:
    return _values(Outbox)


@cache
def _values(type_: Any) -> st.SearchStrategy[Any]:
    origin, parts = get_origin(type_), get_args(type_)
    if origin is Annotated:
        return _bounded(parts[0], parts[1])
    if origin is Union or type_.__class__.__name__ == "UnionType":
        return st.one_of(*map(_values, parts))
    if origin is list or (origin is tuple and parts[-1] is Ellipsis):
        items = st.sampled_from(REQUESTS) if parts[0] is type else _values(parts[0])
        made = st.lists(items, max_size=3)
        return made if origin is list else made.map(tuple)
    if origin is tuple:
        return st.tuples(*map(_values, parts))
    if origin is dict:
        return st.dictionaries(_values(parts[0]), _values(parts[1]), max_size=3)
    if isinstance(type_, type) and issubclass(type_, Struct):
        return st.builds(type_, *(_values(field.type) for field in fields(type_)))
    plain = {float: FLOATS, str: TEXTS, int: st.integers(-(2**63), 2**64 - 1)}
    return plain[type_] if type_ in plain else st.from_type(type_)


def _bounded(type_: Any, bounds: msgspec.Meta) -> st.SearchStrategy[Any]:
    if type_ is int:
        return st.integers(bounds.ge, bounds.le)
    if type_ is bytes:
        return st.binary(min_size=bounds.min_length or 0, max_size=bounds.max_length)
    return _values(type_)


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
    nav_state: int = 14  # of PX4, while its failsafe acts
    events: Sequence[tuple[float, int, int, bytes]] = ()  # of PX4: time, id, log levels, arguments
    flags: Callable[[float], tuple[bool, int]] | None = None  # of PX4: manual_control_signal_lost, battery_warning


WELL = LoggedFaults()


def write_ulog(path: Path, start: StartRecords, faults: LoggedFaults = WELL) -> Path:
    """What PX4 logs of this start, in the fleet frame."""
    topics = (
        ("vehicle_local_position", "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;"),
        ("battery_status", "uint64_t timestamp;float voltage_v;"),
        ("vehicle_imu_status", "uint64_t timestamp;float accel_vibration_metric;"),
        ("sensor_gps", "uint64_t timestamp;float eph;float epv;uint8_t satellites_used;"),
        ("vehicle_status", "uint64_t timestamp;bool failsafe;uint8_t nav_state;"),
        ("event", "uint64_t timestamp;uint32_t id;uint16_t event_sequence;uint8_t[25] arguments;uint8_t log_levels;"),
        (
            "failsafe_flags",
            "uint64_t timestamp;uint32_t mode_req_attitude;bool auto_mission_missing;bool manual_control_signal_lost;"
            "uint8_t battery_warning;",
        ),
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
            struct.pack(
                "<HQ?B", 4, time_us, faults.failsafe(time_s), faults.nav_state if faults.failsafe(time_s) else 14
            ),
        )
        parts += [_ulog("D", row) for row in rows]
        if faults.flags is not None:
            parts.append(_ulog("D", struct.pack("<HQI??B", 6, time_us, 6, True, *faults.flags(time_s))))
    for number, (time_s, id_, levels, arguments) in enumerate(faults.events):
        head = struct.pack("<HQIH", 5, round((time_s + AT_S) * 1e6), id_, number)
        parts.append(_ulog("D", head + arguments.ljust(25, b"\0") + bytes([levels])))
    for time_s, level, text in faults.messages:
        parts.append(_ulog("L", struct.pack("<BQ", ord(str(level)), round((time_s + AT_S) * 1e6)) + text.encode()))
    path.write_bytes(b"".join(parts))
    return path


@dataclass(frozen=True, kw_only=True)
class DataflashNames:
    """What differs between versions and settings. `primary`: of the EKF's two cores, by time; the other one is lost."""

    instance: str = "Inst"  # of BAT
    filter: str = "XKF"
    position: bool = True  # POS is logged
    primary: Callable[[float], int] | None = None


def write_dataflash(
    path: Path,
    start: StartRecords,
    faults: LoggedFaults = WELL,
    origin_longitude_deg: float = LONGITUDE_DEG,
    names: DataflashNames = DataflashNames(),
) -> Path:
    """What ArduPilot logs of this start. Its second battery has 5 V."""
    formats = (
        (128, "FMT", "<BB4s16s64s", "BBnNZ", "Type,Length,Name,Format,Columns"),
        (1, "POS", "<Qiiff", "QLLff", "TimeUS,Lat,Lng,Alt,RelHomeAlt"),
        (2, "BAT", "<QBf", "QBf", f"TimeUS,{names.instance},Volt"),
        (3, "VIBE", "<QBfff", "QBfff", "TimeUS,IMU,VibeX,VibeY,VibeZ"),
        (4, "GPS", "<QBB", "QBB", "TimeUS,I,NSats"),
        (5, "ERR", "<QBB", "QBB", "TimeUS,Subsys,ECode"),
        (6, "MSG", "<Q64s", "QZ", "TimeUS,Message"),
        (7, f"{names.filter}1", "<QBffff", "QBffff", "TimeUS,C,VN,VE,VD,PD"),
        (8, f"{names.filter}4", "<QBb", "QBb", "TimeUS,C,PI"),
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
    for time_s, (x, y, z), (vx, vy, vz) in _motion(start):
        time_us = round((time_s + AT_S) * 1e6)
        latitude_deg = LATITUDE_DEG + y * DEGREES_PER_METRE
        longitude_deg = wrap_degrees(origin_longitude_deg + x * DEGREES_PER_METRE / cos(radians(LATITUDE_DEG)))
        vibration, failsafe = faults.vibration_m_s2(time_s), faults.failsafe(time_s)
        if names.position:
            parts.append(message("POS", time_us, round(latitude_deg * 1e7), round(longitude_deg * 1e7), 488.0 + z, z))
        if names.primary is not None:
            primary = names.primary(time_s)
            parts.append(message(f"{names.filter}4", time_us, 0, primary))
            parts.append(message(f"{names.filter}1", time_us, primary, vy, vx, -vz, -z))
            parts.append(message(f"{names.filter}1", time_us, 1 - primary, 0.3 * time_s, -9.0, 2.0, 50.0))
        parts += [
            message("BAT", time_us, 1, 5.0),
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


RECORDED_SESSION, BEGAN_UNIX_S, BEGAN_S = 7, 1_700_000_000.0, 100.0


def config(recording: RecordingSettings | None = None) -> AgentConfig:
    """That of vehicle 3, which leads alone."""
    member = FormationMember(id=3, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0))
    fleet = FleetConfig(name="one", origin="indoor", vehicles=(member,), neighbours=EdgeNeighbours(edges=()))
    vehicle = VehicleConfig(
        id=3,
        fleet="fleet.yaml",
        mavlink="udpin:127.0.0.1:14540",
        hover_thrust_norm=0.5,
        reference=PointReference(point_enu_m=(20.0, 0.0, 5.0)),
        recording=recording or RecordingSettings(),
    )
    return AgentConfig(vehicle, fleet, member)


def recorder(folder: Path, writing: Writing, **settings: object) -> Recorder:
    """A recorder of that agent; `settings` are of the section `recording`."""
    recording = replace(RecordingSettings(), **settings)
    return recorder_of(config(recording), RECORDED_SESSION, folder, BEGAN_UNIX_S, BEGAN_S, writing)


class Disk:
    """The system calls of recordings, with room for a number of bytes, that can hang."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room = 1 << 40
        self.works = threading.Event()
        self.works.set()
        self.waiting = threading.Event()
        self._write = os.write
        monkeypatch.setattr(files.os, "write", self.write)
        monkeypatch.setattr(files.os, "fdatasync", self.sync)

    def write(self, descriptor: int, data: bytes) -> int:
        fits = min(self.room, len(data))
        if not fits:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.room -= fits
        return self._write(descriptor, data[:fits])

    def sync(self, _descriptor: int) -> None:
        if not self.works.is_set():
            self.waiting.set()
            self.works.wait(60.0)
