"""The downwash of a vehicle reaches far below it: a vehicle that passes over or under another one keeps twice the height."""

from __future__ import annotations

import pytest

from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.values import Vector3
from stage_fleets import DRAG_1_S, Body, SeparationFlight, Wish, counted_m, off_m, to_goal

SEPARATION_M = 1.0
HOME: Vector3 = (0.0, 0.0, 5.0)
FORMATION, HOLD, OBSERVE = FlightPhase.FORMATION, FlightPhase.HOLD, FlightPhase.OBSERVE


def eastward(speed_m_s: float, height_m: float) -> Wish:
    """Along y = 0 at this height."""

    def wish(_now_s: float, vehicle: VehicleState) -> Vector3:
        (_, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        x_m_s2 = 2.0 * (speed_m_s - vx) + DRAG_1_S * vx
        return (x_m_s2, -1.4 * y - 1.2 * vy, 1.4 * (height_m - z) - 1.2 * vz)

    return wish


def passing(above_m: float, speed_m_s: float, other: Body) -> SeparationFlight:
    """A vehicle that flies eastward, above or below another one at HOME."""
    start: Vector3 = (-6.0, 0.0, HOME[2] + above_m)
    one = Body(1, start, eastward(speed_m_s, start[2]), slot=FlownSlot((0.0, 0.0, 3.0)))
    flight = SeparationFlight([one, other], SEPARATION_M)
    flight.fly(15.0 / speed_m_s)
    return flight


def at_home(phase: FlightPhase) -> Body:
    """Only in formation it makes way itself."""
    return Body(2, HOME, to_goal(HOME), phase=phase, filters=phase is FORMATION, slot=FlownSlot((0.0, 0.0, 0.0)))


@pytest.mark.parametrize("above_m", [1.5, -1.5])
@pytest.mark.parametrize("phase", [FORMATION, HOLD])
@pytest.mark.parametrize("speed_m_s", [1.0, 2.0])
def test_a_vehicle_that_passes_over_or_under_another_one_keeps_the_separation_with_heights_counted_half(
    speed_m_s: float, phase: FlightPhase, above_m: float
) -> None:
    flight = passing(above_m, speed_m_s, at_home(phase))
    assert flight.least_counted_m >= SEPARATION_M
    assert flight.bodies[1].position_enu_m[0] > 3.0
    assert flight.interventions > 0


@pytest.mark.parametrize("phase", [FORMATION, HOLD])
def test_a_vehicle_that_passes_over_another_one_high_enough_flies_straight_on(phase: FlightPhase) -> None:
    flight = passing(2.51, 1.0, at_home(phase))
    assert flight.interventions == 0
    assert flight.least_counted_m == pytest.approx(1.255, abs=0.01)


def test_a_vehicle_whose_goal_is_above_another_one_stays_beside_it() -> None:
    above: Vector3 = (0.2, 0.0, 6.5)
    flight = SeparationFlight([Body(1, (3.0, 0.0, 6.5), to_goal(above)), at_home(HOLD)], SEPARATION_M)
    flight.fly(10.0)
    assert flight.least_counted_m >= SEPARATION_M
    assert counted_m(flight.bodies[1].position_enu_m, HOME) == pytest.approx(1.15, abs=0.02)
    assert off_m(flight.bodies[1], HOME) > 1.5


def test_no_downwash_is_counted_over_a_vehicle_on_the_ground() -> None:
    flight = passing(1.3, 1.0, Body(2, HOME, to_goal(HOME), phase=OBSERVE, filters=False, armed=False))
    assert flight.interventions == 0
    assert flight.nearest_m == pytest.approx(1.3, abs=0.01)
