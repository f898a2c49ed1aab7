"""One scenario flown in virtual time, from the ground to the ground."""

from __future__ import annotations

import time
from dataclasses import dataclass

from companion.types import Role
from sitl.collector import looking_seldom
from sitl.director import Director
from sitl.fleet import ids_of
from sitl.lockstep import Lockstep
from sitl.moving_targets import MovingTargets
from sitl.orders import FlightFailure
from sitl.progress import Progress
from sitl.scenario import Scenario
from sitl.stopping import StopRequest
from sitl.tracks import Track
from sitl.watch import FlightWatch
from sitl.world import StandIn


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight in virtual time. `watch` holds what the vehicles said, `wall_s` is how long the machine took."""

    watch: FlightWatch
    stand_ins: list[StandIn]
    failure: str | None
    flight_s: float
    wall_s: float

    def tracks(self) -> dict[int, Track]:
        return {stand_in.vehicle_id: stand_in.track() for stand_in in self.stand_ins}


def fly_in_virtual_time(scenario: Scenario, progress: Progress, stop: StopRequest | None = None) -> Flown:
    """The scenario's whole timeline, and down in any case."""

    def check() -> None:
        if stop and stop.number:
            raise FlightFailure(f"interrupted by {stop.number.name}")
        targets.go_on(lockstep.now_s())

    leader_ids = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    began_s = time.perf_counter()
    lockstep = Lockstep(scenario)
    targets = MovingTargets(scenario.targets, lockstep.tell_of_target, lockstep.now_s())
    watch = FlightWatch(ids_of(scenario), leader_ids, lockstep.now_s())
    director = Director(lockstep, watch, progress, check, tuple, lockstep)
    with looking_seldom():
        failures = director.fly_and_land(scenario.timeline)
    wall_s = time.perf_counter() - began_s
    return Flown(watch, lockstep.stand_ins, "; ".join(failures) or None, lockstep.now_s(), wall_s)
