"""Reports in, snapshots out."""

from __future__ import annotations

from collections.abc import Sized
from itertools import pairwise
from sys import float_info

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import with_fields
from companion.ground.fleet_state import MOST_VEHICLES
from companion.monitor.api import Snapshot, VehicleView
from companion.monitor.snapshot import KEPT_S, PERIOD_S, Picture
from companion.types.autopilot import LandedState
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.status import NO_STATE_AGE_S, Status
from companion.wire.messages import StatusReport
from ground_fleet import TIMING, leader, reported
from tests.bench.monitor_load import SteadyFleet, steady_fleet

UNIX_S = 1.8e9


def picture_of(*statuses: Status, at_s: float = 100.0, picture: Picture | None = None) -> Picture:
    picture = picture or Picture({}, "anna@ground")
    picture.receive([(at_s, StatusReport(status, TIMING)) for status in statuses], UNIX_S)
    return picture


def seen(picture: Picture, at_s: float) -> Snapshot:
    return picture.snapshot(at_s, UNIX_S + at_s)


def vehicle(picture: Picture, vehicle_id: int, at_s: float = 100.05) -> VehicleView:
    return next(v for v in seen(picture, at_s).vehicles if v.vehicle_id == vehicle_id)


@pytest.fixture(scope="module")
def load() -> SteadyFleet:
    return steady_fleet("load", 9)


def flown(load: SteadyFleet, seconds: float, files: bool = True) -> tuple[Picture, Snapshot]:
    picture = Picture({"load": load.fleet} if files else {}, "anna@ground")
    for step in range(int(seconds * 10)):
        now_s = step / 10
        picture.receive([(now_s, load.report(i, now_s)) for i in load.vehicle_ids], UNIX_S)
        snapshot = seen(picture, now_s)
    return picture, snapshot


def test_a_snapshot_has_every_vehicle_with_its_slot_and_error(load: SteadyFleet) -> None:
    _, snapshot = flown(load, 3.0)
    assert [v.vehicle_id for v in snapshot.vehicles] == load.vehicle_ids
    for v in snapshot.vehicles:
        assert v.report_rate_hz == pytest.approx(10.0)
        assert v.slot_position_enu_m is not None
        assert v.error_to_slot_m == pytest.approx(
            sum((a - b) ** 2 for a, b in zip(v.position_enu_m, v.slot_position_enu_m, strict=True)) ** 0.5, abs=2e-3
        )
        assert sum(n.weight or 0.0 for n in v.neighbours) == pytest.approx(1.0, abs=1e-3)


def test_the_figures_of_the_law_need_the_fleet_file(load: SteadyFleet) -> None:
    fleet = flown(load, 8.0)[1].fleets[0]
    assert fleet.leader_ids == (1,)
    assert fleet.smallest_separation_m is not None
    assert fleet.separation_trend_m_s is not None
    assert fleet.lambda_min is not None
    assert fleet.lambda_min > 0.0
    without = flown(load, 1.0, files=False)[1].fleets[0]
    assert without.smallest_separation_m is not None
    assert (without.lambda_min, without.settling_s) == (None, None)


def test_a_vehicle_of_the_fleet_file_that_never_reports_is_missed(load: SteadyFleet) -> None:
    picture = Picture({"load": load.fleet}, "anna@ground")
    for step in range(80):
        now_s = step / 10
        picture.receive([(now_s, load.report(i, now_s)) for i in load.vehicle_ids if i != 4], UNIX_S)
        snapshot = seen(picture, now_s)
        assert [a.vehicle_id for a in snapshot.alarms if a.code == "NEVER_HEARD"] == ([4] if now_s >= 5.0 else [])
    assert snapshot.fleets[0].missing_ids == (4,)
    assert 4 not in snapshot.fleets[0].vehicle_ids
    picture.receive([(8.0, load.report(4, 8.0))], UNIX_S)
    assert seen(picture, 8.0).fleets[0].missing_ids == ()


