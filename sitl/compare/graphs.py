"""The graphs of a comparison: each makes a scenario of any number of vehicles.

From rest in their slots the vehicles follow a step of 1 m, without noise, wind and drag. Disturbance observer and velocity
correction are off: the laws are compared, not what flies beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, dist, pi, sin

import numpy as np

from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig, FormationMember, RangeNeighbours
from companion.config.law import LawSection
from companion.config.planned_flight import DEFAULT_ORIGIN
from companion.config.reference import PointReference
from companion.types.commands import CommandName
from companion.types.flight import Role
from companion.types.values import Vector3
from sitl.compare.shapes import (
    LEADER,
    RANGE_M,
    Shape,
    chain,
    chain_led_at_both_ends,
    grid,
    random_geometric,
    ring,
    star,
)
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.vehicle.config import Airframe, StandIns

STEP_M = 1.0
HEIGHT_M = 2.0
FENCE_M = 1000.0
HYSTERESIS_M = 0.3
GOAL_M = (2.0, 6.0)  # distance of the reference from the leader's start, where neighbours change with range
FORM_S = 60.0  # a comparison sets its own
SLOT_SPEED_M_S = 50.0  # so fast that real agents fly the law from where they are, and no paths into their slots


@dataclass(frozen=True, slots=True)
class Graph:
    """A graph by name: what it is in a line, and the scenario of so many vehicles with this seed."""

    about: str
    scenario: Callable[[int, int], Scenario]


def led(shape: Shape, seed: int) -> Scenario:
    """The shape follows a step of its reference along x."""
    neighbours = EdgeNeighbours(edges=shape.edges)
    return _scenario(shape, shape.slots_enu_m, neighbours, (STEP_M, 0.0, HEIGHT_M), seed)


def gathering(n: int, seed: int) -> Scenario:
    """Random starts, in range of each other by some path, and a goal some metres from the leader.

    Slots of a grid are assigned with the least sum of squared distances, so that few straight paths cross.
    """
    from scipy.optimize import linear_sum_assignment

    generator = np.random.default_rng(seed)
    starts, slots = random_geometric(n, generator).slots_enu_m, grid(n).slots_enu_m
    followers = [i for i in starts if i != LEADER]
    squares_m2 = [[dist(starts[i], slots[j]) ** 2 for j in followers] for i in followers]
    assigned = linear_sum_assignment(squares_m2)[1] if followers else []
    own = {LEADER: slots[LEADER]} | {i: slots[followers[k]] for i, k in zip(followers, assigned, strict=True)}
    away_m, turn = generator.uniform(*GOAL_M), generator.uniform(0.0, 2.0 * pi)
    goal = (round(away_m * cos(turn), 3), round(away_m * sin(turn), 3), HEIGHT_M)
    neighbours = RangeNeighbours(range_m=RANGE_M, hysteresis_m=HYSTERESIS_M)
    return _scenario(Shape(f"range-{n}", own, ()), starts, neighbours, goal, seed)


def _scenario(
    shape: Shape,
    starts_enu_m: Mapping[int, Vector3],
    neighbours: EdgeNeighbours | RangeNeighbours,
    goal_enu_m: Vector3,
    seed: int,
) -> Scenario:
    """As a whole flight, so that `sitl run` flies it too."""
    fence = Envelope(fence_min_enu_m=(-FENCE_M, -FENCE_M, -5.0), fence_max_enu_m=(FENCE_M, FENCE_M, 50.0))
    members = tuple(
        FormationMember(id=i, role=Role.LEADER if i in shape.leaders else Role.FOLLOWER, slot_enu_m=slot)
        for i, slot in sorted(shape.slots_enu_m.items())
    )
    return Scenario(
        description=f"{shape.name}: a step of its reference.",
        fleet=FleetConfig(
            name=shape.name,
            origin=DEFAULT_ORIGIN,
            vehicles=members,
            neighbours=neighbours,
            law=LawSection(disturbance_bandwidth_1_s=0.0, velocity_correction_1_s=0.0),
            takeoff_height_m=HEIGHT_M,
            slot_speed_m_s=SLOT_SPEED_M_S,
            envelope=fence,
        ),
        starts_enu_m=starts_enu_m,
        reference=PointReference(point_enu_m=goal_enu_m),
        stand_in=StandIns(sensors="ideal", seed=seed, airframe=Airframe(drag_n_per_m_s=0.0)),
        timeline=(
            TimelineStep(command=CommandName.PREPARE),
            TimelineStep(command=CommandName.ARM),
            TimelineStep(command=CommandName.TAKEOFF, for_s=5.0),
            TimelineStep(command=CommandName.FORM, for_s=FORM_S),
        ),
    )


def _of(shape: Callable[[int], Shape]) -> Callable[[int, int], Scenario]:
    return lambda n, seed: led(shape(n), seed)


GRAPHS: dict[str, Graph] = {
    "chain": Graph("a line behind its leader: the deepest graph", _of(chain)),
    "ring": Graph("a circle with one leader on it", _of(ring)),
    "star": Graph("a leader in the middle, the only neighbour of all others", _of(star)),
    "grid": Graph("a square grid with its leader at a corner", _of(grid)),
    "random": Graph(
        f"random places, neighbours within {RANGE_M:g} m; another graph with each seed",
        lambda n, seed: led(random_geometric(n, np.random.default_rng(seed)), seed),
    ),
    "two_leaders": Graph("a line with a leader at both ends", _of(chain_led_at_both_ends)),
    "range": Graph(
        f"random starts far from the slots of a grid, neighbours that change with a range of {RANGE_M:g} m", gathering
    ),
}
