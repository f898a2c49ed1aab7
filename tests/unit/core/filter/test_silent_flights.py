"""Flights beside vehicles that fall silent: one that brakes at once or later, and one that lands."""

from __future__ import annotations

import pytest

from companion.core.consensus.law import feedback
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot
from companion.types.values import Vector3
from stage_fleets import DRAG_1_S, GAINS, Body, SeparationFlight, to_goal

SEPARATION_M = 1.0
BRAKING_M_S2 = (1.0, 2.5)  # 1.0 is as slow as an ArduCopter that levels at 4 m/s
HEIGHT_M = 5.0
APART_M = 3.0


@pytest.mark.parametrize("speed_m_s", [1.0, 2.0, 3.0, 4.0, 6.0])
@pytest.mark.parametrize("brakes_after_s", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("braking_m_s2", BRAKING_M_S2)
def test_a_silent_vehicle_ahead_brakes_at_once_or_after_its_attitude_was_kept(
    speed_m_s: float, brakes_after_s: float, braking_m_s2: float
) -> None:
    silent_s = 1e9

    def ahead(now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        forward = -1.5 * (vx - speed_m_s)
        if now_s >= silent_s + brakes_after_s:
            forward = -braking_m_s2 if vx > 0.05 else -1.5 * vx
        return (DRAG_1_S * vx + forward, -1.5 * vy, -1.5 * (vehicle.position_enu_m[2] - HEIGHT_M) - 1.5 * vz)

    def behind(now_s: float, vehicle: VehicleState) -> Vector3:
        (x, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        off = (x + APART_M - speed_m_s * (now_s - 100.0), y, z - HEIGHT_M)
        return feedback(GAINS, off, (vx - speed_m_s, vy, vz))

    bodies = [
        Body(1, (-APART_M, 0.0, HEIGHT_M), behind, (speed_m_s, 0.0, 0.0), slot=FlownSlot((-APART_M, 0.0, 0.0))),
        Body(2, (0.0, 0.0, HEIGHT_M), ahead, (speed_m_s, 0.0, 0.0), filters=False, slot=FlownSlot((0.0, 0.0, 0.0))),
    ]
    flight = SeparationFlight(bodies, SEPARATION_M)
    flight.fly(3.0)
    silent_s = flight.now_s
    flight.silent.add(2)
    flight.fly(20.0)
    assert flight.nearest_m >= SEPARATION_M


@pytest.mark.parametrize("aside_m", [0.0, 0.3])
@pytest.mark.parametrize(("above_m", "descent_m_s"), [(2.2, 0.7), (4.0, 0.7), (4.0, 1.5), (12.0, 1.5)])
def test_a_silent_vehicle_lands_past_one_below(aside_m: float, above_m: float, descent_m_s: float) -> None:
    """PX4's COM_OBL_RC_ACT 4. The vehicle below is pushed aside, not down."""
    lands_s = 1e9

    def above(now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        sinks_m_s = descent_m_s if now_s > lands_s and vehicle.position_enu_m[2] > 0.0 else 0.0
        return (-1.5 * vx, -1.5 * vy, -3.0 * (vz + sinks_m_s))

    below_enu_m, above_enu_m = (0.0, 0.0, HEIGHT_M), (aside_m, 0.0, HEIGHT_M + above_m)
    bodies = [
        Body(1, below_enu_m, to_goal(below_enu_m), slot=FlownSlot((0.0, 0.0, 0.0))),
        Body(2, above_enu_m, above, filters=False, slot=FlownSlot((aside_m, 0.0, above_m))),
    ]
    flight = SeparationFlight(bodies, SEPARATION_M)
    flight.fly(1.0)
    lands_s = flight.now_s + 0.6
    flight.silent.add(2)
    lowest_m = HEIGHT_M
    for _ in range(800):
        flight.tick()
        lowest_m = min(lowest_m, flight.bodies[1].position_enu_m[2])
    assert flight.nearest_m >= SEPARATION_M
    assert lowest_m >= HEIGHT_M - 0.2
