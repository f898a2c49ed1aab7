"""The flights for the paper's figures, flown by the agents in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from companion.config.fleet import LawName
from companion.types.errors import FailedError
from sitl.flight.scenario import Scenario, load_scenario, reference_of
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.metrics import Formation, FormationFlight, neighbouring_pairs, standing
from sitl.report.progress import FlightProgress
from sitl.report.records import TopologyChange
from sitl.report.tracks import Track

SCENARIOS = Path(__file__).parents[1] / "scenarios"  # package data: a link to config/scenarios in the source tree
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


class Model(StrEnum):
    """The vehicle model under the agents."""

    IDEAL = "ideal"  # eq. 2 with perfect attitude and sensors: a double integrator
    FULL = "full"  # rigid body, motors and an attitude loop like that of PX4; perfect sensors
    NOISY = "noisy"  # the same with the default errors of the estimator


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
        return load_scenario(SCENARIOS / f"{self.subject}.yaml", [*law, *model, *self.more])


@dataclass(frozen=True, slots=True)
class FlownPlan:
    """One completed flight, sent between processes. Tracks are true; `topology` is as reported by the vehicles.

    `formation` is None where the vehicles never formed up; `failure` then gives the reason.
    """

    plan: PaperPlan
    scenario: Scenario
    tracks: dict[int, Track]
    formation: Formation | None
    topology: tuple[TopologyChange, ...]
    failure: str | None

    def flight(self) -> FormationFlight:
        """The flight for the metrics. Raises NoFormationError."""
        if self.formation is None:
            raise NoFormationError(f"{self.plan.subject}, {self.plan.law}, {self.plan.model}: {self.failure}")
        slots_enu_m = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        pairs = neighbouring_pairs(slots_enu_m)
        return FormationFlight(
            self.plan.law, self.tracks, standing(slots_enu_m), pairs, reference_of(self.scenario), self.formation
        )


def paper_plans(full: bool) -> list[PaperPlan]:
    """All flights of the report, the longest first; `full` adds flights with noise."""
    return list(_plans(range(1, 1 + (MORE_SEEDS if full else SEEDS))))


def _plans(seeds: range) -> Iterator[PaperPlan]:
    perfect = (Model.IDEAL, Model.FULL)
    for law in COMPARED:
        yield from (PaperPlan(FlightSubject.FIGURE_8, law, model) for model in perfect if law != "average_26")
    for law in COMPARED:
        yield from (PaperPlan(FlightSubject.PLATOON, law, model) for model in perfect)
    short = f"timeline[3].for_s={COOPERATION_S:g}"
    for law in NOISY_LAWS:
        yield from (PaperPlan(FlightSubject.PLATOON, law, Model.NOISY, seed, (short,)) for seed in seeds)
    for model in perfect:
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
    flown = fly_in_virtual_time(scenario, FlightProgress(plan.subject, quiet=True, began_s=0.0))
    return FlownPlan(
        plan=plan,
        scenario=scenario,
        tracks=flown.tracks(),
        formation=flown.watch.formation,
        topology=tuple(flown.watch.topology),
        failure=flown.failure,
    )
