"""Flies one flight of the gauntlet and measures it: closest distances, and which vehicles reached their slots."""

from __future__ import annotations

import time
import traceback
from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.analysis.interaction import FloatArray
from companion.config.fleet import FleetConfig
from companion.geometry.airspace import Airspace
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.values import Vector3
from sitl.flight.orders import Refusal
from sitl.flight.scenario import Scenario
from sitl.flight.virtual_flight import Flown, JobProgress, fly_without_landing, lasts_s
from sitl.flight.virtual_vehicle import BoolArray, VirtualStandIn
from sitl.flight.watch import FlightWatch
from sitl.gauntlet.drawing import Drawn, ImpossibleFlightError, draw_flight, family_of
from sitl.gauntlet.fleets import SensorsName
from sitl.gauntlet.others import SPEED_MARGIN_M_S, Excess, LeadTaken, fastest, lead_taken
from sitl.report.metrics import Track, reported_track
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
    choices: tuple[float, ...] = ()


class FlightOutcome(Struct, frozen=True, kw_only=True):
    """One flight. `ratio`: smallest distance of the pairs that count, in units of `separation_m`; None: none counted.

    `room`: the smallest distance of a vehicle that an agent commands to fence, obstacles and ground; None: none was.
    `liars` lie about where they are: distances to them, and what they do, do not count. `speed` and `lead` are then judged too.
    `braked`: vehicles whose last check of commands braked them.
    `exception` is a whole traceback, "" without one. `codes` are those of all events, each once, in order.
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
    liars: list[int] = []
    ratio: float | None = None
    distances: Distances | None = None
    room: LeastRoom | None = None
    speed: Excess | None = None
    lead: LeadTaken | None = None
    violation: bool = False
    arrivals: SlotArrivals | None = None
    undisturbed_s: dict[int, float | None] = {}
    refusals: list[Refusal] = []
    codes: list[Code] = []
    failure: str = ""
    braked: list[int] = []
    exception: str = ""
    cpu_s: float = 0.0


def fly(job: Job) -> FlightOutcome:
    """Draw and fly one flight. An exception of the flight is part of the outcome."""
    began_s = time.process_time()
    try:
        flight = draw_flight(job.seed, job.number, job.sensors, job.own, job.choices)
    except ImpossibleFlightError as error:
        return FlightOutcome(seed=job.seed, number=job.number, family=family_of(job.number), failure=str(error))
    return fly_drawn(job, flight, began_s)


def fly_drawn(job: Job, flight: Drawn, began_s: float) -> FlightOutcome:
    scenario = flight.scenario
    sensors, liars = str(scenario.stand_in.sensors), sorted({lie.vehicle for lie in scenario.links.lies})
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
        liars=liars,
    )
    try:
        flown = fly_without_landing(scenario, JobProgress(lasts_s(scenario)))
    except Exception:  # noqa: BLE001 -- any defect of an agent is an outcome, and the other flights go on
        return replace(known, exception=traceback.format_exc(), cpu_s=_cpu_s(began_s))
    others = [stand_in for stand_in in flown.stand_ins if stand_in.vehicle_id not in liars]
    found, arrived = distances(others, flight.handed_over), arrivals(flight, flown)
    ratio = found.commanded.distance_m / scenario.fleet.separation_m if found.commanded else None
    room = least_room(others, scenario.fleet.airspace)
    speed = fastest(others, scenario.fleet.envelope) if liars else None
    lead = lead_taken(scenario, flown.watch, liars) if liars else None
    return replace(
        known,
        ratio=ratio,
        distances=found,
        room=room,
        speed=speed,
        lead=lead,
        violation=(ratio is not None and ratio < SENSOR_FACTOR[sensors])
        or (room is not None and room.distance_m < -INTRUSION_M[sensors])
        or (speed is not None and speed.over_m_s > SPEED_MARGIN_M_S[sensors])
        or lead is not None,
        arrivals=arrived,
        undisturbed_s={} if job.choices else _undisturbed_s(flight, arrived),
        refusals=flown.refusals,
        braked=_braked(flown.watch),
        codes=list(dict.fromkeys(event.code for event in flown.watch.events)),
        failure=flown.failure or "",
        cpu_s=_cpu_s(began_s),
    )


def _braked(watch: FlightWatch) -> list[int]:
    statuses = ((i, watch.status(i)) for i in watch.vehicle_ids)
    return [i for i, status in statuses if status and str(Code.COMMAND_BRAKED) in status.rejected]


def _undisturbed_s(flight: Drawn, arrived: SlotArrivals) -> dict[int, float | None]:
    """Times to the slots without disturbance; of every UNDISTURBED_EVERY-th flight, because it takes another flight."""
    if flight.number % UNDISTURBED_EVERY or not any(s is not None for s in arrived.reached_s.values()):
        return {}
    flown = fly_without_landing(without_disturbance(flight.scenario), FlightProgress("gauntlet", True, 0.0))
    return arrivals(flight, flown).reached_s


def without_disturbance(scenario: Scenario) -> Scenario:
    """The flight with ideal sensors and links, without a runaway vehicle and in effect without separation.

    What happens to the fleet stays the same: commands, partitions, agents that end.
    """
    return replace(
        scenario,
        fleet=replace(scenario.fleet, separation_m=NO_SEPARATION_M),
        stand_in=replace(scenario.stand_in, sensors="ideal", pilots=(), position_losses=()),
        links=Links(partitions=scenario.links.partitions),
    )


def _cpu_s(began_s: float) -> float:
    return round(time.process_time() - began_s, 2)


SENSOR_FACTOR = {"ideal": 1.0, "default": 0.8, "px4_sih": 0.6}
"""Share of `separation_m` below which a true distance is a violation, by the sensors of the flight."""


class Closest(Struct, frozen=True, kw_only=True):
    """The smallest distance of a kind of pairs."""

    distance_m: float
    time_s: float
    vehicles: tuple[int, int]


class Distances(Struct, frozen=True, kw_only=True):
    """`commanded`: of pairs where an agent commands the attitude of at least one vehicle, or has handed over both.

    `automatic`: of other pairs in the air, which both fly by their autopilots or pilots. None: there were none.
    """

    commanded: Closest | None
    automatic: Closest | None


def distances(stand_ins: Sequence[VirtualStandIn], handed_over: Collection[int] = ()) -> Distances:
    """Over the whole flight, at 50 Hz. `handed_over`: vehicles whose autopilots fly where their agents handed over."""
    tracks = {s.vehicle_id: s.track() for s in stand_ins}
    commanded = {s.vehicle_id: s.commanded() for s in stand_ins}
    flies = {s.vehicle_id: s.flies() for s in stand_ins}
    closest: dict[bool, Closest | None] = {True: None, False: None}
    for i, j in combinations(sorted(tracks), 2):
        apart_m = np.linalg.norm(tracks[i].position_enu_m - tracks[j].position_enu_m, axis=1)
        either = commanded[i] | commanded[j]
        if i in handed_over and j in handed_over:
            either |= _since(commanded[i]) & _since(commanded[j]) & (flies[i] | flies[j])
        for kind, counts in ((True, either), (False, ~either & flies[i] & flies[j])):
            if not counts.any():
                continue
            row = int(np.where(counts, apart_m, np.inf).argmin())
            before = closest[kind]
            if before is None or apart_m[row] < before.distance_m:
                time_s = round(float(tracks[i].time_s[row]), 3)
                closest[kind] = Closest(distance_m=round(float(apart_m[row]), 4), time_s=time_s, vehicles=(i, j))
    return Distances(commanded=closest[True], automatic=closest[False])


INTRUSION_M = {"ideal": 0.05, "default": 0.2, "px4_sih": 0.5}
"""What a true position may be beyond the fence, an obstacle or the ground, by the sensors: errors of tracking and position."""
ROOM_EVERY = 5  # rows of the track, 10 Hz


class LeastRoom(Struct, frozen=True, kw_only=True):
    """The smallest distance of a vehicle to the fence, an obstacle or the ground; negative beyond it."""

    distance_m: float
    time_s: float
    vehicle: int


def least_room(stand_ins: Sequence[VirtualStandIn], airspace: Airspace) -> LeastRoom | None:
    """Of all vehicles, while agents command them; at 10 Hz."""
    least: LeastRoom | None = None
    to_walls = replace(airspace, clearance_m=0.0)
    for stand_in in stand_ins:
        track, commanded = stand_in.track(), stand_in.commanded()
        for row in np.flatnonzero(commanded)[::ROOM_EVERY]:
            x, y, z = map(float, track.position_enu_m[row])
            distance_m = min(to_walls.room_m((x, y, z)), z - stand_in.ground_m)
            if least is None or distance_m < least.distance_m:
                time_s = round(float(track.time_s[row]), 3)
                least = LeastRoom(distance_m=round(distance_m, 4), time_s=time_s, vehicle=stand_in.vehicle_id)
    return least


def _since(first: BoolArray) -> BoolArray:
    """From the first true value on."""
    return np.logical_or.accumulate(first)


WITHIN_M = {"ideal": 0.5, "default": 0.5, "px4_sih": 1.0}
"""Error of a vehicle in its slot, by the sensors of the flight: with `px4_sih` the attitude error alone moves it by 0.5 m."""
SAMPLE_S = 0.1
SETTLED = 20  # samples in its slot in a row, until a vehicle has reached it
RESTS_WITHIN_M = 0.1  # of its last place: from then on the reference rests


class SlotArrivals(Struct, frozen=True, kw_only=True):
    """`expected`: number of vehicles that were to be in their slots at the end of the flight.

    `not_in_formation`: those of them that were not in formation then; `reached_s`: of each other vehicle by id, the time that
    it took to its slot; None where it was not in it at the end.
    """

    expected: int
    not_in_formation: list[int]
    reached_s: dict[int, float | None]


def arrivals(flight: Drawn, flown: Flown) -> SlotArrivals:
    """A vehicle is in its slot where the slot and a reference that comes to rest move no more, and its error is small."""
    watch = flown.watch
    out = [i for i in flight.expected if not _in_formation(watch, i)]
    times_s = np.arange(flight.slots_from_s, flown.flight_s - SAMPLE_S, SAMPLE_S)
    present = [i for i in flight.expected if i not in out]
    reached_s: dict[int, float | None] = dict.fromkeys(present)
    if present and len(watch.led_enu_m) > 1 and times_s.size:
        within_m = WITHIN_M[str(flight.scenario.stand_in.sensors)]
        rests_from_s = reference_rests_from_s(_track(watch.led_enu_m).at(times_s), times_s)
        for i, errors_m in _errors_m(watch, present, times_s).items():
            from_s = max(rests_from_s, watch.slot_moved_s.get(i, 0.0))
            reached_s[i] = settled_s((errors_m <= within_m) & (times_s >= from_s))
    return SlotArrivals(expected=len(flight.expected), not_in_formation=out, reached_s=reached_s)


def _in_formation(watch: FlightWatch, vehicle_id: int) -> bool:
    status = watch.status(vehicle_id)
    return status is not None and status.phase is FlightPhase.FORMATION


def _errors_m(watch: FlightWatch, ids: list[int], times_s: FloatArray) -> dict[int, FloatArray]:
    """The smaller one of the errors about the reference and about the median of the fleet, which lags behind a fast one."""
    slots = watch.slots()
    about = {i: _track(watch.reported[i]).at(times_s) - slots[i].at(times_s) for i in ids}
    reference, fleet = _track(watch.led_enu_m).at(times_s), np.median(list(about.values()), axis=0)
    return {
        i: np.minimum(np.linalg.norm(own - reference, axis=1), np.linalg.norm(own - fleet, axis=1))
        for i, own in about.items()
    }


def _track(reported: list[tuple[float, Vector3]]) -> Track:
    return reported_track(0, reported)


def reference_rests_from_s(reference_enu_m: FloatArray, times_s: FloatArray) -> float:
    """Time from which the reference, shape (samples, 3), stays at its last place; the first time if it moves to the end.

    A fleet that follows its reference has small errors on all of the way, also while the reference goes to its place.
    """
    moves = np.flatnonzero(np.linalg.norm(reference_enu_m - reference_enu_m[-1], axis=1) > RESTS_WITHIN_M)
    if not moves.size or moves[-1] >= times_s.size - SETTLED:
        return float(times_s[0])
    return float(times_s[moves[-1] + 1])


def settled_s(in_slot: NDArray[np.bool_]) -> float | None:
    """Time from which the vehicle is in its slot for SETTLED samples in a row; None where it is not at the end."""
    if in_slot.size < SETTLED:
        return None
    settled = np.flatnonzero(np.convolve(in_slot, np.ones(SETTLED), "valid") == SETTLED)
    if not settled.size or settled[-1] < in_slot.size - SETTLED:
        return None
    return round(float(settled[0]) * SAMPLE_S, 2)
