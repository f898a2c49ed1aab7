"""The filter outside formation, while the agent hands over to the autopilot: no other vehicle takes a share."""

from __future__ import annotations

import pytest

from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.values import Vector3
from stage_fleets import DRAG_1_S, Body, SeparationFlight, to_goal

SEPARATION_M = 1.0
HOME: Vector3 = (0.0, 0.0, 5.0)
FORMATION, HOLD, RELEASE = FlightPhase.FORMATION, FlightPhase.HOLD, FlightPhase.RELEASE


def drift(_now_s: float, vehicle: VehicleState) -> Vector3:
    """Keeps the velocity over ground, as with a wind from behind."""
    vx, vy, vz = vehicle.velocity_enu_m_s
    return (DRAG_1_S * vx, DRAG_1_S * vy, DRAG_1_S * vz)


@pytest.mark.parametrize("phase_of_other", [FORMATION, HOLD])
@pytest.mark.parametrize("speed_m_s", [1.0, 3.0, 6.0])
def test_a_vehicle_that_hands_over_makes_way_alone(speed_m_s: float, phase_of_other: FlightPhase) -> None:
    """The other one rests, whatever its phase: not every vehicle in formation can make way."""
    own = Body(1, (-12.0, 0.0, 5.0), drift, (speed_m_s, 0.0, 0.0), RELEASE, slot=FlownSlot((-3.0, 0.0, 0.0)))
    other = Body(2, HOME, to_goal(HOME), phase=phase_of_other, filters=False)
    flight = SeparationFlight([own, other], SEPARATION_M)
    flight.fly(15.0)
    assert flight.nearest_m >= SEPARATION_M
    assert flight.interventions > 0


def test_two_vehicles_that_drift_at_each_other_in_their_hand_over_stay_apart() -> None:
    starts: dict[int, tuple[Vector3, Vector3]] = {
        1: ((-6.0, 0.0, 5.0), (2.0, 0.0, 0.0)),
        2: ((6.0, 0.3, 5.0), (-2.0, 0.0, 0.0)),
    }
    bodies = [Body(i, at, drift, moving, RELEASE) for i, (at, moving) in starts.items()]
    flight = SeparationFlight(bodies, SEPARATION_M)
    flight.fly(8.0)
    assert flight.nearest_m >= SEPARATION_M
    assert flight.interventions > 0


def test_a_vehicle_near_another_one_is_pushed_away_as_soon_as_it_hands_over() -> None:
    own = Body(1, (0.5, 0.0, 5.0), drift, phase=RELEASE)
    flight = SeparationFlight([own, Body(2, HOME, to_goal(HOME), phase=HOLD, filters=False)], SEPARATION_M)
    flight.fly(3.0)
    assert own.position_enu_m[0] >= SEPARATION_M


def test_a_vehicle_that_hands_over_keeps_what_is_kept_before_a_vehicle_that_makes_no_way() -> None:
    """Two vehicles in formation, 1.2 m apart in their slots, keep no more than separation_m from each other."""
    for phase, required_m in ((RELEASE, 1.15), (FORMATION, 1.0)):
        own = Body(1, (-3.0, 0.0, 5.0), drift, (0.5, 0.0, 0.0), phase, slot=FlownSlot((-1.2, 0.0, 0.0)))
        flight = SeparationFlight([own, Body(2, HOME, to_goal(HOME), filters=False)], SEPARATION_M)
        flight.fly(12.0)
        assert flight.nearest_m == pytest.approx(required_m, abs=0.02)
