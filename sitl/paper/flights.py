"""The flights for the paper's figures, flown by the agents in virtual time, and what is measured of them.

A `Book` has all flights by subject, law and model. Topology and interaction matrices come from the vehicles' own reports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.config.law import LawName, law_of
from companion.config.shipped import SHIPPED
from companion.types.errors import FailedError
from companion.types.flight import Role
from sitl.compare.shapes import is_connected
from sitl.flight.scenario import Scenario, load_scenario, reference_of
from sitl.flight.virtual_flight import JobProgress, fly_in_virtual_time, lasts_s
from sitl.paper.graphs import graph_of
from sitl.report.claim import Claim
from sitl.report.metrics import (
    Formation,
    FormationFigures,
    FormationFlight,
    Pair,
    Track,
    Tracks,
    distances_m,
    formation_figures,
    neighbouring_pairs,
    pairs_of,
    stand_at,
)
from sitl.report.summary import TopologyChange

# The paper's law and both candidates for the law that it was compared with.
COMPARED: tuple[LawName, ...] = ("average_22", "average_26", "weighted")
SEEDS, MORE_SEEDS = 5, 20  # flights with noise, each with its own errors
COOPERATION_S = 40.0  # as in the paper's figures 7 and 8, approximately
# By default a follower without leader beacon hands over after half a second. Those of the paper's figure 4 fly on.
PATIENT = "fleet.peers.leader_beacon_max_age_s=10"
ALONE_S = 10.0
NOISY_LAWS: tuple[LawName, ...] = ("average_22", "weighted")


class NoFormationError(FailedError):
    """A flight never reached its formation, so that it has no figures. str() is one line."""


class NotFlownError(LookupError):
    """A flight that a figure or a claim needs was not flown, because the command was stopped."""


class Model(StrEnum):
    """The vehicle model under the agents."""

    IDEAL = "ideal"  # eq. 2 with perfect attitude and sensors: a double integrator
    FULL = "full"  # rigid body, motors and an attitude loop like that of PX4; perfect sensors
    NOISY = "noisy"  # the same with the default errors of the estimator


PERFECT = (Model.IDEAL, Model.FULL)
AS_IN_THE_PAPER = ("fleet.law.disturbance_bandwidth_1_s=0", "fleet.law.velocity_correction_1_s=0")
MODEL_OVERRIDES: dict[Model, tuple[str, ...]] = {
    Model.IDEAL: (
        "stand_in.airframe.attitude=instant",
        "stand_in.airframe.motor_lag_s=0",
        "stand_in.airframe.drag_n_per_m_s=0",
        "stand_in.sensors=ideal",
    ),
    Model.FULL: ("stand_in.airframe.attitude=rigid_body", "stand_in.sensors=ideal"),
    Model.NOISY: ("stand_in.airframe.attitude=rigid_body", "stand_in.sensors=default"),
}


class FlightSubject(StrEnum):
    """An experiment of the paper; the value is the name of its scenario."""

    PLATOON = "platoon"
    AGGREGATION = "aggregation"
    FIGURE_8 = "ring_figure_8"


@dataclass(frozen=True, slots=True)
class PaperPlan:
    """One flight to be flown, with its overrides of the scenario.

    Disturbance observer and velocity correction are off, as in the paper.
    """

    subject: FlightSubject
    law: LawName
    model: Model
    seed: int = 1
    more: tuple[str, ...] = ()

    def scenario(self) -> Scenario:
        """The scenario of the flight. Raises ConfigError."""
        law = [f"fleet.law.name={self.law}", *AS_IN_THE_PAPER]
        model = [f"stand_in.seed={self.seed}", *MODEL_OVERRIDES[self.model]]
        return load_scenario(SHIPPED / f"{self.subject}.yaml", [*law, *model, *self.more])


@dataclass(frozen=True)
class FlownPlan:
    """One completed flight, sent between processes. Tracks are true; `topology` is as reported by the vehicles.

    Its figures are computed once, where they are needed.

    `formation` is None where the vehicles never formed up; `failure` then gives the reason.
    """

    plan: PaperPlan
    scenario: Scenario
    tracks: dict[int, Track]
    formation: Formation | None
    topology: tuple[TopologyChange, ...]
    failure: str | None

    @cached_property
    def flight(self) -> FormationFlight:
        """The flight for the metrics. Raises NoFormationError."""
        if self.formation is None:
            raise NoFormationError(f"{self.plan.subject}, {self.plan.law}, {self.plan.model}: {self.failure}")
        slots_enu_m = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        pairs = neighbouring_pairs(slots_enu_m)
        return FormationFlight(
            self.plan.law, self.tracks, stand_at(slots_enu_m), pairs, reference_of(self.scenario), self.formation
        )

    @cached_property
    def figures(self) -> FormationFigures:
        """Raises NoFormationError."""
        flight = self.flight
        return formation_figures(flight.tracks, flight.slots, flight.reference, flight.formation)

    @property
    def settle_s(self) -> float:
        """Settle time; inf where the flight never settled."""
        settle_s = self.figures.settle_s
        return float("inf") if settle_s is None else settle_s


def paper_plans(full: bool) -> list[PaperPlan]:
    """All flights of the report, the longest first; `full` adds flights with noise."""
    return list(_plans(range(1, 1 + (MORE_SEEDS if full else SEEDS))))


def _plans(seeds: range) -> Iterator[PaperPlan]:
    for law in NOISY_LAWS:
        yield from (PaperPlan(FlightSubject.FIGURE_8, law, model) for model in PERFECT)
    for law in COMPARED:
        yield from (PaperPlan(FlightSubject.PLATOON, law, model) for model in PERFECT)
    short = f"timeline[3].for_s={COOPERATION_S:g}"
    for law in NOISY_LAWS:
        yield from (PaperPlan(FlightSubject.PLATOON, law, Model.NOISY, seed, (short,)) for seed in seeds)
    for model in PERFECT:
        yield PaperPlan(FlightSubject.AGGREGATION, "weighted", model)
        yield PaperPlan(FlightSubject.AGGREGATION, "average_22", model)
        yield PaperPlan(
            FlightSubject.AGGREGATION, "average_26", model, more=(PATIENT, f"timeline[3].for_s={ALONE_S:g}")
        )
    for law in NOISY_LAWS:
        yield from (PaperPlan(FlightSubject.AGGREGATION, law, Model.NOISY, seed, (PATIENT,)) for seed in seeds)


def fly(plan: PaperPlan) -> FlownPlan:
    """Fly the whole timeline of the plan in virtual time, including the landing. Raises ConfigError."""
    scenario = plan.scenario()
    flown = fly_in_virtual_time(scenario, JobProgress(lasts_s(scenario)))
    return FlownPlan(
        plan=plan,
        scenario=scenario,
        tracks=flown.tracks(),
        formation=flown.watch.formation,
        topology=tuple(flown.watch.topology),
        failure=flown.failure,
    )


Topology = dict[int, TopologyChange]  # the last report by vehicle id


@dataclass(frozen=True, slots=True)
class LeadershipSpan:
    """Vehicle `leader_id` was leader from `from_s` to `to_s` of the flight's clock. `settled_s`: last PrC change."""

    leader_id: int
    from_s: float
    settled_s: float
    to_s: float


