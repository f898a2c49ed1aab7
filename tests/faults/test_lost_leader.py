"""The leader's agent is killed in formation: the followers, which still hear each other, must notice and stop by themselves."""

import os
import signal
import time
from pathlib import Path

import pytest

from companion.ground.session import FleetSession
from companion.types import CommandName, FlightPhase, Status
from sitl.fleet import Fleet, endpoint_of
from sitl.scenario import load_scenario

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
PORT_OFFSET = 2700
FOLLOWERS = (2, 3, 4)
ALL = (1, *FOLLOWERS)


class Ground:
    """A ground station: commands to the fleet, and the newest status of every vehicle."""

    def __init__(self, session: FleetSession) -> None:
        self._session = session
        self.newest: dict[int, Status] = {}
        self.events: set[str] = set()

    def listen(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            for report in self._session.drain():
                self.newest[report.status.vehicle_id] = report.status
                self.events.add(f"{report.status.vehicle_id}: {report.status.last_event}")
            time.sleep(0.02)

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
    scenario = load_scenario(PLATOON, [])
    with Fleet.start(scenario, tmp_path, PORT_OFFSET) as fleet:
        endpoints = [endpoint_of(i, PORT_OFFSET) for i in FOLLOWERS]
        with FleetSession.open("platoon", endpoints) as session:
            ground = Ground(session)
            for name, phase in (
                (CommandName.PREPARE, FlightPhase.READY),
                (CommandName.ARM, FlightPhase.ARMED),
                (CommandName.TAKEOFF, FlightPhase.HOLD),
                (CommandName.FORM, FlightPhase.FORMATION),
            ):
                ground.order(name, phase)
            ground.listen(2.0)
            assert ground.phases(ALL) == {FlightPhase.FORMATION}

            os.kill(fleet.pid_of("agent 1"), signal.SIGKILL)
            ground.listen(3.0)

            assert ground.phases(FOLLOWERS) == {FlightPhase.HOLD}, ground.newest
            for follower in FOLLOWERS:
                assert any(e.startswith(f"{follower}: formation -> release (no leader's word") for e in ground.events)
            ground.order(CommandName.LAND, FlightPhase.OBSERVE, FOLLOWERS)
