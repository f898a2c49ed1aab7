"""The agent of a follower is killed in a column with gap filling: the vehicle may still fly in its slot."""

from pathlib import Path

import pytest

from common import ROOT
from companion.ground.changes import reference_change
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from process_fleet import fleet_in_formation
from sitl.flight.scenario import load_scenario

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240)]

LEAVING = ROOT / "config" / "scenarios" / "leaving.yaml"
OVERRIDES = ("stand_in.sensors=ideal", "stand_in.armable_after_s=1")
DEAD, OTHERS = 3, (1, 2, 4, 5)
ALL = (1, 2, 3, 4, 5)
AWAY = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 2.0], [8.0, 0.0, 2.0]], "max_speed_m_s": 3.0}


@pytest.mark.long
def test_the_gap_of_a_dead_follower_stays_open_also_after_the_fleet_moved(tmp_path: Path) -> None:
    with fleet_in_formation(load_scenario(LEAVING, OVERRIDES), tmp_path) as fleet:
        ground = fleet.ground
        fleet.kill(f"agent {DEAD}")

        ground.wait(lambda: any(event.startswith("1: GAP_KEPT: vehicle 3 left") for event in ground.events))
        statuses = [ground.newest[i] for i in OTHERS]
        fleet.session.command(OTHERS, CommandName.REFERENCE, 1.0, reference_change(AWAY, statuses))
        ground.wait(lambda: ground.newest[1].motion.position_enu_m[0] > 7.5)
        assert ground.phases(OTHERS) == {FlightPhase.FORMATION}
        assert {ground.newest[i].formation.slot.formation for i in OTHERS} == {0}
        assert [round(ground.newest[i].formation.slot.position_enu_m[0]) for i in OTHERS] == [0, -2, -6, -8]
        ground.order(CommandName.LAND, FlightPhase.OBSERVE, OTHERS)
