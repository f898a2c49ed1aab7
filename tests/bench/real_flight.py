"""One flight of real agents with stand-ins, sampled in windows of time while it is in formation."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from companion.ground.session import FleetSession
from companion.recording.reader import recordings
from companion.recording.records import INBOX, TIMING, TimingRecord
from companion.types.autopilot import PositionSample
from sitl.flight.director import Director, MachineClock
from sitl.flight.files import ids_of, write_files
from sitl.flight.orders import FlightFailure
from sitl.flight.processes import FleetProcesses, stand_ins_together
from sitl.flight.scenario import Scenario
from sitl.flight.watch import watch_of
from sitl.links.ports import zenoh_endpoint
from sitl.report.progress import FlightProgress
from tests.bench.figures import REPEATS, Use
from tests.bench.processes import use_of

SETTLES_S = 5.0  # of formation before the first window: it begins with the busiest second of a flight
WINDOW_S = 7.0
FORM_S = SETTLES_S + REPEATS * WINDOW_S + 1.0


@dataclass(frozen=True, slots=True)
class Flown:
    """What was sampled, one more than there are complete windows, and why the flight ended early, "" otherwise."""

    uses: list[Use]
    timings: dict[int, list[TimingRecord]]  # of every tick of each agent
    failure: str


def fly(scenario: Scenario, folder: Path, offset: int, prepare: Callable[[], None] = lambda: None) -> Flown:
    """The whole flight. `prepare` is called when the files are written, before anything starts."""
    ids = ids_of(scenario)
    write_files(scenario, folder, offset)
    prepare()
    watch = watch_of(scenario, time.monotonic())
    progress = FlightProgress(f"{len(ids)} vehicles", not sys.stdout.isatty(), watch.began_s)
    with FleetProcesses.start_written(scenario, folder, offset, stand_ins_together(scenario)) as fleet, progress:
        with FleetSession(scenario.fleet.name, [zenoh_endpoint(i, offset) for i in ids], "bench") as session:
            sampler = _Sampler({int(i): fleet.pid_of(f"agent {i}") for i in ids})

            def check() -> None:
                if ending := fleet.unexpected_end():
                    raise FlightFailure(ending)
                if watch.is_in_formation:
                    sampler.update(time.monotonic())

            director = Director(session, watch, progress, check, fleet.lost_vehicles, MachineClock())
            failures = director.fly_and_land(scenario.timeline)
        failures += fleet.stop_all()
    return Flown(sampler.uses, _timings(folder), "; ".join(failures))


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

    def __init__(self, pids: dict[int, int]) -> None:
        self._pids, self._due_s = pids, 0.0
        self.uses: list[Use] = []

    def update(self, now_s: float) -> None:
        """In formation, in every pass."""
        self._due_s = self._due_s or now_s + SETTLES_S
        if now_s < self._due_s or len(self.uses) > REPEATS:
            return
        self._due_s += WINDOW_S
        cpu_s = {i: _cpu_s(pid) for i, pid in self._pids.items()}
        memory_mb = {i: use_of(pid).memory_mb for i, pid in self._pids.items()}
        self.uses.append(Use(now_s, cpu_s, memory_mb))


def _cpu_s(pid: int) -> float:
    """Time that all threads of a process have run, to the nanosecond."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9


def start(stack: ExitStack, *command: str) -> subprocess.Popen[bytes]:
    """A process that ends with the stack, or with this process."""
    bound = [sys.executable, "-m", "sitl.flight.bound", str(os.getpid())]
    process = subprocess.Popen(
        [*bound, *command], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    stack.callback(_end, process)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(3.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
