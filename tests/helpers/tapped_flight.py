"""One vehicle in the air with real processes: a stand-in, a wire tap, an agent, and a ground session."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from agent_process import AgentFiles, agent_files, until
from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Notice
from companion.types.status import Status
from stand_in_process import StandInProcess, stand_in
from wire_tap import Setpoint, WireTap

UNDER_WAY = 2  # setpoints that may already be on their way
CLIMBED_M = 1.0


@dataclass(frozen=True)
class Make:
    """What differs between the autopilots. `final_setpoints` is the number of level setpoints that end a stream."""

    stand_in: str
    formation_mode: int
    mode_message: str
    formation_mode_name: str
    hold_mode: int  # modes of DO_SET_MODE
    hold_mode_name: str
    pilots_mode: tuple[int, int]
    hover_thrust_norm: float
    final_setpoints: int
    leaves_formation_by_itself: bool  # without setpoints


# A PX4 without its stream changes to Hold after a second, as the README advises.
PX4 = Make(
    stand_in="{armable_after_s: 1, sensors: ideal, wind: {mean_enu_m_s: [3.0, 0.0, 0.0]}, parameters: {COM_OBL_RC_ACT: 5}}",
    formation_mode=6 << 16,
    mode_message="CURRENT_MODE",
    formation_mode_name="OFFBOARD",
    hold_mode=4,
    hold_mode_name="LOITER",
    pilots_mode=(4, 3),
    hover_thrust_norm=0.49,
    final_setpoints=0,
    leaves_formation_by_itself=True,
)
ARDUPILOT = Make(
    stand_in="{autopilot: ardupilot, armable_after_s: 1, sensors: ideal, wind: {mean_enu_m_s: [3.0, 0.0, 0.0]},"
    " parameters: {GUID_OPTIONS: 8}}",
    formation_mode=4,
    mode_message="HEARTBEAT",
    formation_mode_name="GUIDED",
    hold_mode=17,
    hold_mode_name="BRAKE",
    pilots_mode=(5, 0),
    hover_thrust_norm=0.365,
    final_setpoints=1,
    leaves_formation_by_itself=False,
)


@dataclass
class Flight:
    """One flying vehicle with all its processes and a ground session."""

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

    def forget_reports(self) -> None:
        """Forget the status and all reports that wait to be read."""
        for _ in self.session.drain():
            pass
        self.status = None

    def newest_event(self) -> Notice | None:
        """Of the newest status that has arrived."""
        return self.status.last_event if self.phase is not None and self.status else None

    def order(self, name: CommandName, phase: FlightPhase) -> None:
        """Repeat a command until the vehicle is in that phase."""

        def reached() -> bool:
            if self.phase is not phase:
                self.session.command([1], name, 1.0)
            end_s = time.monotonic() + 1.0
            while self.phase is not phase and time.monotonic() < end_s:
                time.sleep(0.02)
            return self.phase is phase

        until(reached, 60.0)

    def form(self) -> None:
        """From any state into FORMATION, with half a second of setpoints."""
        self.tap.is_cut, self.tap.withheld = False, ""
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
        ):
            if (row := self.stand_in.newest) is None or row.z_m < CLIMBED_M:
                self.order(name, phase)
        if self.phase is not FlightPhase.FORMATION:
            self.order(CommandName.HOLD, FlightPhase.HOLD)
            self.order(CommandName.FORM, FlightPhase.FORMATION)
        start_s = time.monotonic()
        until(lambda: len(self.tap.setpoints_since(start_s)) > 25)

    def observes_and_sends_nothing(self, seconds: float) -> None:
        """Neither setpoints nor commands in this time; a PX4, which would follow a stream, keeps its mode."""
        start_s, commands = time.monotonic(), len(self.tap.commands)
        time.sleep(seconds)
        assert self.phase is FlightPhase.OBSERVE
        assert self.tap.setpoints_since(start_s) == []
        assert self.tap.commands[commands:] == []
        assert len(self.tap.positions_since(start_s)) > 10  # it had positions
        assert self.stand_in.newest.mode != "OFFBOARD"  # type: ignore[union-attr]

    def is_silent(self, since_s: float) -> bool:
        """No setpoint of the law since then except those on their way; level final setpoints where the make needs them."""
        sent = self.tap.setpoints_since(since_s)
        if self.make.final_setpoints:
            last = self.tap.setpoints[-1]
            assert last.is_level
            assert last.thrust_norm == pytest.approx(self.make.hover_thrust_norm, rel=0.1)
        assert sum(setpoint.is_level for setpoint in sent) <= self.make.final_setpoints
        return sum(not setpoint.is_level for setpoint in sent) <= UNDER_WAY

    def law_setpoints_since(self, time_s: float) -> list[Setpoint]:
        """Setpoints without the final, level ones."""
        return [setpoint for setpoint in self.tap.setpoints_since(time_s) if not setpoint.is_level]


@contextmanager
def in_the_air(folder: Path, make: Make) -> Iterator[Flight]:
    with stand_in(folder, f"id: 1\nstand_in: {make.stand_in}\n") as autopilot:
        files = agent_files(folder)
        text = files.file.read_text(encoding="utf-8")
        own = text.replace("hover_thrust_norm: 0.49", f"hover_thrust_norm: {make.hover_thrust_norm}")
        files.file.write_text(own, encoding="utf-8")
        with (
            WireTap(autopilot.ports.companion, files.udp_port, make.formation_mode, make.mode_message) as tap,
            FleetSession("processtest", (files.zenoh,)) as session,
        ):
            yield Flight(make, files, autopilot, tap, session)
