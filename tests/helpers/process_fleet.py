"""The fourth way to make vehicles fly: a fleet of real processes, commanded and heard from the ground.

`fleet_in_formation` starts a scenario as `sitl fly` does. `FaultyFleet` has taps on the wires, and measures what a fault does.
A single vehicle of real processes is `in_the_air` of wire_autopilots.py.
"""

from __future__ import annotations

import csv
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations, pairwise
from math import acos, degrees, dist, inf, pi
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from common import ROOT, until
from companion.core.safety.failsafe import FAILSAFES, OTHER_FAILSAFES, Step
from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.status import Status
from companion.types.values import Vector3
from fault_table import FaultRow
from processes import free_fleet_offset
from sitl.flight.files import truth_path, write_files, write_network
from sitl.flight.processes import FleetProcesses
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.ports import ports_of, zenoh_endpoint
from sitl.vehicle.config import Links
from wire_autopilots import PX4, Setpoint, WireTap

IDS = (1, 2, 3, 4)
LEADER, FOLLOWERS = 1, (2, 3, 4)
SEPARATION_M = 1.0
TOUCHING_M = 0.5  # where states arrive late, and vehicles stop one after another in their autopilots' own hold
# The output limit of 120 deg/s: 2.4 degrees in roll and in pitch are 3.4 in a tick; the time of a setpoint is in whole ms.
STEP_DEG = 3.8
CONVERGED_M = 0.3
FAULT_AT_S = 28.0  # of stand-ins and cameras, for faults in their files; the fleet is in formation then
LOST_S = 0.7  # leader_beacon_max_age_s, one turn of a successor, and the way through three relays
UNDISTURBED = Links(peer_transport="udp", peer_delay_s=0.002)  # not the default: the emulated network runs
AGENTS_PORTS = 12_000  # away from the stand-ins' ports, where the taps listen
TICK_S = 0.02
LONGEST_STREAM_GAP_S = 0.1  # setpoints further apart are not of one stream
WRITTEN_WITHIN_S = 2.0  # true states: stand-ins write theirs once a second
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

    def form_before_the_fault(self) -> None:
        """Into formation, until shortly before FAULT_AT_S; what follows counts as measured."""
        began_s = time.monotonic()
        self.form()
        left_s = FAULT_AT_S - 3.0 - (time.monotonic() - began_s)
        assert left_s > 0.0, "the fleet was not in formation in time"
        self.ground.listen(left_s)
        self.check_formation()
        self.fault()

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
        self.ground.wait(condition, within_s, self.logged)

    def phase(self, vehicle_id: int) -> FlightPhase:
        return self.ground.newest[vehicle_id].phase

    def check_formation(self, ids: Sequence[int] = IDS) -> None:
        """All of these are in formation."""
        assert self.ground.phases(tuple(ids)) == {FlightPhase.FORMATION}, self.logged()

    # ------------------------------------------------------------ measured since the fault

    def check(self, row: FaultRow, blind: Collection[int] = (), least_m: float = SEPARATION_M) -> None:
        """Measure smallest distance and largest step, and hold them against their limits.

        Two vehicles that both land without a position drift towards each other: their distance is measured only.
        """
        row.smallest_distance_m, row.largest_step_deg = self.smallest_distance_m(), self.largest_step_deg()
        assert self.smallest_distance_m(blind) >= least_m, row
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
                apart_s = b.decided_s - a.decided_s
                if b.at_s - a.at_s < LONGEST_STREAM_GAP_S:
                    steps.append(_angle_deg(a, b) * TICK_S / max(apart_s, TICK_S))
        return max(steps)

    def tracks(self) -> Tracks:
        """True positions since the fault; see `tracks_since`."""
        return tracks_since(self.folder, self.since.monotonic_s)

    def smallest_distance_m(self, blind: Collection[int] = ()) -> float:
        """Smallest true distance between two armed vehicles since the fault, of which at most one is blind."""
        tracks = self.tracks()
        apart_m = (
            dist(tracks[i][at], tracks[j][at])
            for i, j in combinations(IDS, 2)
            if not {i, j} <= set(blind)
            for at in tracks[i].keys() & tracks[j].keys()
        )
        return min(apart_m, default=inf)

    def largest_error_m(self, last_s: float) -> float:
        """Largest true error of a follower's place beside the leader in the last seconds."""
        tracks = self.tracks()
        # Each file is behind by what its stand-in has not written yet; one that ends earlier is of a vehicle that ended.
        ends = [max(track) for track in tracks.values()]
        end = min(ends)
        assert max(ends) - end < WRITTEN_WITHIN_S / TICK_S, "too little truth"
        newest = {
            i: {at: where for at, where in track.items() if at > end - last_s / TICK_S} for i, track in tracks.items()
        }
        return largest_error_m(self.scenario, newest, at_least=round(25 * last_s))  # half of them


