"""The separation filter makes way for vehicles outside the fleet, by samples published once a second."""

from __future__ import annotations

from math import hypot, inf

import pytest

from companion.core.filter.motion import Traffic
from companion.types.autopilot import VehicleState
from companion.types.peers import ReceivedTraffic, TrafficSample
from companion.types.status import NearestVehicle
from companion.types.values import ZERO3, Vector3
from stage_fleets import TICK_S, Body, Intruder, SeparationFlight, off_m, to_goal

SEPARATION_M = 2.0
HOME: Vector3 = (0.0, 0.0, 5.0)
WITHOUT_MARGINS_M = 2.15  # separation_m with what is kept before any vehicle that makes no way


def flight_with(intruder: Intruder, goal_enu_m: Vector3 = HOME) -> SeparationFlight:
    """One vehicle that flies from HOME to a goal."""
    return SeparationFlight([Body(1, HOME, to_goal(goal_enu_m))], SEPARATION_M, intruders=[intruder])


def nearest_of(flight: SeparationFlight) -> NearestVehicle:
    nearest = flight.reports[1].nearest
    assert nearest is not None
    return nearest


@pytest.mark.parametrize("goal_enu_m", [HOME, (8.0, 0.0, 5.0)], ids=["hovering", "flying towards it"])
@pytest.mark.parametrize("age_s", [0.0, 0.8])
@pytest.mark.parametrize("speed_m_s", [2.0, 8.0])
def test_traffic_that_flies_straight_at_a_vehicle_is_passed_at_the_separation(
    speed_m_s: float, age_s: float, goal_enu_m: Vector3
) -> None:
    flight = flight_with(
        Intruder("ABCDEF", (8.0 * speed_m_s, 0.0, 5.0), (-speed_m_s, 0.0, 0.0), age_s=age_s), goal_enu_m
    )
    flight.fly(16.0)
    assert flight.least_counted_m >= SEPARATION_M
    assert flight.intruders[0].position_enu_m[0] < -SEPARATION_M
    assert off_m(flight.bodies[1], goal_enu_m) < 0.1


def test_traffic_that_descends_onto_a_vehicle_is_avoided_to_the_side() -> None:
    flight = flight_with(Intruder("ABCDEF", (0.5, 0.0, 17.0), (0.0, 0.0, -1.5)))
    flight.fly(16.0)
    assert flight.least_counted_m >= SEPARATION_M
    assert flight.intruders[0].position_enu_m[2] < 0.0
    assert off_m(flight.bodies[1], HOME) < 0.5


def test_the_error_of_traffic_is_kept_in_addition() -> None:
    for error_m in (0.0, 1.5):
        flight = flight_with(Intruder("ABCDEF", (1.0, 0.0, 5.0), error_m=error_m))
        flight.fly(10.0)
        nearest = nearest_of(flight)
        assert nearest.name == "ABCDEF"
        assert nearest.required_m == pytest.approx(WITHOUT_MARGINS_M + error_m, abs=0.02)
        assert nearest.distance_m == pytest.approx(nearest.required_m, abs=0.05)
        assert off_m(flight.bodies[1], (1.0, 0.0, 5.0)) == pytest.approx(nearest.required_m, abs=0.05)


def test_an_error_of_traffic_is_not_bounded_by_the_separation() -> None:
    flight = flight_with(Intruder("ABCDEF", (3.0, 0.0, 5.0), error_m=6.0))
    flight.fly(20.0)
    assert off_m(flight.bodies[1], (3.0, 0.0, 5.0)) == pytest.approx(WITHOUT_MARGINS_M + 6.0, abs=0.1)


def test_traffic_counts_for_thirty_seconds_after_its_last_sample() -> None:
    flight = flight_with(Intruder("ABCDEF", (1.0, 0.0, 5.0)))
    flight.fly(0.02)
    flight.intruders[0].published = False
    flight.fly(29.9)
    assert off_m(flight.bodies[1], HOME) > 1.0
    flight.fly(0.2)
    assert flight.reports[1].nearest is None
    flight.fly(6.0)
    assert off_m(flight.bodies[1], HOME) < 0.05


