"""The leader's agent is killed in formation: the followers, which still hear each other, must notice, and stop or be led on."""

import os
import signal
import time
from math import dist
from pathlib import Path

import pytest

from companion.ground.session import FleetSession
from companion.types import CommandName, FlightPhase, HealthFlag, Role, Status
from sitl.fleet import Fleet, endpoint_of
from sitl.scenario import load_scenario

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"
PORT_OFFSET = 2700
FOLLOWERS = (2, 3, 4)
ALL = (1, *FOLLOWERS)


class Ground:
    """A ground station: commands to the fleet, and the newest status of every vehicle."""

    def __init__(self, session: FleetSession) -> None:
        self._session = session
        self.newest: dict[int, Status] = {}
        self.events: set[str] = set()
        self.heard: list[tuple[float, Status]] = []

    def listen(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            for report in self._session.drain():
                self.newest[report.status.vehicle_id] = report.status
                self.heard.append((time.monotonic(), report.status))
                self.events.add(f"{report.status.vehicle_id}: {report.status.last_event}")
            time.sleep(0.02)

    def fly_to_formation(self) -> None:
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
            (CommandName.FORM, FlightPhase.FORMATION),
        ):
            self.order(name, phase)

    def phases(self, ids: tuple[int, ...]) -> set[FlightPhase | None]:
        return {self.newest[i].phase if i in self.newest else None for i in ids}

    def order(self, name: CommandName, phase: FlightPhase, ids: tuple[int, ...] = ALL, within_s: float = 40.0) -> None:
        """Give a command until every vehicle is in the phase that it leads to."""
        end_s = time.monotonic() + within_s
        while self.phases(ids) != {phase}:
            assert time.monotonic() < end_s, (name, self.newest)
            self._session.command([i for i in ids if self.phases((i,)) != {phase}], name, 0.5)
            self.listen(0.5)


def test_followers_that_hear_only_each_other_notice_a_dead_leader(tmp_path: Path) -> None:
    scenario = load_scenario(SCENARIOS / "platoon.yaml", [])
    with Fleet.start(scenario, tmp_path, PORT_OFFSET) as fleet:
        endpoints = [endpoint_of(i, PORT_OFFSET) for i in FOLLOWERS]
        with FleetSession.open("platoon", endpoints) as session:
            ground = Ground(session)
            ground.fly_to_formation()
            ground.listen(2.0)
            assert ground.phases(ALL) == {FlightPhase.FORMATION}

            os.kill(fleet.pid_of("agent 1"), signal.SIGKILL)
            ground.listen(3.0)

            assert ground.phases(FOLLOWERS) == {FlightPhase.HOLD}, ground.newest
            for follower in FOLLOWERS:
                assert any(e.startswith(f"{follower}: formation -> release (no leader's word") for e in ground.events)
            ground.order(CommandName.LAND, FlightPhase.OBSERVE, FOLLOWERS)


def test_a_successor_leads_on_where_the_leader_is_killed_in_the_middle_of_the_eight(tmp_path: Path) -> None:
    scenario = load_scenario(
        SCENARIOS / "ring_figure_8.yaml",
        ["fleet.successors=[2]", "fleet.law.name=cooperative", "fleet.land_after_s=20"],
    )
    with Fleet.start(scenario, tmp_path, PORT_OFFSET + 20) as fleet:
        endpoints = [endpoint_of(i, PORT_OFFSET + 20) for i in FOLLOWERS]
        with FleetSession.open("ring", endpoints) as session:
            ground = Ground(session)
            ground.fly_to_formation()
            ground.listen(15.0)
            assert ground.newest[1].role is Role.LEADER

            ground.heard.clear()
            died_s = time.monotonic()
            os.kill(fleet.pid_of("agent 1"), signal.SIGKILL)
            ground.listen(4.0)

            left = [(at_s, status) for at_s, status in ground.heard if status.vehicle_id in FOLLOWERS]
            assert {status.phase for _, status in left} == {FlightPhase.FORMATION}
            assert HealthFlag.LEADER_AWAITED in {flag for _, status in left for flag in status.flags}
            for vehicle_id in FOLLOWERS:
                own = [(at_s - died_s, status) for at_s, status in left if status.vehicle_id == vehicle_id]
                missed_s = [at_s for at_s, status in own if status.leader_word is None]
                led_s = [at_s for at_s, status in own if status.leader_word and status.leader_word.leader_id == 2]
                print(
                    f"vehicle {vehicle_id}: told of no leader after {min(missed_s):.2f} s, of 2 after {min(led_s):.2f} s"
                )
            assert [(ground.newest[i].role, ground.newest[i].epoch, ground.newest[i].prc) for i in FOLLOWERS] == [
                (Role.LEADER, 1, 1),
                (Role.FOLLOWER, 1, 2),
                (Role.FOLLOWER, 1, 3),
            ]
            reference_enu_m = ground.newest[2].reference_enu_m
            assert reference_enu_m is not None
            for status in (ground.newest[i] for i in FOLLOWERS):
                wanted = [r + d for r, d in zip(reference_enu_m, status.slot.position_enu_m, strict=True)]
                assert dist(status.position_enu_m, wanted) < 0.5
            ground.order(CommandName.LAND, FlightPhase.OBSERVE, FOLLOWERS)
