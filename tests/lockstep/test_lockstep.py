"""Whole flights in virtual time: the paper's platoon, bit-identical each time."""

import io
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from common import ROOT
from companion.core.report import Decision
from companion.link.tick import BACK_UP_S, PREPARED_S
from companion.types.autopilot import PositionSample
from companion.types.flight import FlightPhase
from companion.types.tick import Inbox
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import load_scenario, reference_of
from sitl.flight.virtual_flight import Flown, fly_in_virtual_time
from sitl.report.metrics import FormationFigures, formation_figures, stand_at
from sitl.report.progress import FlightProgress

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
NOISY = "stand_in.sensors=default"
SHORT = "timeline[3].for_s=8"
BAD_NETWORK = ("links.peer_loss=0.1", "links.peer_delay_s=0.1")


def fly(*overrides: str) -> Flown:
    return fly_in_virtual_time(load_scenario(PLATOON, overrides), FlightProgress("test", True, 0.0))


@cache
def flown(*overrides: str) -> Flown:
    return fly(*overrides)


@cache
def figures(*overrides: str) -> FormationFigures:
    flight = flown(*overrides)
    assert flight.failure is None
    assert flight.watch.formation is not None
    scenario = load_scenario(PLATOON, overrides)
    slots_enu_m = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    return formation_figures(flight.tracks(), stand_at(slots_enu_m), reference_of(scenario), flight.watch.formation)


def are_equal(one: Flown, other: Flown) -> bool:
    """Whether two flights are bit-identical."""
    return all(
        np.array_equal(one.tracks()[i].position_enu_m, other.tracks()[i].position_enu_m)
        and np.array_equal(one.tracks()[i].time_s, other.tracks()[i].time_s)
        for i in one.tracks()
    )


# ---------------------------------------------------------------- the same again


@pytest.mark.parametrize("overrides", [pytest.param((SHORT,), marks=pytest.mark.long), (SHORT, NOISY, *BAD_NETWORK)])
def test_two_flights_of_one_scenario_are_identical(overrides: tuple[str, ...]) -> None:
    first, second = flown(*overrides), fly(*overrides)
    assert are_equal(first, second)
    assert first.watch.events == second.watch.events
    assert first.watch.formation == second.watch.formation
    assert first.flight_s == second.flight_s


def test_another_seed_gives_another_flight() -> None:
    assert not are_equal(flown(SHORT, NOISY), flown(SHORT, NOISY, "stand_in.seed=2"))


def test_loss_and_delay_change_the_flight_but_the_platoon_settles() -> None:
    disturbed = flown(SHORT, *BAD_NETWORK)
    assert disturbed.failure is None
    assert not are_equal(flown(SHORT), disturbed)


# ---------------------------------------------------------------- the paper's figures


def test_the_weighted_law_keeps_the_platoon_closer_and_settles_faster() -> None:
    laws = ("weighted", "average_22", "average_26")
    weighted, *averages = (figures("timeline[3].for_s=45", f"fleet.law.name={law}") for law in laws)
    assert weighted.max_distance_m["1-2"] <= 1.90
    assert weighted.settle_s is not None
    assert weighted.final_error_m <= 0.05
    for average in averages:
        assert weighted.max_distance_m["1-2"] < average.max_distance_m["1-2"]
        assert average.settle_s is None or weighted.settle_s < average.settle_s


def test_distances_without_lag_equal_the_papers() -> None:
    ideal = figures(SHORT, "stand_in.airframe.attitude=instant", "stand_in.airframe.motor_lag_s=0")
    assert ideal.max_distance_m["1-2"] <= 1.76
    assert ideal.max_distance_m["1-2"] == pytest.approx(1.754, abs=0.02)


def test_the_platoon_keeps_formation_with_sensor_noise() -> None:
    noisy = figures(NOISY, "timeline[3].for_s=45")
    assert noisy.final_error_m <= 0.30
    assert min(noisy.min_distance_m.values()) >= 0.8


