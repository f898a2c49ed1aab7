"""The agent of the leader is killed in formation: the followers detect it and hold, or follow a successor."""

import time
from math import dist
from pathlib import Path

import pytest

from common import ROOT
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.notices import Code
from process_fleet import fleet_in_formation
from sitl.flight.scenario import load_scenario

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

SCENARIOS = ROOT / "config" / "scenarios"
READY_SOON = "stand_in.armable_after_s=1"
AT_FULL_SPEED_S = 15.0  # after forming
FOLLOWERS = (2, 3, 4)
ALL = (1, *FOLLOWERS)


@pytest.mark.long
def test_followers_hold_when_the_leader_dies(tmp_path: Path) -> None:
    scenario = load_scenario(SCENARIOS / "platoon.yaml", [READY_SOON])
    with fleet_in_formation(scenario, tmp_path) as fleet:
        ground = fleet.ground
        fleet.kill("agent 1")
        ground.listen(3.0)

        assert ground.phases(FOLLOWERS) == {FlightPhase.HOLD}, ground.newest
        for follower in FOLLOWERS:
            assert any(e.startswith(f"{follower}: {Code.LEADER_LOST}: formation -> release") for e in ground.events)
        ground.order(CommandName.LAND, FlightPhase.OBSERVE, FOLLOWERS)


def test_a_successor_becomes_leader_when_the_leader_dies_on_the_figure_8(tmp_path: Path) -> None:
    scenario = load_scenario(
        SCENARIOS / "ring_figure_8.yaml",
        [READY_SOON, "fleet.successors=[2]", "fleet.law.name=cooperative", "fleet.land_after_s=20"],
    )
    with fleet_in_formation(scenario, tmp_path) as fleet:
        ground = fleet.ground
        ground.listen(AT_FULL_SPEED_S)
        assert ground.newest[1].leadership.role is Role.LEADER

        ground.received.clear()
        died_s = time.monotonic()
        fleet.kill("agent 1")
        ground.listen(4.0)

        left = [(at_s, status) for at_s, status in ground.received if status.agent.vehicle_id in FOLLOWERS]
        assert {status.phase for _, status in left} == {FlightPhase.FORMATION}
        assert HealthFlag.LEADER_AWAITED in {flag for _, status in left for flag in status.safety.flags}
        for vehicle_id in FOLLOWERS:
            own = [(at_s - died_s, status) for at_s, status in left if status.agent.vehicle_id == vehicle_id]
            missed_s = [at_s for at_s, status in own if status.leadership.leader_beacon is None]
            led_s = [
                at_s
                for at_s, status in own
                if status.leadership.leader_beacon and status.leadership.leader_beacon.leader_id == 2
            ]
            print(f"vehicle {vehicle_id}: leader lost after {min(missed_s):.2f} s, follows 2 after {min(led_s):.2f} s")
        assert [
            (ground.newest[i].leadership.role, ground.newest[i].leadership.epoch, ground.newest[i].leadership.prc)
            for i in FOLLOWERS
        ] == [
            (Role.LEADER, 1, 1),
            (Role.FOLLOWER, 1, 2),
            (Role.FOLLOWER, 1, 3),
        ]
        reference_enu_m = ground.newest[2].formation.reference_enu_m
        assert reference_enu_m is not None
        for status in (ground.newest[i] for i in FOLLOWERS):
            wanted = [r + d for r, d in zip(reference_enu_m, status.formation.slot.position_enu_m, strict=True)]
            assert dist(status.motion.position_enu_m, wanted) < 0.5
        ground.order(CommandName.LAND, FlightPhase.OBSERVE, FOLLOWERS)
