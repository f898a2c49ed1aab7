"""A fleet of real processes in flight: one vehicle with a tap, fleets under faults, and their ground station."""

from __future__ import annotations

import csv
import os
import re
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations, pairwise
from math import acos, degrees, dist, pi
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from common import ROOT
from companion.core.safety.failsafe import FAILSAFES, OTHER_FAILSAFES, Step
from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code, Notice
from companion.types.status import Status
from companion.types.values import Vector3
from fault_table import FaultRow
from processes import AgentFiles, StandInProcess, agent_files, free_fleet_offset, stand_in, until
from sitl.flight.files import truth_path, write_files, write_network
from sitl.flight.processes import FleetProcesses
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.ports import ports_of, zenoh_endpoint
from sitl.vehicle.config import Links
from wire_autopilots import Setpoint, WireTap

UNDER_WAY = 2  # setpoints that may already be on their way
CLIMBED_M = 1.0


@dataclass(frozen=True)
class AutopilotCase:
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
PX4 = AutopilotCase(
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
ARDUPILOT = AutopilotCase(
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
class TappedFlight:
    """One flying vehicle with all its processes and a ground session."""

    make: AutopilotCase
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
def in_the_air(folder: Path, make: AutopilotCase) -> Iterator[TappedFlight]:
    with stand_in(folder, f"id: 1\nstand_in: {make.stand_in}\n") as autopilot:
        files = agent_files(folder)
        text = files.file.read_text(encoding="utf-8")
        own = text.replace("hover_thrust_norm: 0.49", f"hover_thrust_norm: {make.hover_thrust_norm}")
        files.file.write_text(own, encoding="utf-8")
        with (
            WireTap(autopilot.ports.companion, files.udp_port, make.formation_mode, make.mode_message) as tap,
            FleetSession("processtest", (files.zenoh,)) as session,
        ):
            yield TappedFlight(make, files, autopilot, tap, session)


IDS = (1, 2, 3, 4)
LEADER, FOLLOWERS = 1, (2, 3, 4)
SEPARATION_M = 1.0
TOUCHING_M = 0.5  # where states arrive late, and vehicles stop one after another in their autopilots' own hold
STEP_DEG = 3.5  # output limit between setpoints: 2.4 degrees in roll and pitch
CONVERGED_M = 0.3
LOST_S = 0.7  # leader_beacon_max_age_s, one turn of a successor, and the way through three relays
UNDISTURBED = Links(peer_transport="udp", peer_delay_s=0.002)  # not the default: the emulated network runs
AGENTS_PORTS = 12_000  # away from the stand-ins' ports, where the taps listen
TICK_S = 0.02
LONGEST_STREAM_GAP_S = 0.1  # setpoints further apart are not of one stream
RADIUS_M, PERIOD_S = 6.0, 30.0
SPEED_M_S = 2.0 * pi * RADIUS_M / PERIOD_S  # of the reference
OVERRIDES = (
    "fleet.law.name=cooperative",
    "fleet.takeoff_height_m=2.0",
    "stand_in.armable_after_s=1",
    f"fleet.separation_m={SEPARATION_M}",
    f"reference={{kind: circle, centre_enu_m: [-6.0, 0.0, 2.0], radius_m: {RADIUS_M}, period_s: {PERIOD_S}}}",
    "links={peer_transport: udp, peer_delay_s: 0.002}",
)
LOGGED = re.compile(r"^(\d\d:\d\d:\d\d\.\d\d\d) vehicle \d+: ([A-Z_]+): (.*)$", re.MULTILINE)
TO_FORMATION = (
    (CommandName.PREPARE, FlightPhase.READY),
    (CommandName.ARM, FlightPhase.ARMED),
    (CommandName.TAKEOFF, FlightPhase.HOLD),
    (CommandName.FORM, FlightPhase.FORMATION),
)


@dataclass(frozen=True)
class Moment:
    """A time by both clocks: the monotonic one of taps and truth, and that of the agents' logs."""

    monotonic_s: float
    wall_s: float

    @classmethod
    def now(cls) -> Moment:
        return cls(time.monotonic(), time.time())


@dataclass(frozen=True)
class Event:
    """A line of an agent's log, `after_s` after the fault."""

    after_s: float
    code: str
    text: str


@dataclass
class FaultyFleet:
    """A flying fleet. `fault` starts the measurement of everything that has `since` in its description."""

    scenario: Scenario
    folder: Path
    port_offset: int
    fleet: FleetProcesses
    session: FleetSession
    ground: Ground
    taps: dict[int, WireTap]
    since: Moment

    # ------------------------------------------------------------ flying and faults

    def form(self, ids: Sequence[int] = IDS) -> None:
        """From any phase into formation, and two seconds of it."""
        self.ground.listen(0.5)
        for name, phase in TO_FORMATION:
            in_the_air = self.ground.phases(tuple(ids)) <= {FlightPhase.HOLD, FlightPhase.FORMATION}
            if not in_the_air or name is CommandName.FORM:
                self.ground.order(name, phase, tuple(ids))
        self.ground.listen(2.0)

    def land(self, ids: Sequence[int] = IDS) -> None:
        self.ground.order(CommandName.LAND, FlightPhase.OBSERVE, tuple(ids), within_s=60.0)

    def fault(self) -> Moment:
        """The fault begins now."""
        self.since = Moment.now()
        return self.since

    def pid(self, name: str) -> int:
        return self.fleet.pid_of(name)

    def kill(self, name: str, number: signal.Signals = signal.SIGKILL) -> None:
        os.kill(self.pid(name), number)

    def links(self, links: Links) -> None:
        """Change the links between the agents."""
        log = self.folder / "network.log"
        before = log.read_text().count("links changed")
        write_network(self.scenario, links, self.folder, self.port_offset)
        self.kill("network", signal.SIGHUP)
        self.wait(lambda: log.read_text().count("links changed") > before, 5.0)

    def wait(self, condition: Callable[[], object], within_s: float) -> None:
        """Receive reports until the condition holds."""
        end_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end_s, (
                {i: str(s.last_event) for i, s in self.ground.newest.items()},
                self.logged(),
            )
            self.ground.listen(0.05)

    def phase(self, vehicle_id: int) -> FlightPhase:
        return self.ground.newest[vehicle_id].phase

    def check_formation(self, ids: Sequence[int] = IDS) -> None:
        """All of these are in formation."""
        assert self.ground.phases(tuple(ids)) == {FlightPhase.FORMATION}, self.logged()

    # ------------------------------------------------------------ measured since the fault

    def check(self, row: FaultRow, least_m: float = SEPARATION_M) -> None:
        """Measure smallest distance and largest step, and hold them against their limits."""
        row.smallest_distance_m, row.largest_step_deg = self.smallest_distance_m(), self.largest_step_deg()
        assert row.smallest_distance_m >= least_m, row
        assert row.largest_step_deg <= STEP_DEG, row

    def events(self, vehicle_id: int) -> list[Event]:
        """What its agent logged since the fault."""
        text = (self.folder / f"agent_{vehicle_id}.log").read_text(encoding="utf-8", errors="replace")
        day = datetime.fromtimestamp(self.since.wall_s).date()
        found = []
        for clock, code, rest in LOGGED.findall(text):
            at_s = datetime.fromisoformat(f"{day} {clock}").timestamp() - self.since.wall_s
            if at_s > -0.002:
                found.append(Event(max(at_s, 0.0), code, rest))
        return found

    def logged(self) -> dict[int, list[str]]:
        return {i: [f"{e.after_s:.2f} {e.code} {e.text}" for e in self.events(i)][-6:] for i in IDS}

    def event(self, vehicle_id: int, code: str) -> Event | None:
        """The first event with this code since the fault."""
        return next((event for event in self.events(vehicle_id) if event.code == code), None)

    def setpoints(self, vehicle_id: int) -> list[Setpoint]:
        return self.taps[vehicle_id].setpoints_since(self.since.monotonic_s)

    def last_setpoint_s(self, vehicle_id: int) -> float:
        """Time of the last setpoint since the fault; 0 if there was none."""
        sent = self.setpoints(vehicle_id)
        return sent[-1].at_s - self.since.monotonic_s if sent else 0.0

    def largest_step_deg(self) -> float:
        """Largest angle between consecutive setpoints of one vehicle since the fault; per tick where they are further apart."""
        steps = [0.0]
        for tap in self.taps.values():
            for a, b in pairwise(tap.setpoints_since(self.since.monotonic_s - 0.05)):
                apart_s = b.at_s - a.at_s
                if apart_s < LONGEST_STREAM_GAP_S:
                    steps.append(_angle_deg(a, b) * min(1.0, TICK_S / apart_s))
        return max(steps)

    def tracks(self) -> dict[int, dict[int, Vector3]]:
        """True positions of the armed vehicles by id and time in units of 20 ms, since the fault."""
        found: dict[int, dict[int, Vector3]] = {}
        for vehicle_id in IDS:
            lines = truth_path(self.folder, vehicle_id).read_text(encoding="ascii").splitlines(keepends=True)
            rows = csv.DictReader(line for line in lines if line.endswith("\n"))
            found[vehicle_id] = {
                round(float(row["monotonic_s"]) / 0.02): (float(row["x_m"]), float(row["y_m"]), float(row["z_m"]))
                for row in rows
                if row["armed"] == "1" and float(row["monotonic_s"]) > self.since.monotonic_s
            }
        return found

    def smallest_distance_m(self) -> float:
        """Smallest true distance between two armed vehicles since the fault."""
        tracks = self.tracks()
        return min(
            dist(tracks[i][at], tracks[j][at])
            for i, j in combinations(IDS, 2)
            for at in tracks[i].keys() & tracks[j].keys()
        )

    def largest_error_m(self, last_s: float) -> float:
        """Largest true error of a follower's place beside the leader in the last seconds."""
        tracks = self.tracks()
        slots = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        times = sorted(set.intersection(*(set(track) for track in tracks.values())))[-round(last_s / 0.02) :]
        assert len(times) > 25 * last_s  # half of them
        return max(
            dist(_minus(tracks[i][at], tracks[LEADER][at]), _minus(slots[i], slots[LEADER]))
            for i in FOLLOWERS
            for at in times
        )


def _minus(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(p - q for p, q in zip(a, b, strict=True))


def _angle_deg(a: Setpoint, b: Setpoint) -> float:
    cosine = abs(sum(p * q for p, q in zip(a.attitude, b.attitude, strict=True)))
    return degrees(2.0 * acos(min(cosine, 1.0)))


@contextmanager
def faulty_fleet(folder: Path, *overrides: str) -> Iterator[FaultyFleet]:
    """The processes of a fleet on the ground, ended with the block."""
    scenario = load_scenario(ROOT / "config" / "scenarios" / "platoon.yaml", [*OVERRIDES, *overrides])
    port_offset = free_fleet_offset()
    write_files(scenario, folder, port_offset)
    with ExitStack() as stack:
        taps = {i: stack.enter_context(_tap(folder, i, port_offset)) for i in IDS}
        one_by_one = [[i] for i in IDS]  # each stand-in can be killed by itself
        fleet = stack.enter_context(FleetProcesses.start_written(scenario, folder, port_offset, one_by_one))
        endpoints = [zenoh_endpoint(i, port_offset) for i in IDS]
        session = stack.enter_context(FleetSession(scenario.fleet.name, endpoints))
        stack.callback(_resume, fleet)
        until(lambda: "network of vehicles" in (folder / "network.log").read_text())
        yield FaultyFleet(scenario, folder, port_offset, fleet, session, Ground(session), taps, Moment.now())


def _tap(folder: Path, vehicle_id: int, port_offset: int) -> WireTap:
    """The tap takes the agent's port; the agent gets another one."""
    port = ports_of(vehicle_id, port_offset).companion
    file = folder / f"vehicle_{vehicle_id}.yaml"
    text = file.read_text(encoding="utf-8")
    assert f":{port}" in text
    file.write_text(text.replace(f"udpin:127.0.0.1:{port}", f"udpin:127.0.0.1:{port + AGENTS_PORTS}"), encoding="utf-8")
    return WireTap(port, port + AGENTS_PORTS, PX4.formation_mode, PX4.mode_message)


def _resume(fleet: FleetProcesses) -> None:
    """Frozen processes do not end by SIGTERM."""
    for role in ("agent", "autopilot"):
        for vehicle_id in IDS:
            with suppress(ProcessLookupError):
                os.kill(fleet.pid_of(f"{role} {vehicle_id}"), signal.SIGCONT)


def disturbed(**links: Any) -> Links:
    """The undisturbed links with these changes."""
    return replace(UNDISTURBED, **links)


def demanded(code: Code) -> str:
    """What the failsafe matrix demands, in words."""
    row = next(row for row in (*FAILSAFES, *OTHER_FAILSAFES) if row.condition is code)
    steps = [f"{_action(step)}{_after(step)}" for step in row.steps]
    return f"`{code}` ({row.raised}): {', then '.join(steps)}"


def _action(step: Step) -> str:
    return f"`{step.action}`" if isinstance(step.action, str) else step.action.name


def _after(step: Step) -> str:
    if not step.after_s:
        return ""
    return f" after `{step.after_s}`" if isinstance(step.after_s, str) else f" after {step.after_s:g} s"


class Ground:
    """A ground station: commands to the fleet, and the newest status of every vehicle."""

    def __init__(self, session: FleetSession) -> None:
        self._session = session
        self.newest: dict[int, Status] = {}
        self.events: set[str] = set()
        self.received: list[tuple[float, Status]] = []

    def listen(self, seconds: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Receive reports for this time, or until `enough`."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not enough():
            for report in self._session.drain():
                self.newest[report.status.vehicle_id] = report.status
                self.received.append((time.monotonic(), report.status))
                self.events.add(f"{report.status.vehicle_id}: {report.status.last_event}")
            time.sleep(0.02)

    def fly_to_formation(self, ids: tuple[int, ...]) -> None:
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
            (CommandName.FORM, FlightPhase.FORMATION),
        ):
            self.order(name, phase, ids)

    def phases(self, ids: tuple[int, ...]) -> set[FlightPhase | None]:
        return {self.newest[i].phase if i in self.newest else None for i in ids}

    def order(self, name: CommandName, phase: FlightPhase, ids: tuple[int, ...], within_s: float = 40.0) -> None:
        """Repeat a command until every vehicle is in the phase that it leads to."""
        end_s = time.monotonic() + within_s
        while self.phases(ids) != {phase}:
            assert time.monotonic() < end_s, (name, self.newest)
            self._session.command([i for i in ids if self.phases((i,)) != {phase}], name, 0.5)
            self.listen(0.5, lambda: self.phases(ids) == {phase})
