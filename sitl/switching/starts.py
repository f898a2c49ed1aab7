"""Random starts: positions in a field with a connected graph, and a goal at some distance from the leader."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import cos, dist, pi, sin, sqrt

import numpy as np
from scipy.optimize import linear_sum_assignment

from companion.config.fleet import FleetConfig
from companion.config.fleet import RangeNeighbours as Range
from companion.config.law import LawName, LawSection
from companion.config.reference import PointReference
from companion.types.commands import CommandName
from companion.types.values import Vector3
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.study.scenarios import ORIGIN, members_of, wide_fence
from sitl.study.shapes import LEADER, grid, is_connected
from sitl.vehicle.config import Airframe
from sitl.vehicle.config import StandIn as StandInConfig

APART_M = 1.2  # smallest distance at the start
FIELD_PER_VEHICLE_M2 = 3.0  # with a range of 3 m most graphs are connected, but few are complete
GOAL_M = (2.0, 6.0)  # distance of the reference from the leader's start
HEIGHT_M = 1.0
FENCE_M = 500.0
DRAWS = 10_000


@dataclass(frozen=True, slots=True)
class Start:
    """One random start: start positions by vehicle id, and the goal of the reference."""

    seed: int
    starts_enu_m: dict[int, Vector3]
    goal_enu_m: Vector3

    def scenario(self, law: LawName, neighbours: Range) -> Scenario:
        """The start as a scenario. The formation is a grid of two columns behind the leader."""
        return Scenario(
            description=f"Random start {self.seed} of {len(self.starts_enu_m)} vehicles with a range of "
            f"{neighbours.range_m:g} m.",
            fleet=FleetConfig(
                name=f"start-{self.seed}",
                origin=ORIGIN,
                vehicles=members_of(self._slots_enu_m()),
                neighbours=neighbours,
                law=LawSection(name=law),
                takeoff_height_m=HEIGHT_M,
                envelope=wide_fence(FENCE_M),
            ),
            starts_enu_m=self.starts_enu_m,
            reference=PointReference(point_enu_m=self.goal_enu_m),
            stand_in=StandInConfig(sensors="ideal", seed=self.seed, airframe=Airframe(drag_n_per_m_s=0.0)),
            timeline=(TimelineStep(command=CommandName.FORM, for_s=30.0),),
        )

    def _slots_enu_m(self) -> dict[int, Vector3]:
        """Slots by vehicle id with the least sum of squared distances to the starts, so that few straight paths cross.

        The distance of the goal does not change the assignment.
        """
        followers = sorted(set(self.starts_enu_m) - {LEADER})
        slots = grid((len(followers) + 2) // 2, 2).slots_enu_m
        free = [slots[i] for i in followers]
        squares_m2 = [[dist(self.starts_enu_m[i], self._at_start(slot)) ** 2 for slot in free] for i in followers]
        _, chosen = linear_sum_assignment(squares_m2)
        return {LEADER: slots[LEADER]} | {i: free[k] for i, k in zip(followers, chosen, strict=True)}

    def _at_start(self, slot_enu_m: Vector3) -> Vector3:
        """Position of a slot with the leader at its start."""
        x, y, z = self.starts_enu_m[LEADER]
        return (x + slot_enu_m[0], y + slot_enu_m[1], z + slot_enu_m[2])


def random_start(vehicles: int, range_m: float, seed: int) -> Start:
    """Draw until the graph is connected and no two vehicles are nearer than APART_M. Raises ValueError after DRAWS draws."""
    generator = np.random.default_rng(seed)
    side_m = sqrt(vehicles * FIELD_PER_VEHICLE_M2) * range_m / 3.0
    for _ in range(DRAWS):
        drawn = generator.uniform(0.0, side_m, (vehicles, 2))
        starts: dict[int, Vector3] = {i: (round(x, 3), round(y, 3), 0.0) for i, (x, y) in enumerate(drawn, start=1)}
        if _fits(starts, range_m):
            return Start(seed, starts, _goal(starts[LEADER], generator))
    raise ValueError(
        f"no start of {vehicles} vehicles with a range of {range_m:g} m is connected with distances of {APART_M:g} m or more, "
        f"in {DRAWS} draws with seed {seed}"
    )


def _fits(starts: dict[int, Vector3], range_m: float) -> bool:
    graph: dict[int, list[int]] = {i: [] for i in starts}
    for i, j in combinations(starts, 2):
        apart_m = dist(starts[i], starts[j])
        if apart_m < APART_M:
            return False
        if apart_m <= range_m:
            graph[i].append(j)
            graph[j].append(i)
    return is_connected(graph)


def _goal(leader: Vector3, generator: np.random.Generator) -> Vector3:
    distance_m, turn = generator.uniform(*GOAL_M), generator.uniform(0.0, 2.0 * pi)
    return (round(leader[0] + distance_m * cos(turn), 3), round(leader[1] + distance_m * sin(turn), 3), HEIGHT_M)
