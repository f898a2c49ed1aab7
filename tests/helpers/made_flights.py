"""Records and autopilot logs of a flight that never happened, with known violations."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, pi, radians, sin
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember, GeodeticOrigin
from companion.recording.records import (
    COMMAND,
    DECISION,
    EVENT,
    INBOX,
    REPLY,
    STATUS,
    TIMING,
    DecisionRecord,
    Header,
    TimingRecord,
)
from companion.report.flight import FlightRecords
from companion.report.load import StartRecords, vehicle_log
from companion.report.load import fleet_of as of_header
from companion.types.autopilot import LandedState, PositionError
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Code, Notice
from companion.types.peers import LeaderReport, Motion, PeerPacket, ReceivedPeerPacket, Sender
from companion.types.status import Status
from companion.types.tick import Inbox
from companion.types.values import ZERO3, Vector3
from companion.wire.messages import Percentiles, StatusReport, Timing
from recordings import RecordingFile

PERIOD_S = 0.02
BEGIN_UNIX_S = 1_764_000_000.0
TAKEOFF_S, FORM_S, LAND_BEFORE_END_S, DOWN_BEFORE_END_S = 5.0, 10.0, 8.0, 2.0
HEIGHT_M = 5.0
SPACING_M = 3.0
OPERATOR = "anna@ground"
DELAY_S = 0.004  # of packets
PACKETS_OF_EVERY = 5  # ticks the alignment uses one
NO_TIMES = Percentiles(0.0, 0.0, 0.0)
TIMING_OF_REPORTS = Timing(50.0, 0, 0, NO_TIMES, NO_TIMES, 0.0, 0.0)

ChangeDecision = Callable[[float, DecisionRecord], DecisionRecord]
ChangeTiming = Callable[[float, TimingRecord], TimingRecord]
ChangeStatus = Callable[[float, Status], Status]


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What goes wrong with one vehicle, by time since the begin of the flight. `lost`: no records between two times."""

    decision: ChangeDecision = lambda _time_s, record: record
    timing: ChangeTiming = lambda _time_s, record: record
    status: ChangeStatus = lambda _time_s, status: status
    lost: tuple[float, float] = (1e9, 1e9)
    ends_s: float = 1e9
    restart_s: tuple[float, float] | None = None  # last record of the first start, first record of the second
    refused: Mapping[CommandName, Code] = field(default_factory=dict)
    events: tuple[tuple[float, Notice], ...] = ()
    problems: tuple[str, ...] = ()


NONE = Faults()


def flagged(flag: HealthFlag, begins_s: float, ends_s: float) -> Faults:
    def decision(time_s: float, record: DecisionRecord) -> DecisionRecord:
        return replace(record, flags=(*record.flags, flag)) if begins_s <= time_s < ends_s else record

    return Faults(decision=decision)


def near_vehicle_1(time_s: float, record: DecisionRecord) -> DecisionRecord:
    """Vehicle 2 comes within 1 m of vehicle 1, which is 3 m ahead, for two seconds."""
    x, y, z = record.position_enu_m
    return replace(record, position_enu_m=(x + 2.05, y, z)) if 20.0 <= time_s <= 22.0 else record


def fleet_of(vehicles: int, separation_m: float = 1.5) -> FleetConfig:
    """A column of vehicles 3 m apart; the first one leads."""
    return FleetConfig(
        name="golden",
        origin=GeodeticOrigin(47.397742, 8.545594, 488.0),
        vehicles=tuple(
            FormationMember(i + 1, Role.LEADER if i == 0 else Role.FOLLOWER, (-SPACING_M * i, 0.0, HEIGHT_M), i < 2)
            for i in range(vehicles)
        ),
        neighbours=EdgeNeighbours(tuple((i, i + 1) for i in range(1, vehicles))),
        separation_m=separation_m,
        leave_below_percent=30.0,
        land_below_percent=15.0,
        land_after_s=20.0,
    )


