"""When the agent must send no setpoints, measured at the autopilot's end of the link: a real agent, a real stand-in.

All tests run with both makes. Time limits are tested in virtual time (tests/unit/core). The limits here do not depend on the
load of the machine: they compare the number of setpoints with that of positions, and the order of events.
"""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from itertools import pairwise

import pytest

from common import until
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.types.flight import FlightPhase
from processes import Running, agent
from wire_autopilots import ENDS, UNDER_WAY, TappedFlight


@pytest.fixture(scope="module")
def flight(vehicle: TappedFlight) -> Iterator[tuple[TappedFlight, Running]]:
    """With one agent for all tests; each enters formation by itself."""
    with agent(vehicle.files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        yield vehicle, process


def test_a_short_gap_in_positions_pauses_the_stream(flight: tuple[TappedFlight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    start_s = time.monotonic()
    vehicle.tap.is_cut = True
    time.sleep(0.3)
    vehicle.tap.is_cut = False
    until(lambda: len(vehicle.tap.setpoints_since(start_s + 0.3)) > 10)
    # At most one setpoint for each position, and the last one: none is repeated, none is sent later.
    setpoints = vehicle.tap.setpoints_since(start_s)
    assert len(setpoints) <= len(vehicle.tap.positions_since(start_s)) + UNDER_WAY + ENDS
    times_s = [setpoint.at_s for setpoint in vehicle.tap.setpoints_since(start_s - 0.1)]
    assert max(b - a for a, b in pairwise(times_s)) > 0.15
    assert vehicle.phase is FlightPhase.FORMATION


def test_without_telemetry_the_stream_ends_for_good(flight: tuple[TappedFlight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    cut_s = time.monotonic()
    vehicle.tap.is_cut = True
    if vehicle.make.leaves_formation_by_itself:
        vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)  # failsafe of the autopilot
    else:
        until(lambda: vehicle.phase is FlightPhase.OBSERVE)
    assert vehicle.is_silent(cut_s)
    vehicle.tap.is_cut = False
    if vehicle.make.leaves_formation_by_itself:
        until(lambda: vehicle.phase is FlightPhase.OBSERVE)
        vehicle.observes_and_sends_nothing(2.0)
    else:  # it still waits for setpoints and drifts: no pilot has taken over
        until(lambda: vehicle.phase is FlightPhase.HOLD)
        vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
    assert vehicle.is_silent(cut_s)


def test_an_agent_resumed_after_a_pause_sends_no_late_setpoints(flight: tuple[TappedFlight, Running]) -> None:
    vehicle, process = flight
    vehicle.form()
    process.process.send_signal(signal.SIGSTOP)
    time.sleep(0.02)  # what is on its way arrives
    stopped_s = time.monotonic()
    time.sleep(0.3)
    assert vehicle.tap.setpoints_since(stopped_s) == []
    assert len(vehicle.tap.positions_since(stopped_s)) > 8
    resumed_s = time.monotonic()
    process.process.send_signal(signal.SIGCONT)
    until(lambda: len(vehicle.tap.setpoints_since(resumed_s)) > 10)
    assert len(vehicle.tap.setpoints_since(resumed_s)) <= len(vehicle.tap.positions_since(resumed_s)) + UNDER_WAY


def test_an_agent_resumed_after_a_long_pause_observes(flight: tuple[TappedFlight, Running]) -> None:
    vehicle, process = flight
    vehicle.form()
    process.process.send_signal(signal.SIGSTOP)
    time.sleep(0.02)
    stopped_s = time.monotonic()
    if vehicle.make.leaves_formation_by_itself:
        vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
    else:
        time.sleep(1.5)
    assert vehicle.tap.setpoints_since(stopped_s) == []
    process.process.send_signal(signal.SIGCONT)
    until(lambda: vehicle.phase in (FlightPhase.OBSERVE, FlightPhase.HOLD))
    assert vehicle.tap.setpoints_since(stopped_s) == []
    if vehicle.make.leaves_formation_by_itself:
        vehicle.observes_and_sends_nothing(2.0)


def test_a_mode_set_by_a_pilot_ends_the_stream_until_the_next_command(flight: tuple[TappedFlight, Running]) -> None:
    vehicle, process = flight
    vehicle.form()
    before_s = time.monotonic()
    observed = process.log.count("formation -> observe")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pilot:
        mode = (1, *vehicle.make.pilots_mode, 0, 0, 0, 0)
        change = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *mode)
        data = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER).encode(change)
        pilot.sendto(data, ("127.0.0.1", vehicle.stand_in.ports.ground_link))
        until(lambda: process.log.count("formation -> observe") > observed)
    seen_s = min(at_s for at_s in vehicle.tap.other_modes_s if at_s > before_s)
    vehicle.observes_and_sends_nothing(2.0)
    assert len(vehicle.tap.setpoints_since(seen_s)) <= UNDER_WAY
    vehicle.form()
    vehicle.stand_in.wait_for_mode(vehicle.make.formation_mode_name)


def test_without_positions_the_agent_requests_hold(flight: tuple[TappedFlight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    cut_s, commands = time.monotonic(), len(vehicle.tap.commands)
    vehicle.tap.withheld = "LOCAL_POSITION_NED"
    vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
    assert vehicle.is_silent(cut_s)
    asked = {(command.command, command.param2) for command in vehicle.tap.commands[commands:]}
    assert asked <= {
        (mavlink.MAV_CMD_DO_SET_MODE, vehicle.make.hold_mode)
    }  # none if the failsafe of the autopilot was faster
