"""Nothing that comes from above presses a vehicle into the ground: it goes aside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from stage_fleets import Body, Intruder, SeparationFlight, to_goal

if TYPE_CHECKING:
    from companion.types.autopilot import VehicleState
    from companion.types.values import Vector3

HEIGHT_M, FLOOR_M, TICK_S = 2.0, 0.5, 0.02
OVERSHOOT_M = 0.05


def least_height_m(flight: SeparationFlight) -> float:
    heights_m = []
    for _ in range(round(8.0 / TICK_S)):
        flight.tick()
        heights_m.append(flight.bodies[1].position_enu_m[2])
    return min(heights_m)


def hovering() -> Body:
    return Body(1, (0.0, 0.0, HEIGHT_M), to_goal((0.0, 0.0, HEIGHT_M)))


@pytest.mark.parametrize("speed_m_s", [0.5, 1.5, 3.0])
def test_a_vehicle_that_sinks_from_above_presses_none_into_the_ground(speed_m_s: float) -> None:
    def sinks(_now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        return (-2.0 * vx, -2.0 * vy, 3.0 * (-speed_m_s - vz))

    above = Body(2, (0.02, 0.0, 4.5), sinks, filters=False)
    assert least_height_m(SeparationFlight([hovering(), above], 1.0)) >= FLOOR_M - OVERSHOOT_M


@pytest.mark.parametrize("speed_m_s", [0.5, 3.0])
def test_traffic_that_sinks_from_above_presses_none_into_the_ground(speed_m_s: float) -> None:
    traffic = Intruder("A1", (0.02, 0.0, 4.5), (0.0, 0.0, -speed_m_s), period_s=0.2)
    assert least_height_m(SeparationFlight([hovering()], 1.0, intruders=[traffic])) >= FLOOR_M - OVERSHOOT_M


@pytest.mark.parametrize("above_m", [0.4, 0.8])
def test_a_false_position_that_stays_above_presses_none_into_the_ground(above_m: float) -> None:
    flown: list[SeparationFlight] = []

    def follows(_now_s: float, vehicle: VehicleState) -> Vector3:
        one = flown[0].bodies[1]
        (x, y, z), (vx, vy, vz) = one.position_enu_m, one.velocity_enu_m_s
        (px, py, pz), (wx, wy, wz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        east = 20.0 * (x + 0.02 - px) + 8.0 * (vx - wx)
        return (east, 20.0 * (y - py) + 8.0 * (vy - wy), 20.0 * (z + above_m - pz) + 8.0 * (vz - 0.5 - wz))

    ghost = Body(2, (0.02, 0.0, HEIGHT_M + 1.5), follows, filters=False)
    flown.append(SeparationFlight([hovering(), ghost], 1.0))
    assert least_height_m(flown[0]) >= FLOOR_M - OVERSHOOT_M
