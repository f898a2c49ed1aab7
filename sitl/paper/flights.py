"""The flights that the paper's figures need: each an Agent's real flight in virtual time, planned here and flown one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from companion.config.law import LawName
from sitl.ending import FailedError
from sitl.metrics import Flight, Formation, neighbouring_pairs, standing
from sitl.progress import Progress
from sitl.scenario import Scenario, load_scenario, reference_of
from sitl.tracks import Track
from sitl.virtual_flight import fly_in_virtual_time
from sitl.watch import TopologyChange

SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"
COMPARED: tuple[LawName, ...] = (
    "average_22",
    "average_26",
    "weighted",
)  # the paper's law and what it may have flown against
SEEDS, MORE_SEEDS = 5, 20  # flights with noise, each with errors of its own
COOPERATION_S = 40.0  # of the flights of figures 7 and 8, which lasted about as long
# Alone, a follower of ours hands over after half a second. The paper's fly on, so for its figure 4 ours must, too.
PATIENT = "fleet.peers.leader_word_max_age_s=10"
ALONE_S = 10.0
NOISY_LAWS: tuple[LawName, ...] = ("average_22", "weighted")


class NoFormationError(FailedError):
    """A flight never came to the formation that is to be measured. str() is one line."""


class Model(StrEnum):
    """What flies under the agents."""

    IDEAL = "ideal"  # eq. 2 with perfect attitude and sensors: a double integrator
    FULL = "full"  # rigid body, motors and an attitude loop as PX4's; perfect sensors
    NOISY = "noisy"  # the same with the estimator's default errors


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


class Subject(StrEnum):
    """Which of the paper's experiments; the value is its scenario's name."""

    PLATOON = "platoon"
    AGGREGATION = "aggregation"
    FIGURE_8 = "ring_figure_8"


@dataclass(frozen=True, slots=True)
class Plan:
    """One flight to be flown: what tells it from the others, and what it changes in its scenario.

    The paper's laws are flown as they are: nobody looks for hover thrust and wind.
    """

    subject: Subject
    law: LawName
    model: Model
    seed: int = 1
    more: tuple[str, ...] = ()

    def scenario(self) -> Scenario:
        """Raises ConfigError."""
        law = [f"fleet.law.name={self.law}", "fleet.law.disturbance_bandwidth_1_s=0"]
        model = [f"stand_in.seed={self.seed}", *MODEL_OVERRIDES[self.model]]
        return load_scenario(SCENARIOS / f"{self.subject}.yaml", [*law, *model, *self.more])


@dataclass(frozen=True, slots=True)
class FlownPlan:
    """One flight as it was flown; it travels between processes. Tracks are true; `topology` is what the vehicles said.

    `formation` is None where the vehicles never came to one, and then `failure` says why.
    """

    plan: Plan
    scenario: Scenario
    tracks: dict[int, Track]
    formation: Formation | None
    topology: tuple[TopologyChange, ...]
    failure: str | None

    def flight(self) -> Flight:
        """Raises NoFormationError."""
        if self.formation is None:
            raise NoFormationError(f"{self.plan.subject}, {self.plan.law}, {self.plan.model}: {self.failure}")
        slots_enu_m = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        pairs = neighbouring_pairs(slots_enu_m)
        return Flight(
            self.plan.law, self.tracks, standing(slots_enu_m), pairs, reference_of(self.scenario), self.formation
        )


def paper_plans(full: bool) -> list[Plan]:
    """Every flight of the report, the longest first; `full` flies more of the noisy ones."""
    return list(_plans(range(1, 1 + (MORE_SEEDS if full else SEEDS))))


def _plans(seeds: range) -> Iterator[Plan]:
    perfect = (Model.IDEAL, Model.FULL)
    for law in COMPARED:
        yield from (Plan(Subject.FIGURE_8, law, model) for model in perfect if law != "average_26")
    for law in COMPARED:
        yield from (Plan(Subject.PLATOON, law, model) for model in perfect)
    short = f"timeline[3].for_s={COOPERATION_S:g}"
    for law in NOISY_LAWS:
        yield from (Plan(Subject.PLATOON, law, Model.NOISY, seed, (short,)) for seed in seeds)
    for model in perfect:
        yield Plan(Subject.AGGREGATION, "weighted", model)
        yield Plan(Subject.AGGREGATION, "average_22", model)
        yield Plan(Subject.AGGREGATION, "average_26", model, more=(PATIENT, f"timeline[3].for_s={ALONE_S:g}"))
    for law in NOISY_LAWS:
        yield from (Plan(Subject.AGGREGATION, law, Model.NOISY, seed, (PATIENT,)) for seed in seeds)


def fly(plan: Plan) -> FlownPlan:
    """The plan's whole timeline in virtual time, and down in any case. Raises ConfigError."""
    scenario = plan.scenario()
    flown = fly_in_virtual_time(scenario, Progress(plan.subject, quiet=True, began_s=0.0))
    return FlownPlan(
        plan=plan,
        scenario=scenario,
        tracks=flown.tracks(),
        formation=flown.watch.formation,
        topology=tuple(flown.watch.topology),
        failure=flown.failure,
    )
