"""Flies one flight of the gauntlet and measures it."""

from __future__ import annotations

import time
import traceback

from msgspec import Struct
from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.types.notices import Code
from sitl.flight.orders import Refusal
from sitl.flight.scenario import Scenario
from sitl.flight.virtual_flight import Flown, fly_without_landing
from sitl.gauntlet.arrival import SlotArrivals, arrivals
from sitl.gauntlet.distances import SENSOR_FACTOR, Distances, distances
from sitl.gauntlet.drawn import Drawn, ImpossibleFlightError, drawn, family_of
from sitl.gauntlet.fleets import SensorsName
from sitl.report.progress import FlightProgress
from sitl.vehicle.config import Links

UNDISTURBED_EVERY = 3
NO_SEPARATION_M = 0.01


class Job(Struct, frozen=True):
    """One flight to be flown."""

    seed: int
    number: int
    sensors: SensorsName | None = None
    own: FleetConfig | None = None


class FlightOutcome(Struct, frozen=True, kw_only=True):
    """One flight. `ratio`: smallest distance of the pairs that count, in units of `separation_m`; None: none counted.

    `exception` is a whole traceback, "" without one. `codes` are those of all events.
    """

    seed: int
    number: int
    family: str
    vehicles: int = 0
    law: str = ""
    autopilot: str = ""
    sensors: str = ""
    separation_m: float = 0.0
    runaway: int | None = None
    ratio: float | None = None
    distances: Distances | None = None
    violation: bool = False
    arrivals: SlotArrivals | None = None
    undisturbed_s: dict[int, float | None] = {}
    refusals: list[Refusal] = []
    codes: list[Code] = []
    failure: str = ""
    exception: str = ""
    cpu_s: float = 0.0


def fly(job: Job) -> FlightOutcome:
    """Draw and fly one flight. An exception of the flight is part of the outcome."""
    began_s = time.process_time()
    try:
        flight = drawn(job.seed, job.number, job.sensors, job.own)
    except ImpossibleFlightError as error:
        return FlightOutcome(seed=job.seed, number=job.number, family=family_of(job.number), failure=str(error))
    return measured(job, flight, began_s)


def measured(job: Job, flight: Drawn, began_s: float) -> FlightOutcome:
    scenario = flight.scenario
    sensors = str(scenario.stand_in.sensors)
    known = FlightOutcome(
        seed=job.seed,
        number=job.number,
        family=flight.family,
        vehicles=len(scenario.fleet.vehicles),
        law=scenario.fleet.law.name,
        autopilot=str(scenario.stand_in.autopilot),
        sensors=sensors,
        separation_m=scenario.fleet.separation_m,
        runaway=flight.runaway,
    )
    try:
        flown = fly_without_landing(scenario, FlightProgress("gauntlet", True, 0.0))
    except Exception:  # noqa: BLE001 -- any defect of an agent is an outcome, and the other flights go on
        return replace(known, exception=traceback.format_exc(), cpu_s=_since(began_s))
    found, arrived = distances(flown.stand_ins), arrivals(flight, flown)
    ratio = found.commanded.distance_m / scenario.fleet.separation_m if found.commanded else None
    return replace(
        known,
        ratio=ratio,
        distances=found,
        violation=ratio is not None and ratio < SENSOR_FACTOR[sensors],
        arrivals=arrived,
        undisturbed_s=_undisturbed_s(flight, arrived),
        refusals=flown.refusals,
        codes=_codes(flown),
        failure=flown.failure or "",
        cpu_s=_since(began_s),
    )


def _undisturbed_s(flight: Drawn, arrived: SlotArrivals) -> dict[int, float | None]:
    """Times to the slots without disturbance; of every UNDISTURBED_EVERY-th flight, because it takes another flight."""
    if flight.number % UNDISTURBED_EVERY or not any(s is not None for s in arrived.reached_s.values()):
        return {}
    flown = fly_without_landing(undisturbed(flight.scenario), FlightProgress("gauntlet", True, 0.0))
    return arrivals(flight, flown).reached_s


def undisturbed(scenario: Scenario) -> Scenario:
    """The flight with ideal sensors and links, without a runaway vehicle and in effect without separation.

    What happens to the fleet stays the same: commands, partitions, agents that end.
    """
    return replace(
        scenario,
        fleet=replace(scenario.fleet, separation_m=NO_SEPARATION_M),
        stand_in=replace(scenario.stand_in, sensors="ideal", pilots=()),
        links=Links(partitions=scenario.links.partitions),
    )


def _codes(flown: Flown) -> list[Code]:
    """Codes of all events, each once, in order."""
    return list(dict.fromkeys(event.code for event in flown.watch.events))


def _since(began_s: float) -> float:
    return round(time.process_time() - began_s, 2)