def topology_at(changes: Sequence[TopologyChange], time_s: float) -> Topology:
    """The last report of each vehicle at this time."""
    found = {change.vehicle: change for change in changes if change.time_s <= time_s}
    return {i: found[i] for i in sorted(found)}


def leaderships(flown: FlownPlan) -> list[LeadershipSpan]:
    """All leaderships of the formation, in order of time. Raises NoFormationError."""
    formation = flown.flight.formation
    first = topology_at(flown.topology, formation.start_s)
    starts = [(next(i for i, report in first.items() if report.role is Role.LEADER), formation.start_s)]
    for change in flown.topology:
        in_formation = formation.start_s < change.time_s < formation.end_s
        if in_formation and change.role is Role.LEADER and change.vehicle != starts[-1][0]:
            starts.append((change.vehicle, change.time_s))
    changes_s = [change.time_s for change in flown.topology]
    ends = [*(from_s for _, from_s in starts[1:]), formation.end_s]
    return [
        LeadershipSpan(leader_id, from_s, max([from_s, *(s for s in changes_s if from_s <= s < to_s)]), to_s)
        for (leader_id, from_s), to_s in zip(starts, ends, strict=True)
    ]


def reported_matrix(flown: FlownPlan, topology: Topology) -> FloatArray:
    """G by Algorithm 2 from the reported PrCs and neighbours."""
    law, ids = law_of(flown.scenario.fleet.law), sorted(topology)
    matrix = np.zeros((len(ids), len(ids)))
    for row, i in enumerate(ids):
        report = topology[i]
        is_leader = report.role is Role.LEADER
        weights = law.weights(is_leader, [topology[j].prc for j in report.neighbours])
        for j, weight in zip(report.neighbours, weights, strict=False):  # none: the leader uses no neighbours
            matrix[row, ids.index(j)] = -weight
        matrix[row, row] = sum(weights) + is_leader
    return matrix


