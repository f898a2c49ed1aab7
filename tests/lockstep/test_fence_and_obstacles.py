"""Flight of real agents inside a concave fence and past obstacles: as planned, and where no check foresaw the way.

What no check has seen: a reference that leads through a wall at the speed limit, put into the leader's plan; a target that
moves as it likes. The law obeys; the safety filter of each vehicle stops it.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np
import pytest

from common import ROOT
from companion.core.reference.blend import ReferenceTrajectory
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.formation import FormationState
from companion.types.values import ZERO3, Vector3
from lockstep_fleet import READY_SOON, EnteringFleet, FlownScenario
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario
from sitl.report.metrics import SAMPLE_S

SCENARIO = ROOT / "config" / "scenarios" / "fence_and_obstacles.yaml"
SET_OFF = "timeline=[{command: prepare}, {command: arm}, {command: takeoff, for_s: 3}]"
SPEED_M_S = 6.0  # max_speed_m_s of the scenario
REACHED = 0.8  # of it: the limit holds back more, the nearer the speed is to it, and the airframe has drag
INTO_CLEARANCE_M = 0.1  # as docs/safety.md states
BEYOND_M = 5.0
START_ENU_M: Vector3 = (0.0, 0.0, 4.0)  # of the reference
EAST: Vector3 = (1.0, 0.0, 0.0)
# Side of the polygon to the east, the same with a slant, a mast and a shed across the way: all some 20 m east of the start.
WALLS = {
    "polygon": (),
    "slanting polygon": ("fleet.envelope.fence_corners_enu_m=[[-9, -9], [20, -9], [29, 33], [-9, 33]]",),
    "cylinder": (
        "fleet.obstacles=[{kind: cylinder, centre_enu_m: [24.0, 0.5], radius_m: 3.0, bottom_m: 0.0, top_m: 9.0}]",
    ),
    "box": ("fleet.obstacles=[{kind: box, min_enu_m: [20.0, -5.0, 0.0], max_enu_m: [24.0, 4.0, 9.0]}]",),
}


def test_the_scenario_is_flown_clear_of_all() -> None:
    flight = FlownScenario(load_scenario(SCENARIO))
    assert flight.failures == []
    assert least_room_m(flight.scenario, flight.lockstep, flight.formation.start_s, flight.formation.end_s) > 0.0


def least_room_m(scenario: Scenario, lockstep: Lockstep, from_s: float, until_s: float) -> float:
    """Smallest true distance of any vehicle to fence and obstacles, less the clearance."""
    times_s = np.arange(from_s, until_s, SAMPLE_S)
    tracks = [s.track().at(times_s) for s in lockstep.stand_ins]
    return min(scenario.fleet.airspace.room_m((float(x), float(y), float(z))) for t in tracks for x, y, z in t)


class Flight:
    """The fleet of the scenario in formation."""

    def __init__(self, *overrides: str) -> None:
        self.scenario = load_scenario(SCENARIO, [*READY_SOON, SET_OFF, *overrides])
        self.fleet = EnteringFleet(self.scenario)
        self.lockstep = self.fleet.lockstep
        assert self.fleet.accepted(CommandName.FORM)
        self.fleet.go_on(2.0)
        self.began_s = self.lockstep.now_s()

    def lead_by(self, trajectory: ReferenceTrajectory) -> None:
        """Fly this from now on, whatever lies in the way. Time 0 is that of the next tick."""
        begun_s, plan = inf, self.lockstep.vehicles[1].agent.guidance.references
        assert plan is not None

        def at(reference_s: float) -> FormationState:
            nonlocal begun_s
            begun_s = min(begun_s, reference_s)
            return trajectory(reference_s - begun_s)

        plan.at = at  # type: ignore[method-assign]

    def check(self) -> None:
        """All are in formation, apart from each other and clear of everything."""
        assert self.fleet.phases() == {FlightPhase.FORMATION}, self.fleet.events
        assert self.fleet.smallest_m() > self.scenario.fleet.separation_m
        room_m = least_room_m(self.scenario, self.lockstep, self.began_s, self.lockstep.now_s() - 0.1)
        assert room_m > -INTO_CLEARANCE_M

    def reference_enu_m(self) -> Vector3:
        """The reference in the leader's newest report."""
        reference_enu_m = self.fleet.newest[1].formation.reference_enu_m
        assert reference_enu_m is not None
        return reference_enu_m

    def reference_room_m(self) -> float:
        """That of the leader's slot, which the reference asks for now."""
        x, y, z = self.reference_enu_m()
        return self.scenario.fleet.airspace.room_m((x + 1.5, y + 1.5, z))


def straight(start_enu_m: Vector3, direction: Vector3, way_m: float, speed_m_s: float) -> ReferenceTrajectory:
    """This far in a direction: up to the speed with 2 m/s^2, and a stop at once."""
    ramp_s = speed_m_s / 2.0

    def at(t: float) -> FormationState:
        way, v, a = (t * t, 2.0 * t, 2.0) if t < ramp_s else (speed_m_s * (t - ramp_s / 2.0), speed_m_s, 0.0)
        if way > way_m:
            return FormationState(ahead(start_enu_m, direction, way_m), ZERO3)
        return FormationState(
            ahead(start_enu_m, direction, way), ahead(ZERO3, direction, v), ahead(ZERO3, direction, a)
        )

    return at


