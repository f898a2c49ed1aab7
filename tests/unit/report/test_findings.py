"""A flight with known violations has exactly these findings; a good one has none."""

from __future__ import annotations

import dataclasses

import pytest
from msgspec.structs import replace

from common import count_calls, with_fields
from companion.recording.records import DecisionRecord, TimingRecord
from companion.report.distances import grid_of, pair_distances
from companion.report.findings import Finding, FindingKind, Severity, finding, rows_of
from companion.report.flight import GivenCommand
from companion.report.flight_findings import refused_commands
from companion.report.summary import all_findings
from companion.types.autopilot import LandedState
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.notices import Code, Notice
from companion.types.status import Status
from made_flights import Faults, flagged, fleet_of, flight_of, near_vehicle_1, records_of

Expected = tuple[Severity, Code, int | None, float]
CRITICAL, WARNING, INFO = Severity


def findings_of(faults: dict[int, Faults], vehicles: int = 4, seconds: float = 60.0) -> tuple[Finding, ...]:
    starts = records_of(vehicles, seconds, faults)
    flight = flight_of(starts)
    return all_findings(flight, pair_distances(flight, grid_of(flight)))


def short(findings: tuple[Finding, ...]) -> list[Expected]:
    return [(one.severity, one.code, one.vehicle_id, round(one.time_s, 1)) for one in findings]


def late_ticks(time_s: float, record: TimingRecord) -> TimingRecord:
    return TimingRecord(record.now_s, 45_000, 900, 1300, 30_000) if 29.99 < time_s < 31.99 else record


def without_peer_1(time_s: float, status: Status) -> Status:
    return (
        with_fields(status, peers=tuple(i for i in status.neighbourhood.peers if i != 1))
        if 25.0 <= time_s < 26.0
        else status
    )


def disarmed_at_40_s(time_s: float, status: Status) -> Status:
    return (
        with_fields(status, armed=False) if time_s >= 40.0 and status.autopilot.landed is LandedState.IN_AIR else status
    )


def test_a_good_flight_has_no_findings() -> None:
    assert findings_of({}) == ()


def test_the_golden_flight_has_exactly_the_known_findings() -> None:
    faults = {
        1: Faults(refused={CommandName.ARM: Code.WRONG_PHASE}, status=disarmed_at_40_s),
        2: Faults(decision=near_vehicle_1, status=without_peer_1),
        3: Faults(timing=late_ticks, problems=("b.mcap: ends within a record",)),
        4: Faults(
            lost=(34.0, 35.0),
            decision=flagged(HealthFlag.BATTERY_LOW, 36.0, 41.0).decision,
            events=((37.0, Notice(Code.SEPARATION_INTERVENES, "the filter changes the acceleration by 1.2 m/s^2")),),
        ),
    }
    assert short(findings_of(faults)) == [
        (CRITICAL, Code.SEPARATION_VIOLATED, 1, 20.0),
        (CRITICAL, Code.BATTERY_LOW, 4, 36.0),
        (CRITICAL, Code.AUTOPILOT_DISARMED, 1, 40.0),
        (WARNING, Code.WRONG_PHASE, 1, 1.9),
        (WARNING, Code.PEER_STALE, 2, 25.0),
        (WARNING, Code.COMMANDS_SLOW, 3, 30.0),
        (WARNING, Code.LOOP_LATE, 3, 30.0),
        (WARNING, Code.RECORDING_GAP, 4, 34.0),
        (WARNING, Code.RECORDING_TRUNCATED, 3, 60.0),
        (INFO, Code.SEPARATION_INTERVENES, 4, 37.0),
    ]


def test_the_nearest_moment_of_an_encounter_is_named() -> None:
    (found,) = findings_of({2: Faults(decision=near_vehicle_1)})
    assert found.kind is FindingKind.CLOSE
    assert "vehicles 1 and 2 were 1.00 m apart" in found.text
    assert "separation_m is 1.5 m" in found.text
    assert found.lasts_s is not None
    assert 1.9 < found.lasts_s < 2.1


def test_a_leader_lost_long_enough_is_critical_and_names_the_failsafe() -> None:
    (brief,) = findings_of({3: flagged(HealthFlag.LEADER_AWAITED, 20.0, 20.4)})
    assert (brief.kind, brief.severity, brief.code) == (FindingKind.LOST, WARNING, Code.LEADER_AWAITED)
    (lost,) = findings_of({3: flagged(HealthFlag.LEADER_LOST, 20.0, 20.4)})
    assert (lost.severity, lost.code) == (CRITICAL, Code.LEADER_LOST)
    assert "failsafe: hold" in lost.text