def test_plots_go_on_where_the_clock_is_set_back(load: SteadyFleet) -> None:
    picture = Picture({}, "anna@ground")
    for step in range(200):
        now_s, set_back_s = step / 10, 3600.0 if step >= 100 else 0.0
        picture.receive([(now_s, load.report(i, now_s)) for i in load.vehicle_ids], UNIX_S - set_back_s)
        picture.snapshot(now_s, UNIX_S + now_s - set_back_s)
    times = [point.time_s for point in picture.history().points]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(UNIX_S + 19.5 - 3600.0, abs=0.6)
    assert len(times) == 20  # of ten seconds: those before are of a time that has not come


def test_an_old_position_has_no_error_and_no_altitude() -> None:
    fresh, old = leader(), leader(state_age_s=1.5)
    assert vehicle(picture_of(fresh), 1).error_to_slot_m is not None
    picture = picture_of(old)
    assert vehicle(picture, 1).error_to_slot_m is None
    assert [s.altitude_m for point in picture.history().points for s in point.vehicles] == [None]


@pytest.mark.parametrize(("phase", "severity"), [(FlightPhase.HOLD, "warning"), (FlightPhase.FORMATION, "critical")])
def test_a_lost_leader_is_critical_in_formation(phase: FlightPhase, severity: str) -> None:
    status = reported(2, phase=phase, flags=(HealthFlag.LEADER_LOST,))
    assert [flag.severity for flag in vehicle(picture_of(status), 2).flags] == [severity]


def test_the_trend_is_that_of_two_vehicles_that_approach() -> None:
    picture = Picture({}, "anna@ground")
    for step in range(80):
        now_s = step / 10
        picture_of(leader(), reported(2, position_enu_m=(-10.0 + 0.5 * now_s, 0.0, 2.5)), at_s=now_s, picture=picture)
        snapshot = seen(picture, now_s)
    assert snapshot.fleets[0].separation_trend_m_s == pytest.approx(-0.5, abs=1e-3)


def test_a_vehicle_without_a_report_for_a_second_is_silent_and_an_alarm() -> None:
    picture = picture_of(leader(), reported(2))
    picture_of(leader(), at_s=101.5, picture=picture)
    snapshot = seen(picture, 101.6)
    assert [v.silent for v in snapshot.vehicles] == [False, True]
    assert [(a.vehicle_id, a.code, a.severity) for a in snapshot.alarms] == [(2, "SILENT", "critical")]
    assert snapshot.fleets[0].smallest_separation_m is None  # one position is old
    picture_of(leader(), reported(2), at_s=101.7, picture=picture)
    assert [a.until_s is None for a in seen(picture, 101.8).alarms] == [False]


def test_a_silent_vehicle_on_the_ground_is_no_critical_alarm() -> None:
    picture = picture_of(reported(2, armed=False, landed=LandedState.ON_GROUND, phase=FlightPhase.OBSERVE))
    assert seen(picture, 102.0).alarms == ()
    assert [a.severity for a in seen(picture, 102.5).alarms] == ["warning"]


def test_a_flag_has_what_the_agent_does_and_what_the_operator_should_do(load: SteadyFleet) -> None:
    flagged = with_fields(load.report(3, 0.0).status, flags=(HealthFlag.OUTSIDE_FENCE, HealthFlag.BATTERY_LOW))
    picture = Picture({"load": load.fleet}, "anna@ground")
    picture_of(flagged, picture=picture)
    fence, battery = vehicle(picture, 3).flags
    assert (fence.severity, fence.action) == ("critical", "goes into hold")
    assert "Bring it back" in fence.advice
    assert (battery.severity, battery.action) == ("warning", "warns, after 3 s lands")
    landed = picture_of(reported(3, armed=False, flags=(HealthFlag.BATTERY_LOW,)))
    assert [flag.action for flag in vehicle(landed, 3).flags] == ["does nothing while disarmed"]
    assert [a.code for a in seen(picture, 100.1).alarms] == ["OUTSIDE_FENCE"]
    assert [a.code for a in seen(picture, 100.6).alarms] == ["OUTSIDE_FENCE", "BATTERY_LOW"]


def test_a_vehicle_with_another_fleet_file_is_an_alarm(load: SteadyFleet) -> None:
    picture = Picture({"load": load.fleet}, "anna@ground")
    picture_of(load.report(1, 0.0).status, with_fields(load.report(2, 0.0).status, formation_hash=7), picture=picture)
    seen(picture, 100.1)
    assert [(a.vehicle_id, a.code) for a in seen(picture, 100.6).alarms] == [(2, "FLEET_FILE_DIFFERS")]


