"""The load of the monitor: its reports are such as agents publish, and its fleet file is one."""

from __future__ import annotations

import socket
from math import dist
from pathlib import Path

import pytest

from companion.config.fleet_check import load_fleet
from companion.wire.messages import decode_report, encode
from tests.bench.monitor_load import OFF_SLOT_M, main, steady_fleet, write_fleet

pytestmark = pytest.mark.long


@pytest.mark.parametrize("vehicles", [1, 2, 50])
def test_every_report_passes_the_checks_of_the_ground(vehicles: int) -> None:
    load = steady_fleet("load", vehicles)
    for time_s in (0.0, 12.3, 3600.0):
        for i in load.vehicle_ids:
            report = load.report(i, time_s)
            assert decode_report(encode(report)) == report


def test_vehicles_are_near_their_slots_and_one_leads() -> None:
    load = steady_fleet("load", 9)
    statuses = [load.report(i, 40.0).status for i in load.vehicle_ids]
    (reference_enu_m,) = [s.formation.reference_enu_m for s in statuses if s.formation.reference_enu_m is not None]
    for status in statuses:
        slot = [a + b for a, b in zip(reference_enu_m, status.formation.slot.position_enu_m, strict=True)]
        assert dist(status.motion.position_enu_m, slot) < 2.0 * OFF_SLOT_M
        assert sum(status.neighbourhood.weights) == pytest.approx(1.0)


def test_its_fleet_file_is_that_of_its_reports(tmp_path: Path) -> None:
    load, file = steady_fleet("load", 5), tmp_path / "fleet.yaml"
    write_fleet(load.fleet, file)
    assert load_fleet(file).formation_hash() == load.report(1, 0.0).status.agent.formation_hash


def test_a_port_in_use_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        assert main(["--vehicles", "1", "--port", str(other.getsockname()[1])]) == 2
    assert "the port is in use" in capsys.readouterr().err