def test_a_flag_on_the_ground_is_no_finding() -> None:
    assert findings_of({3: flagged(HealthFlag.LEADER_LOST, 0.0, 4.0)}) == ()


def test_a_stale_position_is_a_warning_that_names_the_missing_setpoint() -> None:
    (found,) = findings_of({2: flagged(HealthFlag.POSITION_STALE, 20.0, 20.06)})
    assert (found.severity, found.code) == (WARNING, Code.POSITION_STALE)
    assert "no setpoint was sent" in found.text


def gave_up(time_s: float, record: DecisionRecord) -> DecisionRecord:
    """From 20 s to 30 s the agent observes. The flag is raised in the first of these ticks only."""
    if not 20.0 <= time_s < 30.0:
        return record
    flags = (HealthFlag.POSITION_STALE,) if time_s < 20.01 else ()
    return replace(record, phase=FlightPhase.OBSERVE, flags=flags)


def test_an_agent_that_gives_up_in_the_air_is_critical_however_short_its_flag_was() -> None:
    text = "formation -> observe (no setpoint for 0.5 s: position older than allowed)"
    event = (20.0, Notice(Code.POSITION_STALE, text))
    (found,) = findings_of({3: Faults(decision=gave_up, events=(event,))})
    assert (found.severity, found.code, found.vehicle_id, found.text) == (CRITICAL, Code.POSITION_STALE, 3, text)
    on_the_ground = (1.0, Notice(Code.POSITION_STALE, "observe -> observe"))
    assert findings_of({3: Faults(events=(on_the_ground,))}) == ()


@pytest.mark.parametrize(("late_us", "severity"), [(30_000, INFO), (490_000, INFO), (510_000, WARNING)])
def test_one_late_tick_is_a_warning_where_the_autopilot_took_over(late_us: int, severity: Severity) -> None:
    def late_once(time_s: float, record: TimingRecord) -> TimingRecord:
        return replace(record, late_us=late_us) if 29.99 < time_s < 30.01 else record

    assert short(findings_of({3: Faults(timing=late_once)})) == [(severity, Code.LOOP_LATE, 3, 30.0)]


def raised_twice(flag: HealthFlag, first: tuple[float, float], second: tuple[float, float]) -> Faults:
    before, after = flagged(flag, *first), flagged(flag, *second)
    return Faults(decision=lambda time_s, record: after.decision(time_s, before.decision(time_s, record)))


def test_the_pauses_of_a_flag_that_comes_and_goes_do_not_count() -> None:
    (found,) = findings_of({2: raised_twice(HealthFlag.POSITION_STALE, (20.0, 20.06), (21.7, 21.78))})
    assert found.lasts_s == 0.14
    assert found.text == "position older than allowed for 0.14 s within 1.78 s; no setpoint was sent in that time"


def test_a_failsafe_comes_due_only_while_the_flag_stays_raised() -> None:
    (found,) = findings_of({2: raised_twice(HealthFlag.ESTIMATOR_BAD, (20.0, 20.5), (21.0, 21.5))})
    assert (found.severity, found.code, found.lasts_s) == (WARNING, Code.ESTIMATOR_BAD, 1.0)
    assert "failsafe" not in found.text


def test_the_pauses_of_an_encounter_do_not_count() -> None:
    def apart_for_a_second(time_s: float, record: DecisionRecord) -> DecisionRecord:
        return record if 20.5 <= time_s < 21.5 else near_vehicle_1(time_s, record)

    (found,) = findings_of({2: Faults(decision=apart_for_a_second)})
    assert found.lasts_s is not None
    assert 0.9 < found.lasts_s < 1.1


def test_packets_between_two_losses_are_not_lost() -> None:
    def without_peer_1_twice(time_s: float, status: Status) -> Status:
        return status if 25.3 <= time_s < 25.7 else without_peer_1(time_s, status)

    (found,) = findings_of({2: Faults(status=without_peer_1_twice)})
    assert found.text == "no packets of vehicle 1 for 0.60 s within 1.00 s"
    assert found.lasts_s == 0.6


def without_peer_3(time_s: float, status: Status) -> Status:
    """As the others report a vehicle whose agent ended at 30 s: the limit of a fresh packet passes first."""
    return (
        with_fields(status, peers=tuple(i for i in status.neighbourhood.peers if i != 3)) if time_s >= 30.3 else status
    )