def test_a_report_that_cannot_be_true_is_an_alarm_that_names_the_value(load: SteadyFleet) -> None:
    picture = Picture({"load": load.fleet}, "anna@ground")
    lost = with_fields(load.report(2, 0.0).status, position_enu_m=(9000.0, 0.0, 5.0), reference_s=-1.0)
    picture_of(load.report(1, 0.0).status, lost, picture=picture)
    seen(picture, 100.1)
    (alarm,) = seen(picture, 100.6).alarms
    assert (alarm.vehicle_id, alarm.code, alarm.severity) == (2, "REPORT_IMPLAUSIBLE", "warning")
    assert "reports position_enu_m 9000, 0, 5 m; expected x, y, z of" in alarm.text
    assert "reports reference_s -1 s; expected 0 to" in alarm.text
    assert "origin" in alarm.advice


def test_a_vehicle_without_a_position_has_none_at_zero(load: SteadyFleet) -> None:
    nowhere = {"position_enu_m": (0.0, 0.0, 0.0), "velocity_enu_m_s": (0.0, 0.0, 0.0), "state_age_s": NO_STATE_AGE_S}
    grounded = {"armed": False, "landed": LandedState.ON_GROUND}
    picture = Picture({"load": load.fleet}, "anna@ground")
    picture_of(
        with_fields(load.report(2, 0.0).status, **nowhere | grounded), load.report(1, 0.0).status, picture=picture
    )
    shown = vehicle(picture, 2)
    assert (shown.position_enu_m, shown.velocity_enu_m_s, shown.data_age_s) == (None, None, None)
    file = picture.fleet_map("load")
    assert file is not None
    assert 2 not in file.homes_enu_m
    (point,) = picture.history().points
    assert [sample.altitude_m is None for sample in point.vehicles] == [False, True]


def test_alarms_and_changes_of_phase_are_events() -> None:
    picture = picture_of(leader())
    picture_of(leader(phase=FlightPhase.HOLD, flags=(HealthFlag.OUTSIDE_FENCE,)), at_s=100.1, picture=picture)
    seen(picture, 100.15)
    assert [(e.kind, e.code) for e in picture.events.all()] == [("phase", "PHASE_CHANGED"), ("alarm", "OUTSIDE_FENCE")]


def test_a_jump_leaves_what_was_before_it() -> None:
    picture = picture_of(leader(), reported(2))
    picture_of(leader(phase=FlightPhase.HOLD), at_s=101.0, picture=picture)
    picture_of(leader(phase=FlightPhase.LAND), at_s=103.0, picture=picture)
    assert seen(picture, 104.0).alarms
    picture.jump(UNIX_S + 102.0)
    assert [(e.text, e.time_s) for e in picture.events.all()] == [("formation -> hold", UNIX_S + 101.0)]
    assert seen(picture, 102.0).vehicles == ()
    assert picture.alarms.all() == ()
    picture_of(leader(phase=FlightPhase.HOLD), leader(phase=FlightPhase.LAND), at_s=103.0, picture=picture)
    assert [e.text for e in picture.events.all()] == ["formation -> hold", "hold -> land"]


def test_history_has_two_points_a_second_for_ten_minutes() -> None:
    picture = Picture({}, "anna@ground")
    for step in range(int(KEPT_S) * 10 + 300):
        now_s = step / 10
        if step % 10 == 0:
            picture_of(leader(), at_s=now_s, picture=picture)
        seen(picture, now_s)
    points = picture.history().points
    assert len(points) == KEPT_S / PERIOD_S
    gaps = {round(b.time_s - a.time_s, 3) for a, b in pairwise(points)}
    assert gaps == {PERIOD_S}


def test_history_leaves_out_silent_vehicles() -> None:
    picture = picture_of(leader(), reported(2))
    picture_of(leader(), at_s=102.0, picture=picture)
    seen(picture, 102.0)
    assert [sample.vehicle_id for sample in picture.history().points[-1].vehicles] == [1]


