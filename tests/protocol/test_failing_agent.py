"""A real agent process that fails or is killed in formation flight, in wind that tilts every setpoint of the law, and the next.

tests/unit/link/test_failing_stages.py has every stage, in virtual time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from common import until
from companion.core.consensus.stage import ConsensusStage
from companion.ground.session import GroundConnection
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.fleet.zenoh_session import drain
from companion.types.commands import CommandName
from companion.types.errors import EXIT_DEFECT
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.values import ZERO3
from companion.wire.keys import peer_key
from companion.wire.messages import decode_peer
from processes import agent, faulty_agent
from wire_autopilots import UNDER_WAY, TappedFlight

PEER_KEY = peer_key("processtest", 1)
PACKETS_KEPT = 256  # a few seconds


@pytest.mark.parametrize("stage", [ConsensusStage.step, ZenohLink.publish_peer], ids=["consensus", "publishing"])
def test_a_failing_stage_ends_in_hold_and_a_restarted_agent_observes(
    vehicle: TappedFlight, tmp_path: Path, stage: Callable[..., object]
) -> None:
    make, switch = vehicle.make, tmp_path / "switch"
    with faulty_agent(vehicle.files, stage, switch) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        vehicle.forget_reports()  # those of the agent before
        vehicle.form()
        assert not vehicle.tap.setpoints[-1].is_level
        with GroundConnection((vehicle.files.zenoh,)) as connection:
            packets = connection.session.declare_subscriber(PEER_KEY, zenoh.handlers.RingChannel(PACKETS_KEPT))
            until(packets.try_recv)
            switch.touch()
            failed_s = time.monotonic()
            assert process.process.wait(20.0) == EXIT_DEFECT
            received = [decode_peer(sample.payload.to_bytes()) for sample in drain(packets, PACKETS_KEPT)]
    if stage is not ZenohLink.publish_peer:
        assert received[-1].phase is FlightPhase.RELEASE
        assert received[-1].motion.acceleration_enu_m_s2 == ZERO3
    vehicle.stand_in.wait_for_mode(make.hold_mode_name)
    last = vehicle.tap.setpoints[-1]
    assert last.is_level
    assert last.thrust_norm == pytest.approx(make.hover_thrust_norm, rel=0.1)
    law = [setpoint for setpoint in vehicle.tap.setpoints_since(failed_s) if not setpoint.is_level]
    assert len(law) <= UNDER_WAY
    event = vehicle.newest_event()
    assert event is not None
    assert event.code is Code.AGENT_FAILED
    switch.unlink()
    with agent(vehicle.files) as second:
        second.wait_for_log("heartbeat of autopilot 1")
        vehicle.forget_reports()
        until(lambda: vehicle.phase is FlightPhase.OBSERVE)
        vehicle.observes_and_sends_nothing(1.0)
        assert vehicle.stand_in.newest.mode == make.hold_mode_name
    print(f"\nlevel setpoints for {(last.at_s - failed_s) * 1000:.0f} ms after the switch")


def test_an_agent_killed_and_restarted_in_flight_observes(vehicle: TappedFlight) -> None:
    with agent(vehicle.files) as first:
        first.wait_for_log("heartbeat of autopilot 1")
        vehicle.forget_reports()  # those of the agent before
        vehicle.form()
        first.process.kill()
        first.process.wait()
        time.sleep(0.05)
        killed_s = time.monotonic()
    commands = len(vehicle.tap.commands)
    with agent(vehicle.files) as second:
        second.wait_for_log("heartbeat of autopilot 1")
        if vehicle.make.leaves_formation_by_itself:
            vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
        vehicle.forget_reports()
        until(lambda: vehicle.phase is not None)
        vehicle.observes_and_sends_nothing(3.0)
        assert vehicle.tap.setpoints_since(killed_s) == []
        assert vehicle.tap.commands[commands:] == []
        assert vehicle.stand_in.newest.armed
        vehicle.form()  # flies again on command
        vehicle.order(CommandName.LAND, FlightPhase.OBSERVE)
