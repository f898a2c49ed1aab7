"""A follower's agent is killed in the middle of a column that would close up: for all that the others know, it may fly on."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from test_lost_leader import Ground

from companion.ground.references import reference_change
from companion.ground.session import FleetSession
from companion.types import CommandName, FlightPhase
from sitl.fleet import Fleet, endpoint_of
from sitl.scenario import load_scenario

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240)]

LEAVING = Path(__file__).parents[2] / "config" / "scenarios" / "leaving.yaml"
PORT_OFFSET = 3000
DEAD, OTHERS = 3, (1, 2, 4, 5)
ALL = (1, 2, 3, 4, 5)
AWAY = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 2.0], [8.0, 0.0, 2.0]], "max_speed_m_s": 3.0}


def until(ground: Ground, wanted: Callable[[], bool], within_s: float = 40.0) -> None:
    end_s = time.monotonic() + within_s
    while not wanted():
        assert time.monotonic() < end_s, (ground.newest, sorted(ground.events))
        ground.listen(0.1)


def test_the_gap_of_a_dead_follower_is_kept_also_when_the_fleet_is_away(tmp_path: Path) -> None:
    with Fleet.start(load_scenario(LEAVING, ["stand_in.sensors=ideal"]), tmp_path, PORT_OFFSET) as fleet:
        endpoints = [endpoint_of(i, PORT_OFFSET) for i in OTHERS]
        with FleetSession.open("leaving", endpoints) as session:
            ground = Ground(session)
            for name, phase in (
                (CommandName.PREPARE, FlightPhase.READY),
                (CommandName.ARM, FlightPhase.ARMED),
                (CommandName.TAKEOFF, FlightPhase.HOLD),
                (CommandName.FORM, FlightPhase.FORMATION),
            ):
                ground.order(name, phase, ALL)
            ground.listen(2.0)
            os.kill(fleet.pid_of(f"agent {DEAD}"), signal.SIGKILL)

            kept = (
                "1: vehicle 3 left, and its gap is kept for now: nothing is heard of it, and it may fly on in its slot"
            )
            until(ground, lambda: kept in ground.events)
            statuses = [ground.newest[i] for i in OTHERS]
            session.command(OTHERS, CommandName.REFERENCE, 1.0, reference_change(AWAY, statuses))
            until(ground, lambda: ground.newest[1].position_enu_m[0] > 7.5)
            assert ground.phases(OTHERS) == {FlightPhase.FORMATION}
            assert {ground.newest[i].slot.formation for i in OTHERS} == {0}
            assert [round(ground.newest[i].slot.position_enu_m[0]) for i in OTHERS] == [0, -2, -6, -8]
            ground.order(CommandName.LAND, FlightPhase.OBSERVE, OTHERS)
