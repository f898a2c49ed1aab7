"""The agent of a follower is killed in a column with gap filling: the vehicle may still fly in its slot."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from common import ROOT
from companion.ground.changes import reference_change
from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from process_fleet import Ground
from processes import free_fleet_offset
from sitl.flight.processes import FleetProcesses
from sitl.flight.scenario import load_scenario
from sitl.links.ports import zenoh_endpoint

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240)]

LEAVING = ROOT / "config" / "scenarios" / "leaving.yaml"
OVERRIDES = ("stand_in.sensors=ideal", "stand_in.armable_after_s=1")
DEAD, OTHERS = 3, (1, 2, 4, 5)
ALL = (1, 2, 3, 4, 5)
AWAY = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 2.0], [8.0, 0.0, 2.0]], "max_speed_m_s": 3.0}


def until(ground: Ground, condition: Callable[[], bool], within_s: float = 40.0) -> None:
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s, (ground.newest, sorted(ground.events))
        ground.listen(0.1)


def test_the_gap_of_a_dead_follower_stays_open_also_after_the_fleet_moved(tmp_path: Path) -> None:
    port_offset = free_fleet_offset()
    with FleetProcesses.start(load_scenario(LEAVING, OVERRIDES), tmp_path, port_offset) as fleet:
        endpoints = [zenoh_endpoint(i, port_offset) for i in ALL]
        with FleetSession("leaving", endpoints) as session:
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

            until(ground, lambda: any(event.startswith("1: GAP_KEPT: vehicle 3 left") for event in ground.events))
            statuses = [ground.newest[i] for i in OTHERS]
            session.command(OTHERS, CommandName.REFERENCE, 1.0, reference_change(AWAY, statuses))
            until(ground, lambda: ground.newest[1].position_enu_m[0] > 7.5)
            assert ground.phases(OTHERS) == {FlightPhase.FORMATION}
            assert {ground.newest[i].slot.formation for i in OTHERS} == {0}
            assert [round(ground.newest[i].slot.position_enu_m[0]) for i in OTHERS] == [0, -2, -6, -8]
            ground.order(CommandName.LAND, FlightPhase.OBSERVE, OTHERS)
