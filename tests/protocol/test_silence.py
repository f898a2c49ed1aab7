"""When the agent must say nothing, as the autopilot's end of the wire has it: a real agent, a real stand-in, both processes.

The strict limits of time are tested in virtual time (tests/unit/test_agent.py). Here no limit breaks because a machine
is busy: what counts is how many setpoints came for how many positions, and which of two things came first.
"""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
from agent_process import AgentFiles, Running, agent, agent_files, until
from stand_in_process import StandInProcess, stand_in
from wire_tap import WireTap

from companion.ground.session import FleetSession
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.types import CommandName, FlightPhase, Status

# A lost stream ends in Hold after a second, as the README advises.
STAND_IN = "id: 1\nstand_in: {sensors: ideal, parameters: {COM_OBL_RC_ACT: 5}}\n"
HOLD_MODE = "LOITER"
UNDER_WAY = 2  # setpoints that may have left before the agent could know


@dataclass
class Flight:
    """One vehicle in the air with all its processes, and who speaks to it."""

    files: AgentFiles
    stand_in: StandInProcess
    tap: WireTap
    session: FleetSession
    status: Status | None = None

    @property
    def phase(self) -> FlightPhase | None:
        for report in self.session.drain():
            self.status = report.status
        return self.status.phase if self.status else None

    def order(self, name: CommandName, phase: FlightPhase) -> None:
        """Give a command until it has led to that phase."""

        def is_there() -> bool:
            if self.phase is not phase:
                self.session.command([1], name, 1.0)
            end_s = time.monotonic() + 1.0
            while self.phase is not phase and time.monotonic() < end_s:
                time.sleep(0.02)
            return self.phase is phase

        until(is_there, 60.0)

    def form(self) -> None:
        """From wherever it is into a formation that has flown for a moment."""
        self.tap.is_cut = False
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
        ):
            if not self.stand_in.truth() or self.stand_in.truth()[-1].z_m < 1.0:
                self.order(name, phase)
        if self.phase is not FlightPhase.FORMATION:
            self.order(CommandName.HOLD, FlightPhase.HOLD)
            self.order(CommandName.FORM, FlightPhase.FORMATION)
        start_s = time.monotonic()
        until(lambda: len(self.tap.setpoints_since(start_s)) > 25)

    def observes_and_says_nothing(self, seconds: float) -> None:
        """Neither setpoints nor commands in this time; the autopilot, which would take a stream, keeps its own mode."""
        start_s, commands = time.monotonic(), len(self.tap.commands)
        time.sleep(seconds)
        assert self.phase is FlightPhase.OBSERVE
        assert self.tap.setpoints_since(start_s) == []
        assert self.tap.commands[commands:] == []
        assert len(self.tap.positions_since(start_s)) > 10  # it had what to decide on
        assert self.stand_in.truth()[-1].mode != "OFFBOARD"


