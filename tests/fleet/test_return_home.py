"""`companion fleet return` by real processes: home and down, also of the vehicle whose agent is killed on the way."""

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

from companion.cli import main
from companion.ground.session import FleetSession
from companion.types import FlightPhase, Status
from sitl.fleet import Fleet, endpoint_of, truth_path
from sitl.scenario import scenario_from

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(200)]

PORT_OFFSET = {"px4": 3150, "ardupilot": 3200}
LOW = {"px4": "RTL_RETURN_ALT: 4", "ardupilot": "RTL_ALT: 400, RTL_LOIT_TIME: 500"}
SCENARIO = """\
fleet:
  name: home
  origin: {{latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}}
  vehicles:
    - {{id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}}
    - {{id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0]}}
  neighbours: {{kind: edges, edges: [[1, 2]]}}
starts_enu_m: {{1: [0.0, 0.0, 0.0], 2: [-3.0, 0.0, 0.0]}}
reference: {{kind: point, point_enu_m: [0.0, 5.0, 2.5]}}
stand_in: {{autopilot: {make}, sensors: ideal, parameters: {{{low}}}}}
timeline: [{{command: prepare}}]
"""
STARTS = {1: (0.0, 0.0), 2: (-3.0, 0.0)}


def wait(session: FleetSession, condition: Callable[[Status], bool], ids: Collection[int] = tuple(STARTS)) -> None:
    """Until it is so of these."""
    end_s = time.monotonic() + 60.0
    while True:
        heard = session.hear(ids, 10.0)
        if len(heard) == len(ids) and all(map(condition, heard.values())):
            return
        assert time.monotonic() < end_s, heard
        time.sleep(0.05)


def true_end(folder: Path, vehicle_id: int) -> tuple[tuple[float, float, float], bool]:
    """Where it truly is by now, and whether it is armed."""
    lines = truth_path(folder, vehicle_id).read_text(encoding="ascii").splitlines(keepends=True)
    *_, last = csv.DictReader(line for line in lines if line.endswith("\n"))
    return (float(last["x_m"]), float(last["y_m"]), float(last["z_m"])), last["armed"] == "1"


@pytest.mark.parametrize("make", ["px4", "ardupilot"])
def test_both_come_home_also_without_an_agent(tmp_path: Path, make: str) -> None:
    offset = PORT_OFFSET[make]
    text = SCENARIO.format(make=make, low=LOW[make])
    endpoints = [endpoint_of(i, offset) for i in STARTS]

    def command(name: str) -> int:
        file = str(tmp_path / "fleet.yaml")
        return main(["fleet", name, "--fleet", file, "--connect", *endpoints, "--wait-s", "10", "--as", "anna"])

    with (
        Fleet.start(scenario_from(tmp_path / "scenario.yaml", yaml.safe_load(text)), tmp_path, offset) as fleet,
        FleetSession.open("home", endpoints) as session,
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
        wait(session, lambda status: status.position_enu_m[1] > 4.0)
        assert command("return") == 0
        wait(session, lambda status: status.phase is FlightPhase.RETURN and status.mode_name.endswith("RTL"))
        os.kill(fleet.pid_of("agent 1"), signal.SIGKILL)

        end_s = time.monotonic() + 60.0
        while any(true_end(tmp_path, i)[1] for i in STARTS):
            assert time.monotonic() < end_s
            time.sleep(0.2)
        for vehicle_id, start in STARTS.items():
            (x, y, z), _ = true_end(tmp_path, vehicle_id)
            assert dist((x, y), start) < 0.7
            assert z < 0.1
        wait(session, lambda status: status.phase is FlightPhase.OBSERVE and not status.armed, [2])
