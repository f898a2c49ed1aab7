"""A vehicle that no evasion shakes off, as a false position is, carries none away: after 2 s or 5 m, limits and fence win."""

from __future__ import annotations

from collections.abc import Callable
from math import dist

import pytest

from companion.config.fleet import Envelope
from companion.types.flight import FlightPhase
from companion.types.values import ZERO3, Vector3
from stage_fleets import PX4_SIH, Body, Intruder, Link, SeparationFlight, to_goal

GOAL = (0.0, 0.0, 5.0)
TICK_S = 0.02
CLIMB_M_S, MARGIN_M_S = 3.0, 0.3  # of the default envelope
BEYOND_M = 8.0  # 5 m, and the way to brake
BACK_M = 3.0  # after some seconds: the way back is flown at 1 m/s
CARRIED_M = 15.0  # 5 m, and the way to brake and turn back
SMALL = Envelope(fence_min_enu_m=(-8.0, -8.0, -5.0), fence_max_enu_m=(8.0, 8.0, 9.0))


def hovering(vehicle_id: int = 1, goal_enu_m: Vector3 = GOAL) -> Body:
    return Body(vehicle_id, goal_enu_m, to_goal(goal_enu_m))


def still(_now_s: float, _vehicle: object) -> Vector3:
    return ZERO3


def haunted(
    offset_enu_m: Vector3, seconds: float, envelope: Envelope | None = None, phase: FlightPhase = FlightPhase.FORMATION
) -> tuple[SeparationFlight, list[Vector3], list[Vector3]]:
    """Vehicle 1 with a ghost that stays at this offset from it with its velocity; positions and velocities of vehicle 1."""
    ghost = Body(2, GOAL, still, phase=phase, filters=False)
    flight = SeparationFlight([hovering(), ghost], 1.0, envelope=envelope)

    def haunt() -> None:
        body = flight.bodies[1]
        (x, y, z), (dx, dy, dz) = body.position_enu_m, offset_enu_m
        ghost.position_enu_m, ghost.velocity_enu_m_s = (x + dx, y + dy, z + dz), body.velocity_enu_m_s

    return flight, *flown(flight, haunt, seconds)


def flown(flight: SeparationFlight, before: Callable[[], None], seconds: float) -> tuple[list[Vector3], list[Vector3]]:
    positions, velocities = [], []
    for _ in range(round(seconds / TICK_S)):
        before()
        flight.tick()
        positions.append(flight.bodies[1].position_enu_m)
        velocities.append(flight.bodies[1].velocity_enu_m_s)
    return positions, velocities


ON_IT = [ZERO3, (0.001, 0.0, 0.002), (0.1, -0.1, 0.0), (0.0, 0.0, -0.3), (0.0, 0.3, 0.3), (0.7, 0.0, 0.0)]


@pytest.mark.parametrize("offset_enu_m", ON_IT, ids=str)
@pytest.mark.parametrize("phase", [FlightPhase.FORMATION, FlightPhase.HOLD])
def test_a_ghost_on_a_vehicle_carries_it_nowhere(offset_enu_m: Vector3, phase: FlightPhase) -> None:
    """The way out is sideways, one way; after 2 s or 5 m the vehicle flies back to its place, under the ghost."""
    flight, positions, velocities = haunted(offset_enu_m, 10.0, phase=phase)
    assert max(dist(position, GOAL) for position in positions) < CARRIED_M
    assert all(abs(v[2]) < CLIMB_M_S for v in velocities)
    assert flight.reports[1].unshaken == ("2",)
    assert flight.reports[1].violated
    assert dist(positions[-1], GOAL) < 0.5


@pytest.mark.parametrize("offset_enu_m", [*ON_IT, (-0.9, 0.0, 0.1), (0.95, 0.0, 0.0), (0.0, 0.0, -1.9)], ids=str)
@pytest.mark.parametrize("phase", [FlightPhase.FORMATION, FlightPhase.HOLD])
def test_fence_and_speed_limits_win_over_a_vehicle_that_stays_near(offset_enu_m: Vector3, phase: FlightPhase) -> None:
    """They give way for 2 s or 5 m at most; then the vehicle brakes."""
    _, positions, velocities = haunted(offset_enu_m, 10.0, SMALL, phase)
    lowest, highest = SMALL.fence_min_enu_m, SMALL.fence_max_enu_m
    for position in positions:
        assert all(a - BEYOND_M < x < b + BEYOND_M for a, x, b in zip(lowest, position, highest, strict=True))
    fast = [v for v in velocities if abs(v[2]) > CLIMB_M_S + MARGIN_M_S]
    assert len(fast) * TICK_S < 2.0
    assert all(a - BACK_M < x < b + BACK_M for a, x, b in zip(lowest, positions[-1], highest, strict=True))


def test_two_vehicles_that_report_one_position_come_to_rest() -> None:
    """Both are honest, and their positions wrong: each evades, and neither sees that it moves."""
    one, other = hovering(1), hovering(2)
    flight = SeparationFlight([one, other], 1.0)

    def deceive() -> None:
        for body in (one, other):
            body.position_enu_m, body.velocity_enu_m_s = GOAL, ZERO3

    flown(flight, deceive, 6.0)
    assert flight.reports[1].unshaken == ("2",)
    assert flight.reports[2].unshaken == ("1",)


def test_an_aircraft_that_stays_on_a_vehicle_carries_it_nowhere() -> None:
    aircraft = Intruder("A1", GOAL, ZERO3, period_s=0.1)
    flight = SeparationFlight([hovering()], 1.0, intruders=[aircraft])

    def haunt() -> None:
        body = flight.bodies[1]
        aircraft.position_enu_m, aircraft.velocity_enu_m_s = body.position_enu_m, body.velocity_enu_m_s

    positions, _ = flown(flight, haunt, 10.0)
    assert max(dist(position, GOAL) for position in positions) < CARRIED_M
    assert flight.reports[1].unshaken == ("A1",)


def test_a_vehicle_that_was_not_shaken_off_counts_again_after_some_seconds() -> None:
    ghost = Body(2, GOAL, still, filters=False)
    flight = SeparationFlight([hovering(), ghost], 1.0)

    def haunt() -> None:
        body = flight.bodies[1]
        ghost.position_enu_m, ghost.velocity_enu_m_s = body.position_enu_m, body.velocity_enu_m_s

    def leave() -> None:
        ghost.position_enu_m, ghost.velocity_enu_m_s = (6.0, 0.0, 5.0), ZERO3

    flown(flight, haunt, 5.0)
    assert flight.reports[1].unshaken == ("2",)
    flown(flight, leave, 6.0)
    assert flight.reports[1].unshaken == ()


@pytest.mark.parametrize("seed", range(2))
def test_vehicles_that_pass_each_other_with_noise_are_all_shaken_off(seed: int) -> None:
    goals = [(4.0, 0.0, 2.0), (-4.0, 0.0, 2.0), (0.0, 4.0, 2.0), (0.0, -4.0, 2.0)]
    starts = [(-4.0, 0.0, 2.0), (4.0, 0.0, 2.0), (0.0, -4.0, 2.0), (0.0, 4.0, 2.0)]
    bodies = [Body(i, start, to_goal(goal)) for i, (start, goal) in enumerate(zip(starts, goals, strict=True), 1)]
    flight = SeparationFlight(bodies, 1.5, PX4_SIH, Link(0.05, 0.03, 0.1), seed)
    for _ in range(round(14.0 / TICK_S)):
        flight.tick()
        assert not any(report.unshaken for report in flight.reports.values())
