"""One case of the study: a shape, a setting of the law, sensor noise and links; and the figures of its flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist
from typing import Literal

import numpy as np
from msgspec import Struct

from companion.analysis.interaction import FloatArray
from companion.analysis.prediction import SETTLED_WITHIN_M, settle_time_s
from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.config.reference import PointReference
from companion.types.commands import CommandName
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.study.scenarios import ORIGIN, members_of, wide_fence
from sitl.study.settings import Setting
from sitl.study.shapes import Shape
from sitl.vehicle.config import Airframe, Links
from sitl.vehicle.config import StandIn as StandInConfig
from sitl.workers import report_progress

STEP_M = 1.0
HEIGHT_M = 1.0
FENCE_M = 1000.0
GOOD_LINKS = Links()
BAD_LINKS = Links(peer_delay_s=0.1, peer_loss=0.1)

Sensing = Literal["ideal", "default", "px4_sih"]


@dataclass(frozen=True, slots=True)
class Case:
    """One flight of a shape. `step_m` is the distance along x from the leader's start to the reference; eq. 2 has no drag."""

    shape: Shape
    setting: Setting
    sensors: Sensing = "ideal"
    links: Links = GOOD_LINKS
    seed: int = 1
    step_m: float = STEP_M
    drag_n_per_m_s: float = 0.0

    def scenario(self) -> Scenario:
        """The case as a scenario, with the timeline of a whole flight, so that `sitl run` and `sitl fly` can fly it too."""
        return Scenario(
            description=f"{self.shape.name} follows a step of {self.step_m:g} m of its reference.",
            fleet=FleetConfig(
                name=self.shape.name,
                origin=ORIGIN,
                vehicles=members_of(self.shape.slots_enu_m, self.shape.leaders),
                neighbours=EdgeNeighbours(edges=self.shape.edges),
                law=self.setting.law,
                takeoff_height_m=HEIGHT_M,
                envelope=wide_fence(FENCE_M),
            ),
            starts_enu_m=self.shape.slots_enu_m,
            reference=PointReference(point_enu_m=(self.step_m, 0.0, HEIGHT_M)),
            stand_in=StandInConfig(
                sensors=self.sensors, seed=self.seed, airframe=Airframe(drag_n_per_m_s=self.drag_n_per_m_s)
            ),
            links=self.links,
            timeline=(
                TimelineStep(command=CommandName.PREPARE),
                TimelineStep(command=CommandName.ARM),
                TimelineStep(command=CommandName.TAKEOFF, for_s=5.0),
                TimelineStep(command=CommandName.FORM, for_s=60.0),
                TimelineStep(command=CommandName.LAND),
            ),
        )


class Figures(Struct, frozen=True, kw_only=True):
    """Figures of one flight of a case, from true positions.

    `settle_s`: time after which all vehicles stay within `within_m` of their slots; None where that is not within `duration_s`.
    `largest_m` and `smallest_m`: distances of neighbours with a desired distance of one spacing; `closest_m`: of any two
    vehicles. `stretch_m` and `squeeze_m`: largest deviation of a neighbour distance above and below the desired one.
    `late_error_m`: largest error of any vehicle in the last third.
    """

    shape: str
    vehicles: int
    setting: str
    sensors: str
    peer_delay_s: float
    peer_loss: float
    seed: int
    step_m: float
    drag_n_per_m_s: float
    duration_s: float
    within_m: float
    settle_s: float | None
    largest_m: float
    smallest_m: float
    closest_m: float
    stretch_m: float
    squeeze_m: float
    late_error_m: float


def fly(cases: Sequence[Case], duration_s: float, within_m: float = SETTLED_WITHIN_M) -> list[Figures]:
    """Fly cases of one shape in one batch. Reports its progress in a process of sitl.workers."""
    flight = fly_batch(
        [case.scenario() for case in cases], duration_s, lambda flown_s: report_progress(flown_s / duration_s)
    )
    worst_m = flight.errors_m().max(axis=2)
    return [figures_of(case, flight, worst_m[:, index], index, within_m) for index, case in enumerate(cases)]


def figures_of(case: Case, flight: BatchFlight, worst_m: FloatArray, index: int, within_m: float) -> Figures:
    """Figures of the formation with this index; `worst_m` (ticks,) is its largest error over time."""
    slots = case.shape.slots_enu_m
    ids = sorted(slots)
    column = {vehicle_id: k for k, vehicle_id in enumerate(ids)}
    first, second = (np.array([column[edge[end]] for edge in case.shape.edges], dtype=int) for end in (0, 1))
    desired_m = np.array([dist(slots[a], slots[b]) for a, b in case.shape.edges])
    positions = flight.positions_enu_m[:, index].astype(float)
    distances_m = np.linalg.norm(positions[:, first] - positions[:, second], axis=2)
    nearest = desired_m < desired_m.min() + 0.01
    duration_s = float(flight.times_s[-1])
    return Figures(
        shape=case.shape.name,
        vehicles=len(ids),
        setting=case.setting.label,
        sensors=case.sensors,
        peer_delay_s=case.links.peer_delay_s,
        peer_loss=case.links.peer_loss,
        seed=case.seed,
        step_m=case.step_m,
        drag_n_per_m_s=case.drag_n_per_m_s,
        duration_s=round(duration_s, 2),
        within_m=round(within_m, 4),
        settle_s=settled_s(flight.times_s, worst_m, within_m),
        largest_m=round(float(distances_m[:, nearest].max()), 4),
        smallest_m=round(float(distances_m[:, nearest].min()), 4),
        closest_m=round(closest_m(positions), 4),
        stretch_m=round(float((distances_m - desired_m).max()), 4),
        squeeze_m=round(float((desired_m - distances_m).max()), 4),
        late_error_m=round(float(worst_m[flight.times_s > duration_s * 2.0 / 3.0].max()), 4),
    )


def settled_s(times_s: FloatArray, error_m: FloatArray, within_m: float) -> float | None:
    """Time after which `error_m` (ticks,) stays within `within_m`, rounded to 10 ms; None where it never does."""
    time_s = settle_time_s(times_s, error_m, within_m)
    return None if time_s is None else round(time_s, 2)


def closest_m(positions_enu_m: FloatArray) -> float:
    """Smallest distance of any two vehicles over all times; positions are (ticks, n, 3)."""
    n = positions_enu_m.shape[1]
    smallest = np.inf
    for k in range(1, n):  # one offset at a time: (ticks, n, n) would not fit in memory
        apart = positions_enu_m[:, k:] - positions_enu_m[:, :-k]
        smallest = min(smallest, float(np.einsum("tij,tij->ti", apart, apart).min()))
    return float(np.sqrt(smallest))
