"""The records of a flight that was never flown, with known violations: what findings and report must say of it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from common import AT_REST, with_fields
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
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NeighbourReport,
    SafetyReport,
    Status,
)
from companion.types.tick import Inbox
from companion.types.values import Vector3
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
        agent=AgentIdentity(vehicle_id=vehicle_id, session=1, fleet=fleet.name, formation_hash=1, law="cooperative"),
        phase=FlightPhase(record.phase),
        autopilot=AutopilotReport(
            mode_name="OFFBOARD" if record.phase == FlightPhase.FORMATION else "AUTO.LOITER",
            armed=2.0 <= time_s < seconds - DOWN_BEFORE_END_S + 0.5,
            landed=LandedState.IN_AIR if in_air else LandedState.ON_GROUND,
            battery_percent=record.battery_percent,
        ),
        motion=MotionReport(
            position_enu_m=record.position_enu_m,
            velocity_enu_m_s=record.velocity_enu_m_s,
            state_age_s=0.01,
            position_error=PositionError(0.3, 0.5),
        ),
        control=ControlReport(hover_thrust_norm=0.5, disturbance_enu_m_s2=(0.2, -0.1, 0.0)),
        leadership=LeadershipReport(
            role=Role(record.role), epoch=0, prc=vehicle_id, leader_beacon=None, leader_beacon_age_s=None
        ),
        neighbourhood=NeighbourReport(
            neighbours=record.neighbours, peers=tuple(member.id for member in fleet.vehicles if member.id != vehicle_id)
        ),
        formation=FormationReport(slot=FlownSlot(record.slot_offset_enu_m), reference_enu_m=record.reference_enu_m),
        safety=SafetyReport(flags=tuple(HealthFlag(flag) for flag in record.flags)),
        rejected={},
        last_event=None,
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
    header = sender.header
    return with_fields(
        AT_REST, vehicle_id=header.vehicle_id, session=header.session, sequence=round(1000 * sent_s), sent_s=sent_s
    )