@contextmanager
def in_the_air(folder: Path) -> Iterator[Flight]:
    with stand_in(folder, STAND_IN) as autopilot:
        files = agent_files(folder)
        with (
            WireTap(autopilot.ports.companion, files.udp_port) as tap,
            FleetSession.open("processtest", (files.zenoh,)) as session,
        ):
            yield Flight(files, autopilot, tap, session)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Flight, Running]]:
    """One flight for the tests that leave the agent alive; each goes into formation by itself."""
    with in_the_air(tmp_path_factory.mktemp("silence")) as flight, agent(flight.files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        yield flight, process


def test_without_positions_nothing_is_said_and_a_short_gap_is_flown_over(flight: tuple[Flight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    start_s = time.monotonic()
    vehicle.tap.is_cut = True
    time.sleep(0.3)
    vehicle.tap.is_cut = False
    until(lambda: len(vehicle.tap.setpoints_since(start_s + 0.3)) > 10)
    end_s = time.monotonic()
    # A setpoint for each position at the most: nothing is repeated, nothing is made up for.
    assert len(vehicle.tap.setpoints_since(start_s)) <= len(vehicle.tap.positions_since(start_s)) + UNDER_WAY
    assert max(b - a for a, b in gaps(vehicle.tap.setpoints_s, start_s - 0.1, end_s)) > 0.2
    assert vehicle.phase is FlightPhase.FORMATION


def test_positions_that_stay_away_end_the_stream_for_good(flight: tuple[Flight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    vehicle.tap.is_cut = True
    time.sleep(0.1)
    cut_s = time.monotonic()
    vehicle.stand_in.wait_for_mode(HOLD_MODE)  # the autopilot's own failsafe
    assert vehicle.tap.setpoints_since(cut_s) == []
    vehicle.tap.is_cut = False
    until(lambda: vehicle.phase is FlightPhase.OBSERVE)
    vehicle.observes_and_says_nothing(2.0)


def test_a_frozen_agent_that_goes_on_makes_up_for_nothing(flight: tuple[Flight, Running]) -> None:
    vehicle, process = flight
    vehicle.form()
    process.process.send_signal(signal.SIGSTOP)
    time.sleep(0.02)  # what had left arrives
    stopped_s = time.monotonic()
    time.sleep(0.3)
    assert vehicle.tap.setpoints_since(stopped_s) == []
    assert len(vehicle.tap.positions_since(stopped_s)) > 8
    resumed_s = time.monotonic()
    process.process.send_signal(signal.SIGCONT)
    until(lambda: len(vehicle.tap.setpoints_since(resumed_s)) > 10)
    assert len(vehicle.tap.setpoints_since(resumed_s)) <= len(vehicle.tap.positions_since(resumed_s)) + UNDER_WAY


def test_an_agent_that_was_frozen_for_longer_observes(flight: tuple[Flight, Running]) -> None:
    vehicle, process = flight
    vehicle.form()
    process.process.send_signal(signal.SIGSTOP)
    time.sleep(0.02)
    stopped_s = time.monotonic()
    vehicle.stand_in.wait_for_mode(HOLD_MODE)
    process.process.send_signal(signal.SIGCONT)
    until(lambda: vehicle.phase is FlightPhase.OBSERVE)
    assert vehicle.tap.setpoints_since(stopped_s) == []
    vehicle.observes_and_says_nothing(2.0)


def test_a_pilots_mode_ends_the_stream_until_the_next_command(flight: tuple[Flight, Running]) -> None:
    vehicle, process = flight
    vehicle.form()
    before_s = time.monotonic()
    observed = process.log.count("formation -> observe")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pilot:
        change = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 4, 3, 0, 0, 0, 0)
        data = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER).encode(change)
        pilot.sendto(data, ("127.0.0.1", vehicle.stand_in.ports.ground_link))
        until(lambda: process.log.count("formation -> observe") > observed)
    seen_s = min(at_s for at_s in vehicle.tap.other_modes_s if at_s > before_s)
    vehicle.observes_and_says_nothing(2.0)
    assert len(vehicle.tap.setpoints_since(seen_s)) <= UNDER_WAY
    vehicle.form()
    vehicle.stand_in.wait_for_mode("OFFBOARD")


def test_killed_and_started_again_in_the_air_it_observes(tmp_path: Path) -> None:
    with in_the_air(tmp_path) as vehicle:
        with agent(vehicle.files) as first:
            first.wait_for_log("heartbeat of autopilot 1")
            vehicle.form()
            first.process.kill()
            first.process.wait()
            time.sleep(0.05)
            killed_s = time.monotonic()
        commands = len(vehicle.tap.commands)
        with agent(vehicle.files) as second:
            second.wait_for_log("heartbeat of autopilot 1")
            vehicle.stand_in.wait_for_mode(HOLD_MODE)
            vehicle.status = None
            until(lambda: vehicle.phase is not None)
            vehicle.observes_and_says_nothing(3.0)
            assert vehicle.tap.setpoints_since(killed_s) == []
            assert vehicle.tap.commands[commands:] == []
            assert vehicle.stand_in.truth()[-1].armed
            vehicle.form()  # and it flies on when it is told to
            vehicle.order(CommandName.LAND, FlightPhase.OBSERVE)


def gaps(times_s: list[float], from_s: float, to_s: float) -> list[tuple[float, float]]:
    within = [at_s for at_s in times_s if from_s <= at_s <= to_s]
    return list(pairwise(within))
