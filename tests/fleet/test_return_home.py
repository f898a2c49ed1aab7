"""`companion fleet return`: both vehicles fly home and land, also the one whose agent is killed on the way."""

from __future__ import annotations

import csv
import os
import signal
import time
from collections.abc import Callable, Collection
from math import dist
from pathlib import Path

import pytest
import yaml

from companion.cli.main import main
from companion.ground.commands import statuses_of
from companion.ground.session import FleetSession
from companion.types.flight import FlightPhase
from companion.types.status import Status
from processes import free_fleet_offset
from sitl.flight.files import truth_path
from sitl.flight.processes import FleetProcesses
from sitl.flight.scenario import scenario_from
from sitl.links.ports import zenoh_endpoint

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(200)]

LOW = {"px4": "RTL_RETURN_ALT: 3", "ardupilot": "RTL_ALT: 300, RTL_LOIT_TIME: 500"}
SCENARIO = """\
fleet:
  name: home
  origin: {{latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}}
  vehicles:
    - {{id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}}
    - {{id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0]}}
  neighbours: {{kind: edges, edges: [[1, 2]]}}
  takeoff_height_m: 2.0
starts_enu_m: {{1: [0.0, 0.0, 0.0], 2: [-3.0, 0.0, 0.0]}}
reference: {{kind: point, point_enu_m: [0.0, 5.0, 2.0]}}
stand_in: {{autopilot: {make}, sensors: ideal, armable_after_s: 1, parameters: {{{low}}}}}
timeline: [{{command: prepare}}]
"""
STARTS = {1: (0.0, 0.0), 2: (-3.0, 0.0)}


def wait(session: FleetSession, condition: Callable[[Status], bool], ids: Collection[int] = tuple(STARTS)) -> None:
    """Until the condition holds for all these vehicles."""
    end_s = time.monotonic() + 60.0
    while True:
        statuses = statuses_of(session.newest, ids, 10.0)
        if len(statuses) == len(ids) and all(map(condition, statuses.values())):
            return
        assert time.monotonic() < end_s, statuses
        time.sleep(0.05)


def true_end(folder: Path, vehicle_id: int) -> tuple[tuple[float, float, float], bool]:
    """Its true position and whether it is armed, by the newest row of its truth file."""
    lines = truth_path(folder, vehicle_id).read_text(encoding="ascii").splitlines(keepends=True)
    *_, last = csv.DictReader(line for line in lines if line.endswith("\n"))
    return (float(last["x_m"]), float(last["y_m"]), float(last["z_m"])), last["armed"] == "1"


@pytest.mark.parametrize("make", ["px4", pytest.param("ardupilot", marks=pytest.mark.long)])
def test_both_vehicles_return_home_also_without_an_agent(tmp_path: Path, make: str) -> None:
    offset = free_fleet_offset()
    text = SCENARIO.format(make=make, low=LOW[make])
    endpoints = [zenoh_endpoint(i, offset) for i in STARTS]

    def command(*action: str) -> int:
        file = str(tmp_path / "fleet.yaml")
        return main(["fleet", *action, "--fleet", file, "--connect", *endpoints, "--wait-s", "10", "--as", "anna"])

    with (
        FleetProcesses.start(
            scenario_from(tmp_path / "scenario.yaml", yaml.safe_load(text)), tmp_path, offset
        ) as fleet,
        FleetSession("home", endpoints) as session,
    ):
        wait(session, lambda _: True)
        for name, phase in (
            ("arm", FlightPhase.ARMED),
            ("takeoff", FlightPhase.HOLD),
            ("form", FlightPhase.FORMATION),
        ):
            end_s = time.monotonic() + 60.0
            while command(name):  # not ready yet
                assert time.monotonic() < end_s
                time.sleep(0.5)
            wait(session, lambda status, wanted=phase: status.phase is wanted)  # type: ignore[misc]
        wait(session, lambda status: status.motion.position_enu_m[1] > 4.0)
        assert command("return", "--no-wait") == 0
        wait(session, lambda status: status.phase is FlightPhase.RETURN and status.autopilot.mode_name.endswith("RTL"))
        os.kill(fleet.pid_of("agent 1"), signal.SIGKILL)

        end_s = time.monotonic() + 60.0
        while any(true_end(tmp_path, i)[1] for i in STARTS):
            assert time.monotonic() < end_s
            time.sleep(0.2)
        for vehicle_id, start in STARTS.items():
            (x, y, z), _ = true_end(tmp_path, vehicle_id)
            assert dist((x, y), start) < 0.7
            assert z < 0.1
        wait(session, lambda status: status.phase is FlightPhase.OBSERVE and not status.autopilot.armed, [2])
