"""`sitl gauntlet --external`: flights drawn as for virtual time, flown one after the other on real autopilots by `sitl fly`.

What only stand-ins can do is left out: pilots, failures, partitions, runaway vehicles.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.types.autopilot import AutopilotKind
from sitl.flight.files import write_scenario
from sitl.flight.flights import FlightOrder, FlightResult
from sitl.flight.fly import fly_real
from sitl.flight.real_autopilots import RealFleet
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.gauntlet.drawing import Drawn, draw_flight, has_runaway, numbers_of
from sitl.gauntlet.fleets import SensorsName
from sitl.gauntlet.flight import SENSOR_FACTOR, WITHIN_M, FlightOutcome, SlotArrivals
from sitl.report.folder import remove_old_run
from sitl.stopping import StopRequest
from sitl.vehicle.config import Links

REAL_FAMILIES = (
    "form_near",
    "form_far",
    "form_crossing",
    "hovering",
    "joining",
    "formation_change",
    "exchange",
    "turning",
    "reference_step",
    "reference_handover",
    "leader_change",
    "leader_leaves",
    "hold_and_land",
)
MOST_VEHICLES = 6  # with their agents, on two cores
SENSORS_LIKE: Mapping[AutopilotKind, SensorsName] = {AutopilotKind.PX4: "px4_sih", AutopilotKind.ARDUPILOT: "default"}
"""Whose errors are those of the type's own simulation at most: they decide spacing, and what is a violation."""


def draw_real(
    kind: AutopilotKind, seed: int, families: Sequence[str], own: FleetConfig | None = None
) -> Iterator[Drawn]:
    """Flights of these families that real autopilots can fly. Raises ImpossibleFlightError where a user's fleet cannot."""
    for number in numbers_of(families):
        if has_runaway(number):
            continue
        flight = draw_flight(seed, number, SENSORS_LIKE[kind], own)
        if own is not None or len(flight.scenario.fleet.vehicles) <= MOST_VEHICLES:
            yield dataclasses.replace(flight, scenario=for_real(flight.scenario, kind))


def for_real(scenario: Scenario, kind: AutopilotKind) -> Scenario:
    """Heights from the ground; undisturbed links; times from take-off, which takes as long as it does."""
    return replace(
        scenario,
        fleet=replace(scenario.fleet, altitude_source="takeoff"),
        stand_in=replace(scenario.stand_in, autopilot=kind, armable_after_s=None),
        links=Links(),
        timeline=from_takeoff(scenario.timeline),
    )


def from_takeoff(timeline: Sequence[TimelineStep]) -> tuple[TimelineStep, ...]:
    """Each step after the one before it by the time that was between them, in place of at a time of the flight."""
    steps = []
    for step, after in zip(timeline, (*timeline[1:], None), strict=True):
        for_s = step.for_s
        if step.at_s is not None and after is not None and after.at_s is not None:
            for_s = max(0.0, round(after.at_s - step.at_s, 3))
        steps.append(replace(step, at_s=None, for_s=for_s))
    return tuple(steps)


def fly_real_flights(
    arguments: argparse.Namespace, families: Sequence[str], own: FleetConfig | None, folder: Path, stop: StopRequest
) -> list[FlightOutcome]:
    """The flights that were flown: all, or fewer where a stop was requested. Raises what `sitl fly` does."""
    kind, outcomes = AutopilotKind(arguments.external), list[FlightOutcome]()
    drawn = draw_real(kind, arguments.seed, families, own)
    for count, flight in enumerate(islice(drawn, arguments.flights), start=1):
        place, name = folder / f"{flight.family}_{flight.number}", f"flight {flight.number}, {flight.family}"
        place.mkdir(exist_ok=True)
        remove_old_run(place)
        write_scenario(flight.scenario, place)
        order = FlightOrder(flight.scenario, name, place, stop, f"{count} of {arguments.flights}")
        result = fly_real(order, arguments.quiet, RealFleet.of(flight.scenario, kind, arguments.binary))
        if stop.number:
            break
        outcomes.append(outcome_of(arguments.seed, flight, result))
        print(f"{line_of(outcomes[-1])}: {place}", flush=True)
    return outcomes


def outcome_of(seed: int, flight: Drawn, result: FlightResult) -> FlightOutcome:
    """The distance is that of the whole flight, landing included; who is in its slot at the end has reached it."""
    summary, scenario = result.summary, flight.scenario
    kind, separation_m = scenario.stand_in.autopilot, scenario.fleet.separation_m
    sensors = SENSORS_LIKE[kind]
    ratio = None if summary.smallest_distance_m is None else summary.smallest_distance_m / separation_m
    errors_m = {vehicle.id: vehicle.final_error_m for vehicle in summary.vehicles if vehicle.id in flight.expected}
    reached_s = {
        i: summary.duration_s if error_m is not None and error_m <= WITHIN_M[sensors] else None
        for i, error_m in errors_m.items()
    }
    return FlightOutcome(
        seed=seed,
        number=flight.number,
        family=flight.family,
        vehicles=len(scenario.fleet.vehicles),
        law=scenario.fleet.law.name,
        autopilot=str(kind),
        sensors=sensors,
        separation_m=separation_m,
        ratio=None if ratio is None else round(ratio, 4),
        violation=ratio is not None and ratio < SENSOR_FACTOR[sensors],
        arrivals=SlotArrivals(expected=len(flight.expected), not_in_formation=[], reached_s=reached_s),
        codes=list(dict.fromkeys(event.code for event in summary.events)),
        failure=summary.failure or "",
    )


def line_of(outcome: FlightOutcome) -> str:
    """The flight in one line."""
    name = f"flight {outcome.number}, {outcome.family}, {outcome.vehicles} vehicles, {outcome.law}"
    if outcome.failure:
        return f"{name}: {outcome.failure}"
    apart = "no distance" if outcome.ratio is None else f"{outcome.ratio * outcome.separation_m:.2f} m"
    reached = sum(s is not None for s in outcome.arrivals.reached_s.values()) if outcome.arrivals else 0
    return (
        f"{name}: smallest distance {apart}, separation_m {outcome.separation_m:g}; {reached} of"
        f" {outcome.arrivals.expected if outcome.arrivals else 0} in their slots"
    )
