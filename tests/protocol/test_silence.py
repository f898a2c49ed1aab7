"""When the agent must say nothing, as the autopilot's end of the wire has it: a real agent, a real stand-in, both processes.

All of it with both makes. The strict limits of time are tested in virtual time (tests/unit/test_agent.py, test_manners.py).
Here no limit breaks because a machine is busy: what counts is how many setpoints came for how many positions, and which of
two things came first. In the wind that blows here no setpoint of the law is level, so that a last word can be told from it.
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
from wire_tap import Setpoint, WireTap

from companion.ground.session import FleetSession
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.types import CommandName, FlightPhase, Status

UNDER_WAY = 2  # setpoints that may have left before the agent could know
CLIMBED_M = 1.0


@dataclass(frozen=True)
class Make:
    """What differs from one autopilot to the other. `last_words` is how many level setpoints begin a silence."""

    stand_in: str
    formation_mode: int
    mode_message: str
    formation_mode_name: str
    hold_mode: int  # these are of DO_SET_MODE
    hold_mode_name: str
    pilots_mode: tuple[int, int]
    hover_thrust_norm: float
    last_words: int
    leaves_formation_by_itself: bool  # where setpoints stay away


# A PX4 without its stream ends in Hold after a second, as the README advises.
PX4 = Make(
    stand_in="{sensors: ideal, wind: {mean_enu_m_s: [3.0, 0.0, 0.0]}, parameters: {COM_OBL_RC_ACT: 5}}",
    formation_mode=6 << 16,
    mode_message="CURRENT_MODE",
    formation_mode_name="OFFBOARD",
    hold_mode=4,
    hold_mode_name="LOITER",
    pilots_mode=(4, 3),
    hover_thrust_norm=0.49,
    last_words=0,
    leaves_formation_by_itself=True,
)
ARDUPILOT = Make(
    stand_in="{autopilot: ardupilot, armable_after_s: 3, sensors: ideal, wind: {mean_enu_m_s: [3.0, 0.0, 0.0]},"
    " parameters: {GUID_OPTIONS: 8}}",
    formation_mode=4,
    mode_message="HEARTBEAT",
    formation_mode_name="GUIDED",
    hold_mode=17,
    hold_mode_name="BRAKE",
    pilots_mode=(5, 0),
    hover_thrust_norm=0.365,
    last_words=1,
    leaves_formation_by_itself=False,
)


@dataclass
class Flight:
    """One vehicle in the air with all its processes, and who speaks to it."""

    make: Make
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
        self.tap.is_cut, self.tap.withheld = False, ""
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
        ):
            if not self.stand_in.truth() or self.stand_in.truth()[-1].z_m < CLIMBED_M:
                self.order(name, phase)
        if self.phase is not FlightPhase.FORMATION:
            self.order(CommandName.HOLD, FlightPhase.HOLD)
            self.order(CommandName.FORM, FlightPhase.FORMATION)
        start_s = time.monotonic()
        until(lambda: len(self.tap.setpoints_since(start_s)) > 25)

    def observes_and_says_nothing(self, seconds: float) -> None:
        """Neither setpoints nor commands in this time; a PX4, which would take a stream, keeps its own mode."""
        start_s, commands = time.monotonic(), len(self.tap.commands)
        time.sleep(seconds)
        assert self.phase is FlightPhase.OBSERVE
        assert self.tap.setpoints_since(start_s) == []
        assert self.tap.commands[commands:] == []
        assert len(self.tap.positions_since(start_s)) > 10  # it had what to decide on
        assert self.stand_in.truth()[-1].mode != "OFFBOARD"

    def fell_silent(self, since_s: float) -> bool:
        """No decision since then but those under way; to an autopilot that flies on, a last word that is level."""
        said = self.tap.setpoints_since(since_s)
        if self.make.last_words:
            last = self.tap.setpoints[-1]
            assert last.is_level
            assert last.thrust_norm == pytest.approx(self.make.hover_thrust_norm, rel=0.1)
        assert sum(setpoint.is_level for setpoint in said) <= self.make.last_words
        return sum(not setpoint.is_level for setpoint in said) <= UNDER_WAY

    def decisions_since(self, time_s: float) -> list[Setpoint]:
        """Setpoints but for last words."""
        return [setpoint for setpoint in self.tap.setpoints_since(time_s) if not setpoint.is_level]


@contextmanager
def in_the_air(folder: Path, make: Make) -> Iterator[Flight]:
    with stand_in(folder, f"id: 1\nstand_in: {make.stand_in}\n") as autopilot:
        files = agent_files(folder)
        words = files.file.read_text(encoding="utf-8")
        own = words.replace("hover_thrust_norm: 0.49", f"hover_thrust_norm: {make.hover_thrust_norm}")
        files.file.write_text(own, encoding="utf-8")
        with (
            WireTap(autopilot.ports.companion, files.udp_port, make.formation_mode, make.mode_message) as tap,
            FleetSession.open("processtest", (files.zenoh,)) as session,
        ):
            yield Flight(make, files, autopilot, tap, session)


@pytest.fixture(scope="module", params=[PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def flight(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Flight, Running]]:
    """One flight for the tests that leave the agent alive; each goes into formation by itself."""
    with in_the_air(tmp_path_factory.mktemp("silence"), request.param) as flight, agent(flight.files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        yield flight, process


def test_without_positions_nothing_is_said_and_a_short_gap_is_flown_over(flight: tuple[Flight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    start_s = time.monotonic()
    vehicle.tap.is_cut = True
    time.sleep(0.3)
    vehicle.tap.is_cut = False
    until(lambda: len(vehicle.decisions_since(start_s + 0.3)) > 10)
    # A setpoint for each position at the most: nothing is repeated, nothing is made up for.
    decisions = vehicle.decisions_since(start_s)
    assert len(decisions) <= len(vehicle.tap.positions_since(start_s)) + UNDER_WAY
    times_s = [setpoint.at_s for setpoint in vehicle.decisions_since(start_s - 0.1)]
    assert max(b - a for a, b in pairwise(times_s)) > 0.2
    assert vehicle.phase is FlightPhase.FORMATION


def test_positions_that_stay_away_end_the_stream_for_good(flight: tuple[Flight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    cut_s = time.monotonic()
    vehicle.tap.is_cut = True
    if vehicle.make.leaves_formation_by_itself:
        vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)  # the autopilot's own failsafe
    else:
        until(lambda: vehicle.phase is FlightPhase.OBSERVE)
    assert vehicle.fell_silent(cut_s)
    vehicle.tap.is_cut = False
    until(lambda: vehicle.phase is FlightPhase.OBSERVE)
    vehicle.observes_and_says_nothing(2.0)
    assert vehicle.fell_silent(cut_s)


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
    until(lambda: len(vehicle.decisions_since(resumed_s)) > 10)
    assert len(vehicle.decisions_since(resumed_s)) <= len(vehicle.tap.positions_since(resumed_s)) + UNDER_WAY


def test_an_agent_that_was_frozen_for_longer_observes(flight: tuple[Flight, Running]) -> None:
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
    assert vehicle.decisions_since(stopped_s) == []
    if vehicle.make.leaves_formation_by_itself:
        vehicle.observes_and_says_nothing(2.0)


def test_a_pilots_mode_ends_the_stream_until_the_next_command(flight: tuple[Flight, Running]) -> None:
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
    vehicle.observes_and_says_nothing(2.0)
    assert len(vehicle.tap.setpoints_since(seen_s)) <= UNDER_WAY
    vehicle.form()
    vehicle.stand_in.wait_for_mode(vehicle.make.formation_mode_name)


def test_positions_alone_that_stay_away_end_in_a_hold_that_the_agent_asks_for(flight: tuple[Flight, Running]) -> None:
    vehicle, _ = flight
    vehicle.form()
    cut_s, commands = time.monotonic(), len(vehicle.tap.commands)
    vehicle.tap.withheld = "LOCAL_POSITION_NED"
    vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
    assert vehicle.fell_silent(cut_s)
    asked = {(command.command, command.param2) for command in vehicle.tap.commands[commands:]}
    assert asked <= {(mavlink.MAV_CMD_DO_SET_MODE, vehicle.make.hold_mode)}  # none where a failsafe was quicker


@pytest.mark.parametrize("make", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def test_killed_and_started_again_in_the_air_it_observes(tmp_path: Path, make: Make) -> None:
    with in_the_air(tmp_path, make) as vehicle:
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
            if make.leaves_formation_by_itself:
                vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
            vehicle.status = None
            until(lambda: vehicle.phase is not None)
            vehicle.observes_and_says_nothing(3.0)
            assert vehicle.tap.setpoints_since(killed_s) == []
            assert vehicle.tap.commands[commands:] == []
            assert vehicle.stand_in.truth()[-1].armed
            vehicle.form()  # and it flies on when it is told to
            vehicle.order(CommandName.LAND, FlightPhase.OBSERVE)