def ahead(start: Vector3, direction: Vector3, way: float) -> Vector3:
    (x, y, z), (dx, dy, dz) = start, direction
    return (x + way * dx, y + way * dy, z + way * dz)


@pytest.mark.parametrize("wall", WALLS)
def test_vehicles_led_through_a_wall_at_the_speed_limit_stop_before_it(wall: str) -> None:
    flight = Flight(*WALLS[wall])
    flight.lead_by(straight(START_ENU_M, EAST, 24.0 + BEYOND_M, SPEED_M_S))
    flight.fleet.go_on(9.0)
    assert REACHED * SPEED_M_S < flight.fleet.largest_speed_m_s() <= SPEED_M_S
    assert flight.reference_room_m() < -1.0
    flight.check()


class Side(NamedTuple):
    """A side of the box of the fence, as a half-space of all positions that keep the clearance: outward . p <= most_m.

    `limit_m_s` is the speed limit of the fleet file in this direction.
    """

    outward: Vector3
    most_m: float
    limit_m_s: float
    start_enu_m: Vector3 = START_ENU_M
    overrides: tuple[str, ...] = ()


BOX_ALONE = (
    "fleet.envelope.fence_corners_enu_m=[]",
    "fleet.envelope.fence_min_enu_m=[-10.0, -24.0, -0.5]",
    "fleet.envelope.fence_max_enu_m=[28.0, 34.0, 18.0]",
    "fleet.obstacles=[]",
)
HIGH_ABOVE_THE_FLOOR = (
    "fleet.envelope.clearance_m=3.0",  # vehicles take off within the fence
    "fleet.takeoff_height_m=10.0",
    "reference={kind: point, point_enu_m: [0.0, 0.0, 10.0]}",
)
SIDES = {
    "east": Side(EAST, 27.5, SPEED_M_S),
    "south": Side((0.0, -1.0, 0.0), 23.5, SPEED_M_S),
    "ceiling": Side((0.0, 0.0, 1.0), 17.5, 3.0),
    "floor": Side((0.0, 0.0, -1.0), -2.5, 2.0, (0.0, 0.0, 10.0), HIGH_ABOVE_THE_FLOOR),
}


@pytest.mark.parametrize("side", SIDES)
def test_vehicles_led_through_a_side_of_a_box_faster_than_they_may_fly_stop_before_it(side: str) -> None:
    outward, most_m, limit_m_s, start_enu_m, overrides = SIDES[side]
    flight = Flight(*BOX_ALONE, *overrides)
    way_m = most_m - float(np.dot(start_enu_m, outward)) + BEYOND_M
    flight.lead_by(straight(start_enu_m, outward, way_m, limit_m_s + 2.0))
    flight.fleet.go_on(9.0)
    farthest_m, fastest_m_s = farthest_and_fastest(flight, outward)
    assert farthest_m == pytest.approx(most_m, abs=INTO_CLEARANCE_M)
    assert REACHED * limit_m_s < fastest_m_s <= limit_m_s
    flight.check()


def farthest_and_fastest(flight: Flight, direction: Vector3) -> tuple[float, float]:
    """Largest true coordinate of any vehicle in this direction, and its largest rate, since formation."""
    times_s = np.arange(flight.began_s, flight.lockstep.now_s() - 0.1, SAMPLE_S)
    along_m = [s.track().at(times_s) @ np.array(direction) for s in flight.lockstep.stand_ins]
    return float(np.max(along_m)), float(np.max(np.gradient(along_m, times_s, axis=1)))


def walk(flight: Flight, target_enu_m: Vector3, seconds: float) -> None:
    """A target walks from the fleet to this position at 3 m/s, and publishes where it is."""
    begun_s, way_m = flight.lockstep.now_s(), float(np.linalg.norm(target_enu_m))
    direction = np.array(target_enu_m) / way_m
    for _ in range(round(seconds / 0.1)):
        gone_m = min(way_m, 3.0 * (flight.lockstep.now_s() - begun_s))
        velocity = direction * (3.0 if gone_m < way_m else 0.0)
        flight.lockstep.publish_target("walker", tuple(map(float, velocity)), tuple(map(float, direction * gone_m)))
        flight.fleet.go_on(0.1)


@pytest.mark.parametrize(
    ("target_enu_m", "reaches_enu_m"),
    [((0.0, 20.0, 0.0), (0.0, 6.0, 4.0)), ((9.0, 4.5, 0.0), None)],
    ids=["beyond the polygon", "at the mast"],
)
def test_a_target_that_walks_out_of_the_airspace_is_awaited_before_it(
    target_enu_m: Vector3, reaches_enu_m: Vector3 | None
) -> None:
    reference = "{kind: target, name: walker, start_enu_m: [0.0, 0.0, 4.0], max_speed_m_s: 3.5}"
    flight = Flight(f"reference={reference}")
    walk(flight, target_enu_m, 12.0)
    assert flight.reference_room_m() > -0.01
    assert reaches_enu_m is None or np.linalg.norm(np.subtract(flight.reference_enu_m(), reaches_enu_m)) < 0.1
    flight.check()
