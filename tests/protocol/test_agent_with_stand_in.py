"""A whole flight of one agent process and one stand-in process, under a service manager."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common import until
from companion.ground.fleet_state import FleetState, ReportedVehicle, fold, vehicles_at
from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from processes import agent, agent_files, service_manager

PX4_COMPANION_PORT = 14540


@contextmanager
def stand_in(port_offset: int, log_file: Path) -> Iterator[None]:
    file = log_file.with_suffix(".yaml")
    # By default it would sink
    file.write_text("stand_in: {armable_after_s: 1, parameters: {COM_OBL_RC_ACT: 5}}\n", encoding="utf-8")
    with log_file.open("wb") as log:
        process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "from sitl.cli.main import main; main()",
                "autopilot",
                "--config",
                str(file),
                "--port-offset",
                str(port_offset),
            ],
            stderr=log,
            stdout=log,
        )
    try:
        yield
    finally:
        process.kill()
        process.wait()


def test_a_whole_flight(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with (
        service_manager(str(tmp_path / "notify")) as manager,
        agent(files, environment=manager.environment()) as process,
        FleetSession("processtest", (files.zenoh,)) as session,
    ):
        state = FleetState()

        def row() -> ReportedVehicle | None:
            nonlocal state
            manager.listen()  # the kernel keeps ten messages, not more
            for report in session.drain():
                state = fold(state, report, 0.0)
            return next(iter(vehicles_at(state, 0.0)), None)

        def now() -> ReportedVehicle:
            seen = row()
            assert seen
            return seen

        def do(name: CommandName, phase: FlightPhase) -> None:
            reply = session.command([1], name, 5.0)[1]
            until(lambda: now().status.phase is phase, 40.0)
            assert reply and reply.accepted, reply

        until(row)
        assert "READY=1" not in manager.listen()
        with stand_in(files.udp_port - PX4_COMPANION_PORT, tmp_path / "stand_in.log"):
            manager.wait_for("READY=1")
            until(lambda: getattr(session.command([1], CommandName.PREPARE, 5.0)[1], "accepted", False), 30.0)
            until(lambda: now().status.phase is FlightPhase.READY, 40.0)
            do(CommandName.ARM, FlightPhase.ARMED)
            do(CommandName.TAKEOFF, FlightPhase.HOLD)
            do(CommandName.FORM, FlightPhase.FORMATION)
            until(lambda: (error := now().error_to_slot_m) is not None and error < 0.3, 40.0)
            manager.forget()
            manager.wait_for("WATCHDOG=1")
            timing = now().report.timing
            do(CommandName.LAND, FlightPhase.OBSERVE)
            assert not now().status.autopilot.armed
            assert process.stop() == 0
        assert "STOPPING=1" in manager.listen()
    assert timing.rss_mb < 60.0
    assert timing.telemetry_to_command_us.p50 > 0.0
    assert "Traceback" not in process.log
