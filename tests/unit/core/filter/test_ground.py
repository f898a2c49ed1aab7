"""Nothing that comes from above presses a vehicle into the ground, nothing from below through the ceiling: it goes aside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from companion.config.fleet import Envelope
from companion.types.flight import FlightPhase
from stage_fleets import Body, Intruder, SeparationFlight, Wish, to_goal

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


def stays_with(flown: list[SeparationFlight], above_m: float, relative_m_s: float) -> Wish:
    """Above vehicle 1 of the flight, wherever it goes; with this upward speed in relation to it."""

    def follows(_now_s: float, vehicle: VehicleState) -> Vector3:
        one = flown[0].bodies[1]
        (x, y, z), (vx, vy, vz) = one.position_enu_m, one.velocity_enu_m_s
        (px, py, pz), (wx, wy, wz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        east = 20.0 * (x + 0.02 - px) + 8.0 * (vx - wx)
        return (east, 20.0 * (y - py) + 8.0 * (vy - wy), 20.0 * (z + above_m - pz) + 8.0 * (vz + relative_m_s - wz))

    return follows


@pytest.mark.parametrize("above_m", [0.4, 0.8])
def test_a_false_position_that_stays_above_presses_none_into_the_ground(above_m: float) -> None:
    flown: list[SeparationFlight] = []
    ghost = Body(2, (0.02, 0.0, HEIGHT_M + 1.5), stays_with(flown, above_m, -0.5), filters=False)
    flown.append(SeparationFlight([hovering(), ghost], 1.0))
    assert least_height_m(flown[0]) >= FLOOR_M - OVERSHOOT_M


CEILING_M = 2.6  # less the clearance 0.1 m above the vehicle
UNDER_IT = Envelope(fence_max_enu_m=(50.0, 50.0, CEILING_M))


def above_ceiling(flight: SeparationFlight) -> tuple[float, float]:
    """By how much the vehicle is above the ceiling at most, and for how long in all."""
    above_m = []
    for _ in range(round(8.0 / TICK_S)):
        flight.tick()
        above_m.append(flight.bodies[1].position_enu_m[2] - CEILING_M)
    return max(above_m), TICK_S * sum(one > 0.0 for one in above_m)


@pytest.mark.parametrize("phase", [FlightPhase.FORMATION, FlightPhase.OBSERVE])
@pytest.mark.parametrize("speed_m_s", [0.5, 1.5, 3.0])
def test_a_vehicle_that_climbs_from_below_presses_none_through_the_ceiling(
    speed_m_s: float, phase: FlightPhase
) -> None:
    def climbs(_now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        return (-2.0 * vx, -2.0 * vy, 3.0 * (speed_m_s - vz))

    below = Body(2, (0.02, 0.0, -1.5), climbs, phase=phase, filters=False)
    flight = SeparationFlight([hovering(), below], 1.0, envelope=UNDER_IT)
    assert above_ceiling(flight)[0] < 0.0
    assert flight.nearest_m > 1.0


@pytest.mark.parametrize("speed_m_s", [0.5, 3.0])
def test_traffic_that_climbs_from_below_presses_none_through_the_ceiling(speed_m_s: float) -> None:
    traffic = Intruder("A1", (0.02, 0.0, -1.5), (0.0, 0.0, speed_m_s), period_s=0.2)
    flight = SeparationFlight([hovering()], 1.0, intruders=[traffic], envelope=UNDER_IT)
    assert above_ceiling(flight)[0] < 0.0


@pytest.mark.parametrize("below_m", [0.2, 0.4, 0.8])
def test_a_false_position_that_stays_below_presses_none_through_the_ceiling(below_m: float) -> None:
    flown: list[SeparationFlight] = []
    ghost = Body(2, (0.02, 0.0, HEIGHT_M - 1.5), stays_with(flown, -below_m, 0.5), filters=False)
    flown.append(SeparationFlight([hovering(), ghost], 1.0, envelope=UNDER_IT))
    above_m, lasts_s = above_ceiling(flown[0])
    assert above_m < 0.2
    assert lasts_s < 1.0