def test_the_others_miss_a_vehicle_whose_agent_ended_in_the_air() -> None:
    found = findings_of({1: Faults(status=without_peer_3), 3: Faults(ends_s=30.0)}, vehicles=3)
    assert short(found) == [(CRITICAL, Code.RECORDING_ENDS_IN_AIR, 3, 30.0), (WARNING, Code.PEER_STALE, 1, 30.3)]
    lost = found[1]
    assert lost.kind is FindingKind.LOST
    assert lost.text == "no packets of vehicle 3 for 27.70 s; its records end at 30.0 s, in the air"


def test_a_vehicle_that_landed_and_ended_is_not_missed() -> None:
    def landed(time_s: float, status: Status) -> Status:
        return with_fields(status, landed=LandedState.ON_GROUND) if time_s >= 29.0 else status

    found = findings_of({1: Faults(status=without_peer_3), 3: Faults(ends_s=30.0, status=landed)}, vehicles=3)
    assert found == ()


def test_a_vehicle_without_a_recording_is_named() -> None:
    starts = [start for start in records_of(3) if start.header.vehicle_id != 2]
    flight = flight_of(starts)
    found = all_findings(flight, pair_distances(flight, grid_of(flight)))
    assert short(found) == [(WARNING, Code.RECORDING_MISSING, 2, 0.0)]


def test_a_restart_in_the_air_is_critical() -> None:
    found = findings_of({2: Faults(restart_s=(30.0, 33.0))})
    assert short(found) == [(CRITICAL, Code.AGENT_RESTARTED, 2, 33.0)]
    assert "3.0 s after its last record" in found[0].text


def test_a_recording_that_ends_in_the_air_is_critical() -> None:
    found = findings_of({3: Faults(ends_s=30.0)})
    assert short(found) == [(CRITICAL, Code.RECORDING_ENDS_IN_AIR, 3, 30.0)]


def test_a_flight_on_the_ground_only_is_named() -> None:
    def on_the_ground(_time_s: float, record: DecisionRecord) -> DecisionRecord:
        return replace(record, phase=FlightPhase.OBSERVE, reference_enu_m=None)

    def landed(_time_s: float, status: Status) -> Status:
        return with_fields(status, landed=LandedState.ON_GROUND, armed=False)

    faults = {i: Faults(decision=on_the_ground, status=landed) for i in (1, 2)}
    assert short(findings_of(faults, vehicles=2, seconds=20.0)) == [(INFO, Code.NOT_FLOWN, None, 0.0)]


def test_without_a_usable_fleet_file_distances_are_not_judged_and_it_is_said() -> None:
    starts = records_of(2, 20.0, {2: Faults(decision=near_vehicle_1)}, fleet_of(2))
    starts = [type(start)(replace(start.header, fleet_file="{"), start.decisions, start.timings) for start in starts]
    flight = flight_of(starts)
    found = all_findings(flight, pair_distances(flight, grid_of(flight)))
    assert [one.code for one in found] == [Code.RECORDING_UNREADABLE]
    assert "distances are not judged" in found[0].text


def test_a_clock_that_could_not_be_compared_is_named() -> None:
    starts = records_of(2, 30.0)
    flight = flight_of(starts, unaligned=(2,))
    found = all_findings(flight, pair_distances(flight, grid_of(flight)))
    assert short(found) == [(WARNING, Code.CLOCK_NOT_ALIGNED, 2, 0.0)]


def test_the_work_for_findings_grows_with_their_number() -> None:
    def of(count: int) -> int:
        many = [finding(Code.PROCEDURE_FAILED, 1 + n % 2, 0.01 * n, f"failed {n}") for n in range(count)]
        with count_calls() as work:
            rows_of(many)
        return work.calls

    assert of(4000) < 3 * of(2000)


def test_flags_that_do_not_exist_and_long_words_make_no_columns() -> None:
    (start,) = records_of(1, 30.0)
    start.decisions[:] = [
        replace(record, flags=(f"FLAG_{record.now_s}",), nearest="x" * 10_000) for record in start.decisions
    ]
    (vehicle,) = flight_of([start]).vehicles
    assert set(vehicle.ticks.flags) <= set(HealthFlag)
    assert vehicle.ticks.nearest.nbytes < 1e6


def test_a_refused_command_is_information_only_where_it_is_soon_accepted() -> None:
    (vehicle,) = flight_of(records_of(1, 30.0)).vehicles
    commands = [
        GivenCommand(t, "hold", n, "anna", t, ok, Code.WRONG_PHASE, "")
        for n, (t, ok) in enumerate([(1.0, True), (2.0, False), (4.0, True), (10.0, False), (15.1, True)])
    ]
    found = list(refused_commands(dataclasses.replace(vehicle, commands=tuple(commands))))
    assert [(one.time_s, one.severity.value) for one in found] == [(2.0, "info"), (10.0, "warning")]