def records_of(
    vehicles: int = 4,
    seconds: float = 60.0,
    faults: Mapping[int, Faults] | None = None,
    fleet: FleetConfig | None = None,
) -> list[StartRecords]:
    """All starts of all vehicles. Clocks differ: vehicle i's monotonic clock was 0 a hundred seconds times i before."""
    fleet = fleet or fleet_of(vehicles)
    starts = []
    for vehicle_id in range(1, vehicles + 1):
        starts += _of_vehicle(fleet, vehicle_id, seconds, (faults or {}).get(vehicle_id, NONE))
    return starts


def flight_of(starts: Sequence[StartRecords], unaligned: Collection[int] = ()) -> FlightRecords:
    """The flight of these recordings, by exact clocks."""
    logs = []
    for vehicle_id in sorted({start.header.vehicle_id for start in starts}):
        own = [start for start in starts if start.header.vehicle_id == vehicle_id]
        logs.append(vehicle_log(own, [_clock(start) for start in own], vehicle_id not in unaligned))
    header = starts[0].header
    fleet, problems = of_header(header)
    return FlightRecords(header.fleet, tuple(logs), BEGIN_UNIX_S, fleet, problems)


def _clock(start: StartRecords) -> Callable[[float], float]:
    offset_s = start.header.unix_s - start.header.monotonic_s - BEGIN_UNIX_S
    return lambda now_s: now_s + offset_s


def _of_vehicle(fleet: FleetConfig, vehicle_id: int, seconds: float, faults: Faults) -> list[StartRecords]:
    own_begin_s = 100.0 * vehicle_id
    starts = [StartRecords(_header(fleet, vehicle_id, 1, BEGIN_UNIX_S, own_begin_s), problems=faults.problems)]
    for number in range(round(seconds / PERIOD_S)):
        time_s = number * PERIOD_S
        down = faults.lost
        if faults.restart_s:
            down = faults.restart_s
            if len(starts) == 1 and time_s >= down[1]:
                starts.append(StartRecords(_header(fleet, vehicle_id, 2, BEGIN_UNIX_S + time_s, own_begin_s + time_s)))
        if down[0] < time_s < down[1] or time_s > faults.ends_s:
            continue
        record = faults.decision(time_s, _decision(fleet, vehicle_id, time_s, seconds))
        now_s = own_begin_s + time_s
        starts[-1].decisions.append(replace(record, now_s=now_s))
        timing = faults.timing(time_s, TimingRecord(now_s, 150 + number * 7919 % 400, 900, 1300, 1100))
        starts[-1].timings.append(timing)
        if number % 5 == 0:
            starts[-1].statuses.append(
                (now_s, faults.status(time_s, _status(fleet, record, vehicle_id, time_s, seconds)))
            )
    _add_events(starts, own_begin_s, seconds, vehicle_id, faults)
    return starts


def _header(fleet: FleetConfig, vehicle_id: int, session: int, unix_s: float, monotonic_s: float) -> Header:
    return Header(
        software="0.1.0",
        fleet=fleet.name,
        vehicle_id=vehicle_id,
        session=session,
        part=1,
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        fleet_file=msgspec.json.encode(fleet).decode(),
        vehicle_file="{}",
    )


def phase_at(time_s: float, seconds: float) -> FlightPhase:
    """The phases of a whole flight."""
    if time_s < 2.0:
        return FlightPhase.OBSERVE
    if time_s < TAKEOFF_S:
        return FlightPhase.ARMED
    if time_s < FORM_S - 1.0:
        return FlightPhase.TAKEOFF
    if time_s < FORM_S:
        return FlightPhase.HOLD
    if time_s < seconds - LAND_BEFORE_END_S:
        return FlightPhase.FORMATION
    return FlightPhase.LAND if time_s < seconds - DOWN_BEFORE_END_S else FlightPhase.OBSERVE


def _height_m(time_s: float, seconds: float) -> float:
    up = min(1.0, max(0.0, (time_s - TAKEOFF_S) / 4.0))
    down = min(1.0, max(0.0, (seconds - DOWN_BEFORE_END_S - time_s) / (LAND_BEFORE_END_S - DOWN_BEFORE_END_S)))
    return HEIGHT_M * min(up, down)


def _reference_enu_m(time_s: float) -> Vector3:
    angle_rad = 2.0 * pi * max(0.0, time_s - FORM_S) / 60.0
    return (10.0 * sin(angle_rad), 10.0 - 10.0 * cos(angle_rad), 0.0)