Tracks = dict[int, dict[int, Vector3]]
"""True positions by vehicle id and time in units of 20 ms."""


def tracks_since(folder: Path, since_s: float) -> Tracks:
    """Of the vehicles while they are armed, since this time of the monotonic clock."""
    found: Tracks = {}
    for vehicle_id in IDS:
        lines = truth_path(folder, vehicle_id).read_text(encoding="ascii").splitlines(keepends=True)
        rows = csv.DictReader(line for line in lines if line.endswith("\n"))
        found[vehicle_id] = {
            round(float(row["monotonic_s"]) / TICK_S): (float(row["x_m"]), float(row["y_m"]), float(row["z_m"]))
            for row in rows
            if row["armed"] == "1" and float(row["monotonic_s"]) > since_s
        }
    return found


def largest_error_m(scenario: Scenario, tracks: Tracks, at_least: int) -> float:
    """Largest true error of a follower's place beside the leader, at all times that every track has."""
    slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    times = set.intersection(*(set(track) for track in tracks.values()))
    assert len(times) > at_least, "too little truth"
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


def fly(scenario: Path, folder: Path, *more: str, timeout_s: float = 280.0) -> subprocess.CompletedProcess[str]:
    """`sitl fly` from its start to its end; what it writes is in `folder`."""
    command = [sys.executable, "-m", "sitl", "fly", str(scenario), "--out", str(folder), *more]
    port_offset = str(free_fleet_offset())
    done = subprocess.run(
        [*command, "--port-offset", port_offset], capture_output=True, text=True, timeout=timeout_s, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@dataclass(frozen=True)
class StartedFleet:
    """The processes of a scenario, and a ground station that hears all vehicles."""

    processes: FleetProcesses
    session: FleetSession
    ground: Ground

    def kill(self, name: str, number: signal.Signals = signal.SIGKILL) -> None:
        os.kill(self.processes.pid_of(name), number)


@contextmanager
def fleet_in_formation(scenario: Scenario, folder: Path) -> Iterator[StartedFleet]:
    """All processes of a scenario as `sitl fly` starts them, ended with the block."""
    port_offset, ids = free_fleet_offset(), tuple(member.id for member in scenario.fleet.vehicles)
    endpoints = [zenoh_endpoint(i, port_offset) for i in ids]
    with (
        FleetProcesses.start(scenario, folder, port_offset) as processes,
        FleetSession(scenario.fleet.name, endpoints) as session,
    ):
        ground = Ground(session)
        ground.fly_to_formation(ids)
        ground.listen(2.0)
        assert ground.phases(ids) == {FlightPhase.FORMATION}
        yield StartedFleet(processes, session, ground)


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
                self.newest[report.status.agent.vehicle_id] = report.status
                self.received.append((time.monotonic(), report.status))
                self.events.add(f"{report.status.agent.vehicle_id}: {report.status.last_event}")
            time.sleep(0.02)

    def wait(
        self, condition: Callable[[], object], within_s: float = 40.0, logged: Callable[[], object] = lambda: ""
    ) -> None:
        """Receive reports until the condition holds. `logged` is shown where it does not."""
        end_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end_s, ({i: str(s.last_event) for i, s in self.newest.items()}, logged())
            self.listen(0.05)

    def fly_to_formation(self, ids: tuple[int, ...]) -> None:
        for name, phase in TO_FORMATION:
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
