"""The station of a replay: what it knows after a jump."""

from __future__ import annotations

import asyncio

import pytest

from companion.monitor.api import Seek
from companion.monitor.events import Happening
from companion.monitor.sources import ReplaySource
from companion.monitor.station import RETRACED_S, Station
from companion.wire.messages import StatusReport
from ground_fleet import TIMING, leader, reported

BEGIN_S = 1.8e9
LOST_S = 20.0
REPORTS = [
    (BEGIN_S + k / 5, StatusReport(status, TIMING))
    for k in range(2001)
    for status in (leader(), reported(2))
    if status.agent.vehicle_id == 1 or k / 5 <= LOST_S
]
HAPPENINGS = [Happening(BEGIN_S + 10.0, "platoon", 1, "command", "hold", "anna: hold")]


@pytest.fixture
def station() -> Station:
    return Station(ReplaySource(REPORTS, HAPPENINGS, clock=lambda: 50.0), {}, operator="")


def jump(station: Station, time_s: float) -> None:
    station.act(Seek(BEGIN_S + time_s))
    station.read()
    station.renew()


def silent_since_s(station: Station) -> list[float]:
    return [alarm.since_s - BEGIN_S for alarm in station.newest.alarms if alarm.code == "SILENT"]


def test_after_a_jump_an_alarm_has_the_time_at_which_it_began(station: Station) -> None:
    jump(station, 120.0)
    assert silent_since_s(station) == [pytest.approx(LOST_S + 1.5, abs=0.6)]
    jump(station, 15.0)
    assert silent_since_s(station) == []
    jump(station, 60.3)
    assert silent_since_s(station) == [pytest.approx(LOST_S + 1.5, abs=0.6)]
    assert station.newest.time_s == pytest.approx(BEGIN_S + 60.3)


def test_after_a_jump_plots_and_events_have_what_was_before(station: Station) -> None:
    jump(station, 120.0)
    history = station.history()
    assert [history.points[0].time_s - BEGIN_S, history.points[-1].time_s - BEGIN_S] == [0.0, 120.0]
    assert [event.code for event in history.events if event.kind == "command"] == ["hold"]
    jump(station, 100.0)
    assert [event.code for event in station.history().events if event.kind == "command"] == ["hold"]


def test_a_jump_goes_back_a_bounded_time(station: Station) -> None:
    jump(station, 380.0)
    assert station.history().points[0].time_s == BEGIN_S + 380.0 - RETRACED_S


def test_of_many_jumps_at_once_the_last_one_counts(station: Station) -> None:
    for time_s in (300.0, 200.0):
        station.act(Seek(BEGIN_S + time_s))
    jump(station, 30.0)
    assert station.newest.time_s == BEGIN_S + 30.0


def test_the_whole_flight_has_what_is_before_and_after_the_present_time(station: Station) -> None:
    jump(station, 120.0)
    flight = asyncio.run(station.flight())
    assert flight is not None
    assert [(e.time_s - BEGIN_S, e.code) for e in flight.events if e.kind == "command"] == [(10.0, "hold")]
    (silent,) = [e.time_s - BEGIN_S for e in flight.events if e.code == "SILENT"]
    assert silent == pytest.approx(LOST_S + 1.5, abs=0.6)
    assert flight.leader_ids == {"platoon": (1,)}
    assert station.newest.time_s == pytest.approx(BEGIN_S + 120.0)  # the replay itself has not moved