Interval = tuple[float, float]  # from, to [s] after the start of the formation
RESPONDED_SHARE = 0.5  # a vehicle has responded after this share of its distance


def response_s(flight: FormationFlight, vehicle_id: int) -> float:
    """Time from the start of the formation until the vehicle has covered half of its distance in x; inf where it never does."""
    times_s = flight.formation.times_s()
    x_m = flight.tracks[vehicle_id].at(times_s)[:, 0]
    way_m = flight.reference(0.0).position_enu_m[0] + flight.slots_enu_m[vehicle_id][0] - x_m[0]
    done = np.flatnonzero((x_m - x_m[0]) * np.sign(way_m) >= RESPONDED_SHARE * abs(way_m))
    return float(times_s[done[0]] - times_s[0]) if done.size else float("inf")


def broken_s(flight: FormationFlight, pair: Pair, range_m: float) -> list[Interval]:
    """Intervals in which two vehicles were out of range of each other."""
    times_s = flight.formation.times_s()
    return _intervals(distances_m(flight.tracks, pair, times_s) > range_m, times_s)


def alone_s(flight: FormationFlight, vehicle_id: int, range_m: float) -> list[Interval]:
    """Intervals in which a vehicle had no other in range."""
    times_s = flight.formation.times_s()
    pairs = [pair for pair in pairs_of(flight.tracks) if vehicle_id in pair]
    nearest_m = np.min([distances_m(flight.tracks, pair, times_s) for pair in pairs], axis=0)
    return _intervals(nearest_m > range_m, times_s)


def apart_s(flight: FormationFlight, range_m: float) -> list[Interval]:
    """Intervals in which the graph of vehicles in range was not connected."""
    times_s = flight.formation.times_s()
    pairs = pairs_of(flight.tracks)
    in_range = np.array([distances_m(flight.tracks, pair, times_s) <= range_m for pair in pairs])
    graphs, at = np.unique(in_range, axis=1, return_inverse=True)
    in_parts = [
        not is_connected(graph_of(flight.tracks, [pair for pair, is_edge in zip(pairs, graph, strict=True) if is_edge]))
        for graph in graphs.T
    ]
    return _intervals(np.array(in_parts)[at.ravel()], times_s)


