"""The alarm list: begin, end, acknowledge, and its bounds."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from companion.monitor.alarms import MOST_ALARMS, WARNS_AFTER_S, AlarmCondition, AlarmList, Delay, Key

LOW = ("platoon", 2, "BATTERY_LOW")
LATE = ("platoon", 1, "TICK_LATE")
WARNING = AlarmCondition("warning", "battery below leave_below_percent", "change it")
CRITICAL = AlarmCondition("critical", "battery below land_below_percent", "land")


def test_an_alarm_lasts_until_it_has_ended_and_is_acknowledged() -> None:
    alarms = AlarmList()
    begun = alarms.update(10.0, {LOW: WARNING}).begun
    assert [(a.vehicle_id, a.code, a.since_s, a.until_s) for a in begun] == [(2, "BATTERY_LOW", 10.0, None)]
    assert alarms.update(11.0, {LOW: WARNING}) == alarms.update(12.0, {LOW: WARNING})  # nothing new
    assert [a.until_s for a in alarms.update(13.0, {}).ended] == [13.0]
    assert [a.until_s for a in alarms.all()] == [13.0]
    assert alarms.acknowledge(begun[0].id) is not None
    assert alarms.all() == ()
    assert alarms.acknowledge(begun[0].id) is None


def test_a_warning_that_passes_at_once_is_no_alarm_and_a_critical_condition_is_one_at_once() -> None:
    delay = Delay()
    assert delay.lasting(10.0, {LOW: WARNING, LATE: CRITICAL}) == {LATE: CRITICAL}
    assert delay.lasting(10.0 + 0.9 * WARNS_AFTER_S, {LOW: WARNING}) == {}
    assert delay.lasting(10.0 + WARNS_AFTER_S, {LOW: WARNING}) == {LOW: WARNING}
    assert delay.lasting(11.0, {}) == {}
    assert delay.lasting(11.1, {LOW: WARNING}) == {}


def test_an_acknowledged_alarm_leaves_at_its_end() -> None:
    alarms = AlarmList()
    alarm_id = alarms.update(10.0, {LOW: WARNING}).begun[0].id
    alarms.acknowledge(alarm_id)
    assert [a.acknowledged for a in alarms.all()] == [True]
    alarms.update(11.0, {})
    assert alarms.all() == ()
    assert alarms.update(12.0, {LOW: WARNING}).begun[0].id != alarm_id  # and comes again as another


def test_a_condition_that_comes_and_goes_is_one_alarm() -> None:
    alarms = AlarmList()
    first = alarms.update(10.0, {LOW: WARNING}).begun[0]
    alarms.update(11.0, {})
    again = alarms.update(12.0, {LOW: WARNING}).begun[0]
    assert (again.id, again.since_s, again.until_s) == (first.id, 12.0, None)  # how long it lasts is of this time alone
    assert (again.first_s, again.times) == (10.0, 2)
    assert len(alarms.all()) == 1


def test_an_alarm_that_becomes_worse_shows_it() -> None:
    alarms = AlarmList()
    alarms.update(10.0, {LOW: WARNING})
    assert alarms.update(11.0, {LOW: CRITICAL}).begun == ()
    assert [(a.severity, a.text) for a in alarms.all()] == [("critical", CRITICAL.text)]


def test_an_acknowledged_alarm_that_becomes_worse_is_another_one() -> None:
    alarms = AlarmList()
    first = alarms.update(10.0, {LOW: WARNING}).begun[0]
    alarms.acknowledge(first.id)
    (worse,) = alarms.update(11.0, {LOW: CRITICAL}).begun
    assert (worse.id != first.id, worse.since_s, worse.acknowledged) == (True, 11.0, False)
    alarms.acknowledge(worse.id)
    assert alarms.update(12.0, {LOW: WARNING}).begun == ()  # less severe: still the same
    assert [a.acknowledged for a in alarms.all()] == [True]


def test_a_full_list_keeps_its_alarms_and_takes_no_new_ones() -> None:
    alarms = AlarmList()
    conditions: dict[Key, AlarmCondition] = {("platoon", i, "TICK_LATE"): WARNING for i in range(MOST_ALARMS + 100)}
    first = alarms.update(10.0, conditions).begun
    assert len(first) == MOST_ALARMS
    assert alarms.update(11.0, conditions).begun == ()
    del conditions["platoon", 0, "TICK_LATE"]
    assert len(alarms.update(12.0, conditions).ended) == 1
    assert len(alarms.update(13.0, conditions).begun) == 1  # in the place of the one that has ended


def test_the_most_severe_come_first_and_those_that_have_ended_last() -> None:
    alarms = AlarmList()
    alarms.update(9.0, {("platoon", 3, "SILENT"): CRITICAL})
    alarms.update(10.0, {LOW: WARNING})
    alarms.update(11.0, {LOW: WARNING, LATE: CRITICAL})
    assert [a.code for a in alarms.all()] == ["TICK_LATE", "BATTERY_LOW", "SILENT"]


@given(
    st.lists(st.dictionaries(st.tuples(st.just("f"), st.integers(1, 250), st.sampled_from("ABCDE")), st.just(WARNING)))
)
def test_any_history_keeps_all_present_conditions_and_no_alarm_twice(history: list[dict[Key, AlarmCondition]]) -> None:
    alarms = AlarmList()
    for time_s, conditions in enumerate(history):
        alarms.update(float(time_s), conditions)
        lasting = {(a.fleet, a.vehicle_id, a.code) for a in alarms.all() if a.until_s is None}
        assert lasting == conditions.keys()
    keys = [(a.fleet, a.vehicle_id, a.code) for a in alarms.all()]
    assert len(keys) == len(set(keys)) <= MOST_ALARMS


def test_a_flood_of_conditions_is_bounded_and_keeps_the_severe_ones() -> None:
    alarms = AlarmList()
    flood: dict[Key, AlarmCondition] = {("f", 1, f"CODE_{i}"): WARNING for i in range(2 * MOST_ALARMS)}
    alarms.update(1.0, flood | {LATE: CRITICAL})
    assert len(alarms.all()) == MOST_ALARMS
    assert alarms.all()[0].code == "TICK_LATE"
