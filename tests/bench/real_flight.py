"""One flight of real agents with stand-ins, sampled in windows of time while it is in formation."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.ground.commands import MACHINE_CLOCK
from companion.ground.session import FleetSession
from companion.recording.reader import recordings
from companion.recording.records import INBOX, TIMING, TimingRecord
from companion.security.identity import Identity
from companion.types.autopilot import PositionSample
from sitl.flight.director import Director
from sitl.flight.files import ids_of, write_files
from sitl.flight.orders import FlightFailure
from sitl.flight.processes import FleetProcesses, stand_ins_together
from sitl.flight.scenario import Scenario
from sitl.flight.watch import FlightWatch, watch_of
from sitl.links.ports import LOOPBACK, ports_of
from sitl.report.progress import FlightProgress
from tests.bench.figures import REPEATS, AgentsUse
from tests.bench.processes import cpu_s, use_of

Observer = Callable[[Mapping[int, int], FlightWatch, float], None]

SETTLES_S = 5.0  # of formation before the first window: it begins with the busiest second of a flight
WINDOW_S = 7.0
FORM_S = SETTLES_S + REPEATS * WINDOW_S + 1.0


@dataclass(frozen=True, slots=True)
class Flown:
    """What was sampled, one more than there are complete windows, and why the flight ended early, "" otherwise."""

    uses: list[AgentsUse]
    timings: dict[int, list[TimingRecord]]  # of every tick of each agent
    failure: str


def fly(scenario: Scenario, folder: Path, offset: int, prepare: Callable[[], None] = lambda: None) -> Flown:
    """The whole flight. `prepare` is called when the files are written, before anything starts."""
    write_files(scenario, folder, offset)
    prepare()
    sampler = _Sampler()
    flight = RealFlight(scenario, folder, offset, sampler.update)
    failures = flight.fly(quiet=not sys.stdout.isatty())
    return Flown(sampler.uses, _timings(folder), "; ".join(failures))


class RealFlight:
    """Agents and stand-ins of the files in `folder`, commanded through the scenario's timeline to the ground.

    While all are in formation `observe` is called in every pass with the process id of each agent, what they have reported, and
    the time. With an `identity` the ground uses TLS. `check` may raise FlightFailure in every pass.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        offset: int,
        observe: Observer = lambda _pids, _watch, _now_s: None,
        identity: Identity | None = None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._scenario, self._folder, self._offset = scenario, folder, offset
        self._observe, self._identity, self._check = observe, identity, check
        self.watch = watch_of(scenario, time.monotonic())

    def fly(self, quiet: bool = True) -> list[str]:
        """Returns the failures, one line each."""
        scenario, ids = self._scenario, [int(i) for i in ids_of(self._scenario)]
        progress = FlightProgress(f"{len(ids)} vehicles", quiet, self.watch.began_s)
        together = stand_ins_together(scenario)
        with FleetProcesses.start_written(scenario, self._folder, self._offset, together) as fleet, progress:
            pids = {i: fleet.pid_of(f"agent {i}") for i in ids}
            with self._session(ids) as session:

                def check() -> None:
                    self._check()
                    if ending := fleet.unexpected_end():
                        raise FlightFailure(ending)
                    if self.watch.is_in_formation:
                        self._observe(pids, self.watch, time.monotonic())

                director = Director(session, self.watch, progress, check, fleet.lost_vehicles, MACHINE_CLOCK)
                failures = director.fly_and_land(scenario.timeline)
            return failures + fleet.stop_all()

    def _session(self, ids: list[int]) -> FleetSession:
        protocol = "tls" if self._identity else "tcp"
        endpoints = [f"{protocol}/{LOOPBACK}:{ports_of(i, self._offset).zenoh}" for i in ids]
        return FleetSession(self._scenario.fleet.name, endpoints, "" if self._identity else "bench", self._identity)


def _timings(folder: Path) -> dict[int, list[TimingRecord]]:
    return {
        one.vehicle_id: [timing.value for timing in one.read([TIMING], _ignore)]
        for one in recordings(folder, _ignore)
        if one.vehicle_id
    }


def delays_of_ticks(folder: Path) -> list[tuple[float, float]]:
    """Of all agents' ticks with a position: when the tick began, and us from the first position's arrival until then."""
    inboxes = (message.value for one in recordings(folder, _ignore) for message in one.read([INBOX], _ignore))
    return [
        (now_s, (now_s - arrivals_s[0]) * 1e6)
        for now_s, inbox in inboxes
        if (arrivals_s := [sample.received_s for sample in inbox.telemetry if isinstance(sample, PositionSample)])
    ]


def _ignore(_: str) -> None:
    """The windows end long before the recording's last ticks, which may be missing."""


class _Sampler:
    """Samples all agents at the end of each window."""

    def __init__(self) -> None:
        self._due_s = 0.0
        self.uses: list[AgentsUse] = []

    def update(self, pids: Mapping[int, int], _watch: FlightWatch, now_s: float) -> None:
        """In formation, in every pass."""
        self._due_s = self._due_s or now_s + SETTLES_S
        if now_s < self._due_s or len(self.uses) > REPEATS:
            return
        self._due_s += WINDOW_S
        used_s = {i: cpu_s(pid) for i, pid in pids.items()}
        memory_mb = {i: use_of(pid).memory_mb for i, pid in pids.items()}
        self.uses.append(AgentsUse(now_s, used_s, memory_mb))
