"""One scenario flown in virtual time, from the ground to the ground."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from companion.ground.fleet_state import ReportedVehicle
from sitl.flight.director import Director, MovingTargets
from sitl.flight.lockstep import Lockstep
from sitl.flight.orders import FlightFailure, Refusal
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.flight.virtual_vehicle import VirtualStandIn
from sitl.flight.watch import FlightWatch, watch_of
from sitl.report.metrics import Track
from sitl.report.progress import FlightProgress
from sitl.stopping import StopRequest
from sitl.workers import report_progress

TAKE_OFF_S, LANDING_S = 12.0, 5.0  # as long as they usually take, with all that is before the law begins
LOOKS = 50  # ticks from one progress of a job to the next
OBJECTS = 50_000  # net allocations before a collection; with the default of 700 it takes an eighth of the time


@contextmanager
def collecting_seldom() -> Iterator[None]:
    """A flight allocates hundreds of values per tick, none of which is part of a cycle."""
    before = gc.get_threshold()
    gc.set_threshold(OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


class JobProgress(FlightProgress):
    """Reports the share of a flight that is flown, and shows nothing: for a flight that is one job of many."""

    def __init__(self, lasts_s: float) -> None:
        super().__init__("", quiet=True, began_s=0.0)
        self._lasts_s, self._looks = lasts_s, 0

    def is_due(self) -> bool:
        self._looks += 1
        return self._looks % LOOKS == 0

    def show(self, vehicles: Sequence[ReportedVehicle], now_s: float) -> None:
        del vehicles
        report_progress(min(now_s / self._lasts_s, 1.0))


def lasts_s(scenario: Scenario) -> float:
    """About so long its flight takes, for progress."""
    return TAKE_OFF_S + sum(step.for_s for step in scenario.timeline) + LANDING_S


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight in virtual time. `watch` holds what the vehicles reported; `wall_s` is the computing time."""

    watch: FlightWatch
    stand_ins: list[VirtualStandIn]
    failure: str | None
    refusals: list[Refusal]  # of steps that may fail
    flight_s: float
    wall_s: float

    def tracks(self) -> dict[int, Track]:
        return {stand_in.vehicle_id: stand_in.track() for stand_in in self.stand_ins}


def fly_in_virtual_time(
    scenario: Scenario, progress: FlightProgress, stop: StopRequest | None = None, recordings: Path | None = None
) -> Flown:
    """Fly the scenario's whole timeline and land, also after a failure. `recordings` is the folder for what agents record."""
    return _flown(scenario, progress, stop, Director.fly_and_land, recordings)


def fly_without_landing(scenario: Scenario, progress: FlightProgress) -> Flown:
    """Fly the scenario's timeline to its end or to a failure. The vehicles remain as they are."""
    return _flown(scenario, progress, None, _failures_of)


def _failures_of(director: Director, timeline: Sequence[TimelineStep]) -> list[str]:
    try:
        director.fly(timeline)
    except FlightFailure as failure:
        return [str(failure)]
    return []


def _flown(
    scenario: Scenario,
    progress: FlightProgress,
    stop: StopRequest | None,
    fly: Callable[[Director, Sequence[TimelineStep]], list[str]],
    recordings: Path | None = None,
) -> Flown:
    """`fly` returns the failures, one line each."""

    def check() -> None:
        if stop and stop.number:
            raise FlightFailure(f"interrupted by {stop.number.name}")
        targets.update(lockstep.now_s())

    began_s = time.perf_counter()
    lockstep = Lockstep(scenario, recordings)
    targets = MovingTargets(scenario.targets, lockstep.publish_target, lockstep.now_s())
    watch = watch_of(scenario, lockstep.now_s())
    director = Director(lockstep, watch, progress, check, tuple, lockstep)
    with collecting_seldom(), closing(lockstep):
        failures = fly(director, scenario.timeline)
    wall_s = time.perf_counter() - began_s
    failure = "; ".join(failures) or None
    return Flown(watch, lockstep.stand_ins, failure, director.refusals, lockstep.now_s(), wall_s)
