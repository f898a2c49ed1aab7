"""Moving targets of a scenario, and the reference as reported by leaders."""

from __future__ import annotations

import pytest

from common import with_fields
from companion.config.reference import PointReference, WaypointsReference
from companion.types.autopilot import LandedState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NeighbourReport,
    SafetyReport,
    Status,
)
from companion.types.values import Vector3
from companion.wire.messages import Percentiles, StatusReport, Timing
from sitl.flight.director import MovingTargets
from sitl.flight.scenario import MovingTarget
from sitl.flight.watch import FlightWatch

NOTHING = Percentiles(0.0, 0.0, 0.0)
LEADING = Status(
    agent=AgentIdentity(vehicle_id=1, session=1, fleet="pair", formation_hash=1, law="weighted"),
    phase=FlightPhase.FORMATION,
    autopilot=AutopilotReport(mode_name="OFFBOARD", armed=True, landed=LandedState.IN_AIR),
    motion=MotionReport(position_enu_m=(0.0, 0.0, 2.0), velocity_enu_m_s=(0.0, 0.0, 0.0), state_age_s=0.01),
    control=ControlReport(hover_thrust_norm=0.5, disturbance_enu_m_s2=(0.0, 0.0, 0.0)),
    leadership=LeadershipReport(
        role=Role.LEADER, epoch=0, prc=1, leader_beacon=LeaderBeacon(1, 0, 1, 10.0), leader_beacon_age_s=0.0
    ),
    neighbourhood=NeighbourReport(neighbours=()),
    formation=FormationReport(slot=FlownSlot((0.0, 0.0, 0.0)), reference_enu_m=(0.0, 0.0, 2.0)),
    safety=SafetyReport(flags=()),
    rejected={},
    last_event="",
)


def test_each_target_is_published_ten_times_a_second_within_its_time() -> None:
    walker = MovingTarget(
        name="walker", path=WaypointsReference(((0.0, 0.0, 0.0), (10.0, 0.0, 0.0))), begins_s=1.0, ends_s=3.0
    )
    tree = MovingTarget(name="tree", path=PointReference((1.0, 2.0, 3.0)))
    published: list[tuple[str, Vector3, Vector3]] = []
    targets = MovingTargets([walker, tree], lambda *state: published.append(state), began_s=100.0)
    for tick in range(251):
        targets.update(100.0 + tick * 0.02)
    trees = [state for state in published if state[0] == "tree"]
    assert len(trees) == pytest.approx(50, abs=2)
    assert set(trees) == {("tree", (0.0, 0.0, 0.0), (1.0, 2.0, 3.0))}
    walks = [state for state in published if state[0] == "walker"]
    assert len(walks) == pytest.approx(20, abs=2)
    assert walks[0][2] == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    x_m = [x for _, _, (x, _, _) in walks]
    assert x_m == sorted(x_m)
    position, velocity, _ = walker.path.curve()(2.0)
    assert walks[-1][2] == pytest.approx(position, abs=0.11)
    assert walks[-1][1] == pytest.approx(velocity, abs=0.11)


def watched(*reported: tuple[float, float]) -> FlightWatch:
    """A watch that has received reports of a leader: (reference time in s, x of r in m)."""
    watch = FlightWatch([1], [1], 0.0)
    for number, (reference_s, x) in enumerate(reported):
        status = with_fields(
            LEADING, leader_beacon=LeaderBeacon(1, 0, number, reference_s), reference_enu_m=(x, 0.0, 2.0)
        )
        watch.receive(StatusReport(status, Timing(50.0, 1, 0, NOTHING, NOTHING, 5.0, 49.0)), 50.0 + number)
    return watch


def test_the_reported_reference_is_interpolated_and_constant_outside_its_times() -> None:
    reference = watched((10.0, 1.0), (10.1, 2.0), (10.2, 4.0)).reported_reference()
    for reference_s, x in ((0.0, 1.0), (10.0, 1.0), (10.05, 1.5), (10.15, 3.0), (10.2, 4.0), (99.0, 4.0)):
        assert reference(reference_s).position_enu_m == pytest.approx((x, 0.0, 2.0))


def test_the_later_leader_beacon_replaces_the_earlier_and_a_new_flight_resets_the_record() -> None:
    watch = watched((10.0, 1.0), (10.1, 2.0), (10.09, 2.5), (10.2, 4.0))
    assert [x for _, (x, _, _) in watch.reference] == [1.0, 2.5, 4.0]
    assert [x for _, (x, _, _) in watched((10.0, 1.0), (10.1, 2.0), (0.1, 7.0)).reference] == [7.0]
