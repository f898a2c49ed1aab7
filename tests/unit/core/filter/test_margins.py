"""Margins for position errors: one packet may report any error, and no margin is worth the fence or an obstacle."""

from __future__ import annotations

import pytest

from companion.config.fleet import Envelope
from companion.config.values import CylinderObstacle, Obstacle
from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.values import Vector3
from stage_fleets import Body, Noise, SeparationFlight, counted_m, off_m, to_goal

SEPARATION_M = 1.0
HUGE = PositionError(9999.0, 9999.0)
HOME: Vector3 = (0.0, 0.0, 5.0)
FENCE = Envelope(fence_min_enu_m=(-0.6, -20.0, -5.0))
CYLINDER = CylinderObstacle(centre_enu_m=(-1.6, 0.0), radius_m=1.0)
INTO_CLEARANCE_M = 0.1  # as flown at the fence with the attitude lag


def beside(
    other_enu_m: Vector3, phase: FlightPhase, envelope: Envelope | None = None, obstacles: tuple[Obstacle, ...] = ()
) -> SeparationFlight:
    own = Body(1, HOME, to_goal(HOME), slot=FlownSlot(HOME))
    other = Body(2, other_enu_m, to_goal(other_enu_m), phase=phase, filters=False, slot=FlownSlot(other_enu_m))
    flight = SeparationFlight([own, other], SEPARATION_M, envelope=envelope, obstacles=obstacles)
    flight.reported_error[2] = HUGE
    return flight


@pytest.mark.parametrize("phase", [FlightPhase.HOLD, FlightPhase.FORMATION])
def test_one_packet_with_a_huge_error_and_silence_push_nothing_away(phase: FlightPhase) -> None:
    flight = beside((5.0, 0.0, 5.0), phase)
    flight.fly(0.04)
    flight.silent.add(2)
    flight.fly(20.0)
    assert off_m(flight.bodies[1], HOME) < 0.05


def test_a_huge_error_of_a_vehicle_in_hold_counts_for_one_separation() -> None:
    flight = beside((1.5, 0.0, 5.0), FlightPhase.HOLD)
    flight.fly(8.0)
    nearest = flight.reports[1].nearest
    assert nearest is not None and nearest.required_m == pytest.approx(2.15, abs=0.01)


def test_the_own_error_counts_for_one_separation() -> None:
    flight = SeparationFlight(
        [Body(1, HOME, to_goal(HOME)), Body(2, (5.0, 0.0, 5.0), to_goal((5.0, 0.0, 5.0)), phase=FlightPhase.HOLD)],
        SEPARATION_M,
        Noise(reported=HUGE),
    )
    flight.fly(5.0)
    assert off_m(flight.bodies[1], HOME) < 0.05


@pytest.mark.parametrize(("envelope", "obstacles"), [(FENCE, ()), (None, (CYLINDER,))])
@pytest.mark.parametrize("silent", [False, True])
def test_margins_push_no_vehicle_into_the_clearance(
    envelope: Envelope | None, obstacles: tuple[Obstacle, ...], silent: bool
) -> None:
    """Both keep 0.5 m: 0.1 m is left on the far side of a vehicle 1.5 m away that may demand 2.15 or 2.65 m."""
    flight = beside((1.5, 0.0, 5.0), FlightPhase.HOLD, envelope, obstacles)
    flight.fly(0.04)
    if silent:
        flight.silent.add(2)
    least = 0.0
    for _ in range(500):
        flight.tick()
        least = min(least, flight.bodies[1].position_enu_m[0])
    assert least >= -0.1 - INTO_CLEARANCE_M


def test_separation_itself_comes_before_the_fence_for_two_seconds() -> None:
    """Then the fence does: the vehicle keeps as far off as it allows."""
    flight = beside((0.5, 0.0, 5.0), FlightPhase.HOLD, FENCE)
    flight.fly(2.0)
    assert flight.bodies[1].position_enu_m[0] <= -0.4
    flight.fly(8.0)
    assert flight.bodies[1].position_enu_m[0] == pytest.approx(-0.1, abs=0.05)
    assert flight.reports[1].unshaken == ("2",)


@pytest.mark.parametrize(
    ("start_enu_m", "goal_enu_m", "margin_m"),
    [((2.0, 0.0, 5.0), (0.2, 0.0, 5.0), 0.4), ((0.0, 0.0, 9.0), (0.0, 0.0, 6.5), 0.4 + 0.5 * 0.6)],
    ids=["beside", "above"],
)
@pytest.mark.parametrize("of_the_other", [False, True])
def test_an_error_of_a_vehicle_or_of_the_other_one_adds_to_the_distance_that_is_kept(
    of_the_other: bool, start_enu_m: Vector3, goal_enu_m: Vector3, margin_m: float
) -> None:
    """0.6 m of error in height count half, and above the other vehicle only. 0.15 m are kept before any in hold."""
    error, none = PositionError(0.4, 0.6), PositionError(0.0, 0.0)
    own = Body(1, start_enu_m, to_goal(goal_enu_m))
    other = Body(2, HOME, to_goal(HOME), phase=FlightPhase.HOLD, filters=False)
    flight = SeparationFlight([own, other], SEPARATION_M, Noise(reported=none if of_the_other else error))
    flight.reported_error[2] = error if of_the_other else none
    flight.fly(10.0)
    nearest = flight.reports[1].nearest
    assert nearest is not None
    assert nearest.required_m == pytest.approx(SEPARATION_M + 0.15 + margin_m, abs=0.01)
    assert counted_m(own.position_enu_m, HOME) == pytest.approx(nearest.required_m, abs=0.01)