def _position_enu_m(slot: Vector3, vehicle_id: int, time_s: float, seconds: float) -> Vector3:
    """On its slot, 5 cm more behind it from vehicle to vehicle."""
    x, y, _ = _reference_enu_m(min(time_s, seconds - LAND_BEFORE_END_S))
    return (x + slot[0] - 0.05 * (vehicle_id - 1), y + slot[1], _height_m(time_s, seconds))


def _decision(fleet: FleetConfig, vehicle_id: int, time_s: float, seconds: float) -> DecisionRecord:
    phase = phase_at(time_s, seconds)
    forms = phase is FlightPhase.FORMATION
    x, y, _ = _reference_enu_m(min(time_s, seconds - LAND_BEFORE_END_S))
    slot = fleet.vehicles[vehicle_id - 1].slot_enu_m
    before, after = (_position_enu_m(slot, vehicle_id, time_s + by_s, seconds) for by_s in (-0.01, 0.01))
    ids = [i for i in (vehicle_id - 1, vehicle_id + 1) if 1 <= i <= len(fleet.vehicles)]
    near_m = SPACING_M if len(ids) else None
    return DecisionRecord(
        now_s=time_s,
        phase=phase,
        role=fleet.vehicles[vehicle_id - 1].role,
        leader_id=1 if forms else None,
        epoch=0,
        prc=vehicle_id,
        position_enu_m=_position_enu_m(slot, vehicle_id, time_s, seconds),
        velocity_enu_m_s=tuple((b - a) / 0.02 for a, b in zip(before, after, strict=True)),
        slot_offset_enu_m=slot,
        reference_enu_m=(x, y, 0.0) if vehicle_id == 1 and forms else None,
        neighbours=tuple(ids) if forms else (),
        weights=tuple(1.0 / len(ids) for _ in ids) if forms else (),
        peer_ages_s=tuple(0.02 for _ in ids) if forms else (),
        acceleration_enu_m_s2=(0.0, 0.1, 0.0),
        roll_deg=1.0 if forms else None,
        pitch_deg=2.0 if forms else None,
        yaw_deg=0.0 if forms else None,
        thrust_norm=0.5 if forms else None,
        nearest=str(ids[0]) if forms and ids else "",
        nearest_m=near_m if forms else None,
        required_m=2.0 if forms and ids else None,
        filter_changed_m_s2=0.0,
        wind_acceleration_enu_m_s2=(0.2, -0.1, 0.0),
        hover_thrust_norm=0.5,
        battery_percent=95.0 - 20.0 * time_s / seconds,
        flags=(),
    )


def _status(fleet: FleetConfig, record: DecisionRecord, vehicle_id: int, time_s: float, seconds: float) -> Status:
    in_air = TAKEOFF_S + 0.5 <= time_s < seconds - DOWN_BEFORE_END_S
    return Status(
        vehicle_id=vehicle_id,
        session=1,
        fleet=fleet.name,
        formation_hash=1,
        law="cooperative",
        phase=FlightPhase(record.phase),
        mode_name="OFFBOARD" if record.phase == FlightPhase.FORMATION else "AUTO.LOITER",
        armed=2.0 <= time_s < seconds - DOWN_BEFORE_END_S + 0.5,
        landed=LandedState.IN_AIR if in_air else LandedState.ON_GROUND,
        position_enu_m=record.position_enu_m,
        velocity_enu_m_s=record.velocity_enu_m_s,
        state_age_s=0.01,
        hover_thrust_norm=0.5,
        disturbance_enu_m_s2=(0.2, -0.1, 0.0),
        role=Role(record.role),
        epoch=0,
        prc=vehicle_id,
        leader_beacon=None,
        leader_beacon_age_s=None,
        neighbours=record.neighbours,
        slot=FlownSlot(record.slot_offset_enu_m),
        reference_enu_m=record.reference_enu_m,
        flags=tuple(HealthFlag(flag) for flag in record.flags),
        rejected={},
        last_event=None,
        peers=tuple(member.id for member in fleet.vehicles if member.id != vehicle_id),
        battery_percent=record.battery_percent,
        position_error=PositionError(0.3, 0.5),
    )


