"""Random starts: vehicles thrown into a field so that the graph is connected, and a goal that leads them away."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import cos, dist, pi, sin, sqrt

import numpy as np
from scipy.optimize import linear_sum_assignment

from companion.config.fleet import Envelope, FleetConfig, FormationMember, GeodeticOrigin
from companion.config.fleet import RangeNeighbours as Range
from companion.config.law import Law, LawName
from companion.config.reference import PointReference
from companion.types import CommandName, Role, Vector3
from sitl.config import Airframe
from sitl.config import StandIn as StandInConfig
from sitl.scenario import Scenario
from sitl.shapes import LEADER, grid, is_connected
from sitl.timeline import TimelineStep

APART_M = 1.2  # at the start
FIELD_PER_VEHICLE_M2 = 3.0  # with a range of 3 m: mostly connected, seldom all with all
GOAL_M = (2.0, 6.0)  # how far the reference is from where the leader starts
HEIGHT_M = 1.0
FENCE_M = 500.0
DRAWS = 10_000


@dataclass(frozen=True, slots=True)
class Start:
    """One random start; places over ground and goal in metres, ENU."""

    seed: int
    places_enu_m: dict[int, Vector3]
    goal_enu_m: Vector3

    def scenario(self, law: LawName, neighbours: Range) -> Scenario:
        """The formation is a grid of two columns behind the leader."""
        ids = sorted(self.places_enu_m)
        slots = self._slots_enu_m()
        members = tuple(
            FormationMember(id=i, role=Role.LEADER if i == LEADER else Role.FOLLOWER, slot_enu_m=slots[i]) for i in ids
        )
        fence = Envelope(fence_min_enu_m=(-FENCE_M, -FENCE_M, -5.0), fence_max_enu_m=(FENCE_M, FENCE_M, 50.0))
        return Scenario(
            description=f"Random start {self.seed} of {len(ids)} vehicles that see {neighbours.range_m:g} m far.",
            fleet=FleetConfig(
                name=f"start-{self.seed}",
                origin=GeodeticOrigin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_amsl_m=488.0),
                vehicles=members,
                neighbours=neighbours,
                law=Law(name=law),
                takeoff_height_m=HEIGHT_M,
                envelope=fence,
            ),
            starts_enu_m=self.places_enu_m,
            reference=PointReference(point_enu_m=self.goal_enu_m),
            stand_in=StandInConfig(sensors="ideal", seed=self.seed, airframe=Airframe(drag_n_per_m_s=0.0)),
            timeline=(TimelineStep(command=CommandName.FORM, for_s=30.0),),
        )

    def _slots_enu_m(self) -> dict[int, Vector3]:
        """Every follower's slot, so that the squares of all ways sum up to the least: straight ones then keep apart.

        How far the leader leads them away does not change who is to fly where.
        """
        followers = sorted(set(self.places_enu_m) - {LEADER})
        slots = grid((len(followers) + 2) // 2, 2).slots_enu_m
        free = [slots[i] for i in followers]
        squares_m2 = [[dist(self.places_enu_m[i], self._place_of(slot)) ** 2 for slot in free] for i in followers]
        _, chosen = linear_sum_assignment(squares_m2)
        return {LEADER: slots[LEADER]} | {i: free[k] for i, k in zip(followers, chosen, strict=True)}

    def _place_of(self, slot_enu_m: Vector3) -> Vector3:
        """On the ground, if the leader did not move."""
        x, y, z = self.places_enu_m[LEADER]
        return (x + slot_enu_m[0], y + slot_enu_m[1], z + slot_enu_m[2])


def random_start(vehicles: int, range_m: float, seed: int) -> Start:
    """Drawn until it is connected and nobody is nearer than APART_M to another. Raises ValueError where that does not come."""
    generator = np.random.default_rng(seed)
    side_m = sqrt(vehicles * FIELD_PER_VEHICLE_M2) * range_m / 3.0
    for _ in range(DRAWS):
        thrown = generator.uniform(0.0, side_m, (vehicles, 2))
        places: dict[int, Vector3] = {i: (round(x, 3), round(y, 3), 0.0) for i, (x, y) in enumerate(thrown, start=1)}
        if _fits(places, range_m):
            return Start(seed, places, _goal(places[LEADER], generator))
    raise ValueError(
        f"no start of {vehicles} vehicles with a range of {range_m:g} m is connected with everybody {APART_M:g} m apart, in "
        f"{DRAWS} draws with seed {seed}"
    )


def _fits(places: dict[int, Vector3], range_m: float) -> bool:
    graph: dict[int, list[int]] = {i: [] for i in places}
    for i, j in combinations(places, 2):
        apart_m = dist(places[i], places[j])
        if apart_m < APART_M:
            return False
        if apart_m <= range_m:
            graph[i].append(j)
            graph[j].append(i)
    return is_connected(graph)


def _goal(leader: Vector3, generator: np.random.Generator) -> Vector3:
    far_m, turn = generator.uniform(*GOAL_M), generator.uniform(0.0, 2.0 * pi)
    return (round(leader[0] + far_m * cos(turn), 3), round(leader[1] + far_m * sin(turn), 3), HEIGHT_M)