def test_traffic_is_extrapolated_for_five_seconds_without_another_sample() -> None:
    """Until then nothing more is kept than from traffic that is heard."""
    intruder = Intruder("ABCDEF", (9.0, 0.5, 5.0), (-2.0, 0.0, 0.0))
    flight = flight_with(intruder)
    flight.fly(0.02)
    intruder.published = False
    flight.fly(4.96)
    assert nearest_of(flight).required_m < WITHOUT_MARGINS_M + 0.3
    assert flight.least_counted_m >= SEPARATION_M


def test_traffic_that_stops_in_silence_is_kept_off() -> None:
    """It is not where its last velocity would have taken it. The vehicle crosses its way 9 s later."""
    intruder = Intruder("ABCDEF", (5.0, 0.0, 5.0), (-1.0, 0.0, 0.0))

    def wait_and_cross(now_s: float, vehicle: VehicleState) -> Vector3:
        return to_goal((0.0, 8.0 if now_s > 112.0 else -8.0, 5.0))(now_s, vehicle)

    flight = SeparationFlight([Body(1, (0.0, -8.0, 5.0), wait_and_cross)], SEPARATION_M, intruders=[intruder])
    flight.fly(0.02)
    intruder.published = False
    flight.fly(5.3)
    intruder.velocity_enu_m_s = ZERO3
    flight.fly(16.0)
    assert flight.least_counted_m >= SEPARATION_M
    assert off_m(flight.bodies[1], (0.0, 8.0, 5.0)) < 0.5


@pytest.mark.parametrize("reported_m", [-40.0, 5.0, 196.0, 12_000.0])
def test_traffic_of_unknown_height_is_passed_to_the_side_at_any_height(reported_m: float) -> None:
    """An aircraft that seems 191 m higher, as its altitude is no altitude above sea level."""
    flight = flight_with(Intruder("ABCDEF", (32.0, 0.3, reported_m), (-4.0, 0.0, 1.0), height="unknown"))
    nearest_m = inf
    for _ in range(round(16.0 / TICK_S)):
        flight.fly(TICK_S)
        (x, y, _), (px, py, _) = flight.bodies[1].position_enu_m, flight.intruders[0].position_enu_m
        nearest_m = min(nearest_m, hypot(x - px, y - py))
    assert nearest_m >= SEPARATION_M
    assert flight.intruders[0].position_enu_m[0] < -SEPARATION_M
    assert off_m(flight.bodies[1], HOME) < 0.3


def test_traffic_of_a_known_height_is_not_avoided_where_it_is_far_above() -> None:
    flight = flight_with(Intruder("ABCDEF", (32.0, 0.3, 196.0), (-4.0, 0.0, 0.0)))
    flight.fly(16.0)
    assert off_m(flight.bodies[1], HOME) < 0.01


def test_traffic_of_unknown_height_that_is_silent_is_kept_off_to_the_side() -> None:
    flight = flight_with(Intruder("ABCDEF", (1.0, 0.0, 900.0), height="unknown"))
    flight.fly(0.02)
    flight.intruders[0].published = False
    flight.fly(20.0)
    x, y, z = flight.bodies[1].position_enu_m
    assert hypot(x - 1.0, y) >= SEPARATION_M
    assert z == pytest.approx(HOME[2], abs=0.1)


def test_of_many_the_nearest_count_and_unknown_heights_count_as_near() -> None:
    traffic = Traffic()
    known = [ReceivedTraffic(0.0, f"known-{i}", TrafficSample((0.0, 0.0, 100.0 + i), ZERO3)) for i in range(20)]
    unknown = ReceivedTraffic(0.0, "unknown", TrafficSample((5.0, 0.0, 9000.0), ZERO3, height="unknown"))
    traffic.step(0.0, HOME, [*known, unknown])
    assert "unknown" in traffic.newest
    assert len(traffic.newest) == 16