def _add_events(
    starts: list[StartRecords], own_begin_s: float, seconds: float, vehicle_id: int, faults: Faults
) -> None:
    given = (
        (1.5, CommandName.PREPARE),
        (1.9, CommandName.ARM),
        (TAKEOFF_S - 0.02, CommandName.TAKEOFF),
        (FORM_S - 0.02, CommandName.FORM),
        (seconds - LAND_BEFORE_END_S - 0.02, CommandName.LAND),
    )
    for number, (time_s, name) in enumerate(given, start=1):
        start = next((one for one in reversed(starts) if one.span_s[0] <= own_begin_s + time_s <= one.span_s[1]), None)
        if start is None:
            continue
        now_s, code = own_begin_s + time_s, faults.refused.get(name)
        for again_s in (0.0, 0.2):  # senders repeat a command until it is answered
            start.commands.append((now_s + again_s, Command(name, number, OPERATOR, 1)))
            start.replies.append(
                (
                    now_s + again_s + 0.01,
                    CommandReply(
                        vehicle_id,
                        number,
                        code is None,
                        code or Code.PHASE_CHANGED,
                        f"{name} begins" if code is None else f"{name} is not possible now",
                        OPERATOR,
                    ),
                )
            )
        start.events.append((now_s + 0.02, Notice(Code.PHASE_CHANGED, f"command {name}")))
    starts[-1].events.extend((own_begin_s + time_s, notice) for time_s, notice in faults.events)


def write_recordings(folder: Path, starts: Sequence[StartRecords]) -> list[Path]:
    """The files that the agents of this flight leave, with the packets that they received from each other."""
    paths = []
    for start in starts:
        rows: list[tuple[float, str, Any]] = [(record.now_s, DECISION, record) for record in start.decisions]
        rows += [(record.now_s, TIMING, record) for record in start.timings]
        rows += [(now_s, STATUS, StatusReport(status, TIMING_OF_REPORTS)) for now_s, status in start.statuses]
        rows += [(now_s, INBOX, Inbox(peers=_received(start, starts, now_s))) for now_s, _ in start.statuses[::2]]
        for topic, timed in ((EVENT, start.events), (COMMAND, start.commands), (REPLY, start.replies)):
            rows += [(now_s, topic, message) for now_s, message in timed]
        header = start.header
        paths.append(folder / f"vehicle_{header.vehicle_id}_{header.session:04d}_001.mcap")
        file = RecordingFile(paths[-1], header, 100_000)
        for now_s, topic, message in sorted(rows, key=lambda row: row[0]):
            if topic == INBOX:
                file.tick(PACKETS_OF_EVERY, now_s, message, None)
            else:
                file.write(topic, now_s, message)
        file.close()
    return paths


def _received(start: StartRecords, starts: Sequence[StartRecords], now_s: float) -> tuple[ReceivedPeerPacket, ...]:
    """A packet of each other vehicle that runs at this time, sent DELAY_S before."""
    time_s = _clock(start)(now_s)
    found = []
    for other in starts:
        begin_s, end_s = (_clock(other)(own_s) for own_s in other.span_s)
        if other.header.vehicle_id != start.header.vehicle_id and begin_s <= time_s - DELAY_S <= end_s:
            sent_s = other.span_s[0] + time_s - DELAY_S - begin_s
            found.append(ReceivedPeerPacket(now_s, _packet(other, sent_s)))
    return tuple(found)


def _packet(sender: StartRecords, sent_s: float) -> PeerPacket:
    """Only its sender and its time count here."""
    return PeerPacket(
        sender=Sender(
            vehicle_id=sender.header.vehicle_id,
            session=sender.header.session,
            sequence=round(1000 * sent_s),
            formation_hash=1,
        ),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=ZERO3, velocity_enu_m_s=ZERO3, acceleration_enu_m_s2=ZERO3, state_age_s=0.0, sent_s=sent_s
        ),
        leader=LeaderReport(prc=1, beacon=None),
        slot=FlownSlot(ZERO3),
    )


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