def fewest_in_range(flight: FormationFlight, vehicle_id: int, range_m: float) -> list[int]:
    """Ids of the vehicles in range of a vehicle at the time when these were fewest."""
    times_s = flight.formation.times_s()
    others = sorted(flight.tracks.keys() - {vehicle_id})
    in_range = np.array([distances_m(flight.tracks, (vehicle_id, other), times_s) <= range_m for other in others])
    at = int(in_range.sum(axis=0).argmin())
    return [other for other, is_near in zip(others, in_range[:, at], strict=True) if is_near]


def edges_m(tracks: Tracks, time_s: float, range_m: float) -> list[Pair]:
    """Pairs in range of each other at one time."""
    return [pair for pair in pairs_of(tracks) if float(distances_m(tracks, pair, np.array([time_s]))[0]) <= range_m]


def _intervals(condition: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], times_s: FloatArray) -> list[Interval]:
    """Intervals in which `condition` (n,) is true, in seconds after the first time."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], condition, [False]]).astype(int)))
    since_s = times_s - times_s[0]
    return [
        (float(since_s[a]), float(since_s[min(b, since_s.size - 1)]))
        for a, b in zip(steps[::2], steps[1::2], strict=True)
    ]


def beginning(flight: FormationFlight, seconds_s: float) -> FormationFlight:
    """The same flight with its formation cut after `seconds_s`."""
    formation = flight.formation
    return replace(flight, formation=replace(formation, end_s=min(formation.end_s, formation.start_s + seconds_s)))


def total_s(intervals: Sequence[Interval]) -> float:
    return float(sum(to_s - from_s for from_s, to_s in intervals))


def behind_leader_m(flight: FormationFlight, leader_id: int, vehicle_id: int, times_s: FloatArray) -> FloatArray:
    """Distance |(x_i - d_i0) - (x_l - d_l0)| (n,) of a follower to its slot relative to the leader."""
    own = flight.tracks[vehicle_id].at(times_s) - np.array(flight.slots_enu_m[vehicle_id])
    leader = flight.tracks[leader_id].at(times_s) - np.array(flight.slots_enu_m[leader_id])
    return np.asarray(np.linalg.norm(own - leader, axis=1))


class Book:
    """The flights of a report; `plans` are those that it should have, where some may be missing."""

    def __init__(self, flown: Iterable[FlownPlan], plans: Iterable[PaperPlan] = ()) -> None:
        self._flown = list(flown)
        self._plans = list(plans)

    def all(self, subject: FlightSubject, law: LawName, model: Model) -> list[FlownPlan]:
        """The flights with all seeds. Raises NotFlownError where one is missing."""
        wanted = (subject, law, model)
        found = [one for one in self._flown if (one.plan.subject, one.plan.law, one.plan.model) == wanted]
        if len(found) < sum((plan.subject, plan.law, plan.model) == wanted for plan in self._plans):
            raise NotFlownError(f"not all flights of {subject}, {law}, {model} were flown")
        return found

    def perfect(self, subject: FlightSubject, laws: Sequence[LawName]) -> dict[tuple[LawName, Model], FlownPlan]:
        """The flights with perfect sensors under each law with each model. Raises LookupError."""
        return {(law, model): self.one(subject, law, model) for law in laws for model in PERFECT}

    def one(self, subject: FlightSubject, law: LawName, model: Model) -> FlownPlan:
        """The flight with the first seed. Raises LookupError."""
        found = self.all(subject, law, model)
        if not found:
            raise LookupError(f"nothing was flown of {subject}, {law}, {model}")
        return found[0]


def claims_of(book: Book, makers: Iterable[Callable[[Book], Claim]]) -> list[Claim]:
    """Those claims whose flights were flown."""
    found = []
    for make in makers:
        with suppress(NotFlownError):
            found.append(make(book))
    return found


def results(text_of: Callable[[Model], str]) -> dict[str, str]:
    """The result with the ideal model and with the full quadrotor, by the names that the words have for them."""
    return {"ideal": text_of(Model.IDEAL), "full": text_of(Model.FULL)}