def test_the_history_of_fleets_with_the_same_ids_is_separate() -> None:
    picture = picture_of(leader(), leader(fleet="other", position_enu_m=(0.0, 0.0, 30.0)))
    seen(picture, 100.1)
    points = picture.history().points
    assert [(point.fleet, point.vehicles[0].altitude_m) for point in points] == [
        ("other", 30.0),
        (leader().agent.fleet, leader().motion.position_enu_m[2]),
    ]


def test_homes_are_where_vehicles_were_last_disarmed_on_the_ground(load: SteadyFleet) -> None:
    picture = Picture({"load": load.fleet}, "anna@ground")
    on_ground = with_fields(
        load.report(2, 0.0).status, armed=False, landed=LandedState.ON_GROUND, position_enu_m=(1.0, 2.0, 0.1)
    )
    picture_of(on_ground, load.report(3, 0.0).status, picture=picture)
    picture_of(load.report(2, 1.0).status, at_s=101.0, picture=picture)
    view = picture.fleet_map("load")
    assert view is not None
    assert view.homes_enu_m == {2: (1.0, 2.0, 0.1)}
    assert picture.fleet_map("other") is None


def test_the_map_has_the_line_of_the_reference_that_the_leader_describes(load: SteadyFleet) -> None:
    square = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 9.0], [8.0, 0.0, 9.0], [8.0, 6.0, 9.0]]}
    picture = Picture({"load": load.fleet}, "anna@ground")
    for described, expected in (
        (square, ((0.0, 0.0, 9.0), (8.0, 0.0, 9.0), (8.0, 6.0, 9.0))),
        ({"kind": "point", "point_enu_m": [1.0, 2.0, 3.0]}, ((1.0, 2.0, 3.0),)),
        ({"kind": "sausage"}, ()),
        (square | {"points_enu_m": "none"}, ()),
    ):
        picture_of(with_fields(load.report(1, 0.0).status, role=Role.LEADER, described=described), picture=picture)
        view = picture.fleet_map("load")
        assert view is not None
        assert view.reference_enu_m == expected


def test_a_law_may_tell_no_weights() -> None:
    picture = picture_of(reported(2, neighbours=(1, 3)))
    assert [(n.vehicle_id, n.weight, n.age_s) for n in vehicle(picture, 2).neighbours] == [
        (1, None, None),
        (3, None, None),
    ]


def test_a_vehicle_that_never_had_a_position_has_no_age_of_it() -> None:
    assert vehicle(picture_of(reported(2, state_age_s=1e6)), 2).data_age_s is None


def test_every_snapshot_is_json_that_is_read_back(load: SteadyFleet) -> None:
    _, snapshot = flown(load, 2.0)
    encoded = msgspec.json.encode(snapshot)
    assert msgspec.json.decode(encoded, type=Snapshot) == snapshot
    assert b"NaN" not in encoded


HUGE = st.floats(-float_info.max, float_info.max)


@given(st.lists(st.tuples(st.tuples(HUGE, HUGE, HUGE), HUGE), min_size=2, max_size=4))
def test_any_numbers_that_a_report_may_have_give_a_snapshot(
    drawn: list[tuple[tuple[float, float, float], float]],
) -> None:
    statuses = [
        reported(
            i,
            position_enu_m=position,
            velocity_enu_m_s=position,
            battery_percent=number,
            state_age_s=number,
            reference_enu_m=position,
            weights=(number,),
            neighbour_ages_s=(number, number),
        )
        for i, (position, number) in enumerate(drawn, start=1)
    ]
    picture = picture_of(*statuses)
    for now_s in (100.0, 101.0, 103.0):
        picture_of(*statuses, at_s=now_s, picture=picture)
        assert msgspec.json.decode(msgspec.json.encode(seen(picture, now_s)))["vehicles"]


def test_a_stranger_with_many_names_fills_no_memory() -> None:
    picture = Picture({}, "anna@ground")
    for i in range(MOST_VEHICLES + 200):
        picture_of(reported(1, fleet=f"f{i}", armed=False, landed=LandedState.ON_GROUND), at_s=2.0 * i, picture=picture)
        if i % 100 == 0:
            seen(picture, 2.0 * i)
    assert len(seen(picture, 2.0 * MOST_VEHICLES + 400.0).vehicles) == MOST_VEHICLES
    kept = {name: len(value) for name, value in vars(picture).items() if isinstance(value, Sized)}
    assert max(kept.values()) == MOST_VEHICLES, kept