# ---------------------------------------------------------------- how it is flown


def test_the_director_flies_the_timeline() -> None:
    flight = flown(SHORT)
    assert flight.failure is None
    assert figures(SHORT).duration_s == pytest.approx(8.0, abs=0.1)
    landed = [event.vehicle for event in flight.watch.events if event.event == "land -> observe"]
    assert sorted(landed) == [1, 2, 3, 4]
    assert flight.watch.timing == {}  # no tick is late in virtual time


def test_a_flight_that_cannot_start_gives_the_reason() -> None:
    flight = fly_in_virtual_time(load_scenario(PLATOON, ["timeline[1].timeout_s=1"]), FlightProgress("test", True, 0.0))
    assert flight.failure is not None
    assert flight.failure.startswith("arm not done within 1 s: vehicles 1, 2, 3, 4")
    assert flight.watch.formation is None


def test_followers_without_peers_hand_over_to_the_autopilot() -> None:
    flight = fly_in_virtual_time(
        load_scenario(PLATOON, [SHORT, "links.peer_loss=1"]), FlightProgress("test", True, 0.0)
    )
    assert flight.failure is not None
    assert "LEADER_LOST" in flight.failure
    for vehicle_id in (1, 2, 3, 4):
        status = flight.watch.status(vehicle_id)
        assert status is not None
        assert not status.autopilot.armed
        assert status.phase is FlightPhase.OBSERVE


def test_progress_is_shown_in_virtual_time() -> None:
    shown = io.StringIO()
    fly_in_virtual_time(load_scenario(PLATOON, [SHORT]), FlightProgress("platoon", False, 0.0, shown))
    assert "step 4 of 5, form   0." in shown.getvalue()
    lines = shown.getvalue().splitlines()
    assert all(line.startswith("platoon   step ") for line in lines)  # no terminal: a line each time, no table
    assert any(line.endswith("all formation, at most 1.00 m from the slot (vehicle 4)") for line in lines)


# ---------------------------------------------------------------- when the parts of a tick run


def inboxes(seconds: float, *overrides: str) -> tuple[Lockstep, list[tuple[float, Inbox]]]:
    """The fleet after so many seconds on the ground, and time and input of each tick of vehicle 2."""
    lockstep, seen = Lockstep(load_scenario(PLATOON, overrides)), list[tuple[float, Inbox]]()
    agent = lockstep.vehicles[2].agent
    decide = agent.decide

    def decided(now_s: float, inbox: Inbox) -> Decision:
        seen.append((now_s, inbox))
        return decide(now_s, inbox)

    agent.decide = decided  # type: ignore[method-assign]
    lockstep.sleep(seconds)
    lockstep.close()
    return lockstep, seen


def test_a_tick_is_prepared_2_ms_before_and_packets_come_between() -> None:
    """The positions come every 4 ms of some vehicle: packets that take 3 ms arrive 1 ms before a tick."""
    _, seen = inboxes(1.0, "links.peer_delay_s=0.003")
    steady = seen[10:]
    assert [now_s - (inbox.prepared_s or 0.0) for now_s, inbox in steady] == pytest.approx([PREPARED_S] * len(steady))
    between = [inbox.peers[inbox.early :] for _, inbox in steady]
    assert any(between)
    assert {late.received_s for late_ones in between for late in late_ones} <= {now_s for now_s, _ in steady}


def test_without_positions_an_agent_ticks_by_its_back_up_timer() -> None:
    late = "links.late_telemetry=[{vehicle: 2, from_s: 0.5, until_s: 0.8, delay_s: 0.3}]"
    _, seen = inboxes(1.5, late)
    times_s = [now_s for now_s, _ in seen]
    assert max(b - a for a, b in pairwise(times_s)) == pytest.approx(BACK_UP_S)
    without = [now_s for now_s, inbox in seen if not any(isinstance(one, PositionSample) for one in inbox.telemetry)]
    assert len(without) >= 9
