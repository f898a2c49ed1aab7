"""Flights of lagged vehicles under the separation filter."""

from math import cos, isfinite, pi, sin

import pytest

from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.values import Vector3
from stage_fleets import DEFAULT, IDEAL, PX4_SIH, Body, Link, Noise, SeparationFlight, off_m, to_goal

LATE_AND_LOSSY = Link(delay_s=0.1, loss=0.1)
NOISES = [(IDEAL, 1.0), (DEFAULT, 0.8), (PX4_SIH, 0.6)]
ROUNDING_M = 0.01


def exchange(positions: list[Vector3], goals: list[Vector3]) -> list[Body]:
    pairs = zip(positions, goals, strict=True)
    return [Body(i, a, to_goal(b), slot=FlownSlot(b)) for i, (a, b) in enumerate(pairs, start=1)]


def fly(bodies: list[Body], separation_m: float, noise: Noise, link: Link, seconds: float) -> SeparationFlight:
    flight = SeparationFlight(bodies, separation_m, noise, link)
    flight.fly(seconds)
    return flight


def farthest_m(flight: SeparationFlight, goals: list[Vector3]) -> float:
    return max(off_m(flight.bodies[i], goal) for i, goal in enumerate(goals, start=1))


@pytest.mark.parametrize(("noise", "share"), NOISES)
@pytest.mark.parametrize("link", [Link(), LATE_AND_LOSSY])
def test_two_vehicles_exchange_their_slots_head_on(noise: Noise, share: float, link: Link) -> None:
    ends: list[Vector3] = [(0.0, 0.0, 5.0), (6.0, 0.0, 5.0)]
    flight = fly(exchange(ends, ends[::-1]), 1.0, noise, link, 8.0)
    assert flight.nearest_m >= share
    assert farthest_m(flight, ends[::-1]) < 0.5


@pytest.mark.parametrize("noise", [IDEAL, DEFAULT, PX4_SIH])
def test_four_vehicles_exchange_crosswise_with_little_room(noise: Noise) -> None:
    corners: list[Vector3] = [(0.0, 0.0, 5.0), (3.0, 0.0, 5.0), (3.0, 3.0, 5.0), (0.0, 3.0, 5.0)]
    goals = corners[2:] + corners[:2]
    flight = fly(exchange(corners, goals), 2.5, noise, Link(), 10.0)
    assert flight.nearest_m >= 2.0
    assert farthest_m(flight, goals) < 0.6


def test_a_ring_of_eight_crosses_through_its_centre() -> None:
    ring = [(4.0 * cos(k * pi / 4.0), 4.0 * sin(k * pi / 4.0), 5.0) for k in range(8)]
    goals = ring[4:] + ring[:4]
    flight = fly(exchange(ring, goals), 1.0, IDEAL, LATE_AND_LOSSY, 12.0)
    assert flight.nearest_m >= 1.0 - ROUNDING_M
    assert farthest_m(flight, goals) < 0.5


def test_a_hovering_vehicle_in_the_way_is_passed() -> None:
    in_hold = Body(2, (4.0, 0.0, 5.0), to_goal((4.0, 0.0, 5.0)), phase=FlightPhase.HOLD, filters=False)
    flight = fly([Body(1, (0.0, 0.0, 5.0), to_goal((8.0, 0.0, 5.0))), in_hold], 1.0, IDEAL, LATE_AND_LOSSY, 8.0)
    assert flight.nearest_m >= 1.0 - ROUNDING_M
    assert off_m(flight.bodies[1], (8.0, 0.0, 5.0)) < 0.3


def test_a_vehicle_on_its_slot_is_not_circled() -> None:
    in_hold = Body(2, (4.0, 0.0, 5.0), to_goal((4.0, 0.0, 5.0)), phase=FlightPhase.HOLD, filters=False)
    flight = fly([Body(1, (0.0, 0.0, 5.0), to_goal((4.0, 0.0, 5.0))), in_hold], 1.0, IDEAL, Link(), 10.0)
    assert flight.nearest_m >= 1.0 - ROUNDING_M
    assert max(abs(v) for v in flight.bodies[1].velocity_enu_m_s) < 0.1


def test_a_vehicle_that_flies_straight_on_through_a_line_is_avoided() -> None:
    def straight_on(_now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        return (-1.5 * vx, 1.5 * (2.0 - vy), -1.5 * vz)

    line: list[Vector3] = [(1.5 * k, 0.0, 5.0) for k in range(4)]
    runaway = Body(5, (2.2, -8.0, 5.0), straight_on, (0.0, 2.0, 0.0), filters=False, slot=FlownSlot((0.0, -9.0, 0.0)))
    flight = fly([*exchange(line, line), runaway], 1.0, IDEAL, Link(), 8.0)
    assert flight.nearest_m >= 1.0 - ROUNDING_M
    assert farthest_m(flight, line) < 0.5


def test_vehicles_that_are_too_near_push_each_other_apart() -> None:
    here, there = (0.0, 0.0, 5.0), (0.3, 0.0, 5.0)
    flight = fly(exchange([here, there], [here, there]), 1.0, IDEAL, Link(), 4.0)
    assert off_m(flight.bodies[1], flight.bodies[2].position_enu_m) >= 1.0 - ROUNDING_M


def test_vehicles_at_the_same_position_part() -> None:
    here = (0.0, 0.0, 5.0)
    flight = fly(exchange([here, here], [here, here]), 1.0, IDEAL, Link(), 4.0)
    assert all(isfinite(c) for body in flight.bodies.values() for c in body.position_enu_m)
    assert off_m(flight.bodies[1], flight.bodies[2].position_enu_m) >= 1.0 - ROUNDING_M


def test_the_command_is_untouched_where_nothing_is_near() -> None:
    apart = [(0.0, 0.0, 5.0), (40.0, 0.0, 5.0)]
    flight = fly(exchange(apart, apart), 1.0, DEFAULT, Link(), 2.0)
    assert flight.interventions == 0


def test_a_silent_vehicle_stays_an_obstacle_and_is_given_more_room() -> None:
    line: list[Vector3] = [(0.0, 0.0, 5.0), (1.2, 0.0, 5.0)]
    flight = SeparationFlight(exchange(line, line), 1.0)
    flight.fly(1.0)
    flight.silent.add(2)
    flight.fly(6.0)
    nearest = flight.reports[1].nearest
    assert nearest is not None and nearest.required_m == pytest.approx(1.65, abs=0.05)
    assert off_m(flight.bodies[1], line[1]) > 1.3


def test_half_of_the_work_is_left_to_a_vehicle_that_cooperates() -> None:
    ends: list[Vector3] = [(0.0, 0.0, 5.0), (6.0, 0.0, 5.0)]
    flight = fly(exchange(ends, ends[::-1]), 1.0, IDEAL, Link(), 2.0)
    one, other = (body.position_enu_m for body in flight.bodies.values())
    assert one[1] == pytest.approx(-other[1], abs=0.05)  # both to their right, and alike
    assert one[1] < -0.2
