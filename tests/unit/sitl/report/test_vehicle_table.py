"""What a console shows of the vehicles of a flight, and which of their flags are remarkable."""

from __future__ import annotations

from dataclasses import replace

import pytest

from common import with_fields
from companion.ground.fleet_state import ReportedVehicle
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.formation import FlownSlot
from companion.wire.messages import StatusReport
from ground_fleet import STATUS, TIMING
from sitl.report.vehicle_table import VehicleTable

P, F = FlightPhase, HealthFlag


def vehicle(phase: FlightPhase, *flags: HealthFlag, vehicle_id: int = 1, armed: bool = True) -> ReportedVehicle:
    status = with_fields(STATUS, vehicle_id=vehicle_id, phase=phase, armed=armed)
    return ReportedVehicle(StatusReport(status, TIMING), 0.1, 0.12, False, flags)


def remarks(table: VehicleTable, of: ReportedVehicle, now_s: float) -> list[str]:
    return [line for line in table.lines([of], now_s) if "!" in line]


def test_the_first_seconds_of_an_agent_on_the_ground_are_without_remark() -> None:
    table, starts = VehicleTable(), vehicle(P.OBSERVE, F.FRAME_UNKNOWN, F.POSITION_STALE, F.POSE_LOST, armed=False)
    assert remarks(table, starts, 10.0) == []
    assert remarks(table, starts, 14.9) == []
    assert remarks(table, starts, 15.0) == [
        "  ! FRAME_UNKNOWN, vehicle 1: the autopilot's origin is unknown",
        "  ! POSE_LOST, vehicle 1: no good motion-capture pose",
        "  ! POSITION_STALE, vehicle 1: position older than allowed",
    ]


@pytest.mark.parametrize("phase", [P.OBSERVE, P.PREPARE, P.FORMATION])
def test_the_same_flags_in_the_air_or_later_are_remarkable_at_once(phase: FlightPhase) -> None:
    assert len(remarks(VehicleTable(), vehicle(phase, F.FRAME_UNKNOWN), 10.0)) == 1


def test_other_flags_are_remarkable_at_once_when_an_agent_starts() -> None:
    assert len(remarks(VehicleTable(), vehicle(P.OBSERVE, F.DUPLICATE_ID, armed=False), 10.0)) == 1


def test_a_climbing_vehicle_needs_no_leader_and_finds_it_soon_after() -> None:
    table, holds = VehicleTable(), vehicle(P.HOLD, F.LEADER_LOST)
    assert remarks(table, vehicle(P.TAKEOFF, F.LEADER_LOST), 10.0) == []
    assert remarks(table, vehicle(P.TAKEOFF, F.LEADER_LOST), 30.0) == []
    assert remarks(table, holds, 31.0) == []
    assert remarks(table, holds, 33.0) == ["  ! LEADER_LOST, vehicle 1: no fresh leader beacon"]


def test_a_leader_lost_in_formation_is_remarkable_at_once_also_in_the_hold_after_it() -> None:
    table = VehicleTable()
    lost = ((P.FORMATION, F.LEADER_AWAITED), (P.RELEASE, F.LEADER_LOST), (P.HOLD, F.LEADER_LOST))
    for now_s, (phase, flag) in enumerate(lost):
        assert len(remarks(table, vehicle(phase, flag), float(now_s))) == 1
    assert remarks(table, vehicle(P.LAND, F.LEADER_LOST), 3.0) == []


@pytest.mark.parametrize("flag", [F.LEADER_AWAITED, F.LEADER_LOST])
def test_a_fleet_that_holds_on_command_soon_has_its_leader_again(flag: HealthFlag) -> None:
    table = VehicleTable()
    assert remarks(table, vehicle(P.FORMATION), 10.0) == []
    assert remarks(table, vehicle(P.RELEASE, flag), 11.0) == []
    assert remarks(table, vehicle(P.HOLD, flag), 11.5) == []
    assert len(remarks(table, vehicle(P.HOLD, flag), 13.5)) == 1


def test_a_row_of_the_table_fits_eighty_columns() -> None:
    vehicles = [vehicle(P.FORMATION, F.LEADER_LOST, vehicle_id=i) for i in (1, 2)]
    lines = VehicleTable().lines(vehicles, 10.0)
    assert max(map(len, lines)) <= 80
    assert lines[1].split()[:3] == ["1", "follower", "formation"]
    assert lines[3:] == [
        "  ! LEADER_LOST, vehicles 1, 2: no fresh leader beacon; in formation it goes",
        "    into hold, after land_after_s lands",
    ]


def test_a_small_screen_keeps_the_vehicles_with_flags() -> None:
    vehicles = [vehicle(P.FORMATION, vehicle_id=i) for i in range(1, 30)]
    vehicles.append(vehicle(P.FORMATION, F.BATTERY_LOW, vehicle_id=30))
    lines = VehicleTable().lines(vehicles, 10.0, room=10)
    assert len(lines) == 10
    assert lines[6].split()[0] == "30"
    assert lines[7:] == [
        "  and 24 more vehicles; a taller window shows them",
        "  ! BATTERY_LOW, vehicle 30: battery below leave_below_percent; in formation it",
        "    warns, after 3 s acts by low_battery_action",
    ]


def test_a_file_gets_one_line_of_all_vehicles_and_their_flags() -> None:
    vehicles = [vehicle(P.FORMATION, vehicle_id=1), vehicle(P.HOLD, F.BATTERY_LOW, vehicle_id=2)]
    silent = replace(vehicle(P.HOLD, vehicle_id=3), silent=True)
    assert VehicleTable().brief([replace(vehicles[0], error_to_slot_m=0.126), vehicles[1], silent], 10.0) == [
        "1 formation, 1 hold, at most 0.13 m from the slot (vehicle 1), SILENT: vehicle 3",
        "  ! BATTERY_LOW, vehicle 2: battery below leave_below_percent",
    ]
    assert VehicleTable().brief(vehicles[:1], 10.0) == ["all formation"]
    status = with_fields(STATUS, phase=P.FORMATION, slot=FlownSlot((1.0, 0.0, 0.0), moves_for_s=43.2))
    flown = ReportedVehicle(StatusReport(status, TIMING), 0.1, 0.12, False, (), error_to_slot_m=0.004)
    assert VehicleTable().brief([flown], 10.0) == [
        "all formation, at most 0.00 m from the slot (vehicle 1), slots on their way for 43 s"
    ]
    assert (
        VehicleTable().lines([flown], 10.0)[-1] == "  the slots are on their way for another 43 s; errors are to them"
    )
    assert VehicleTable().brief([], 10.0) == [""]
