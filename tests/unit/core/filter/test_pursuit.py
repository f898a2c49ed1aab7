"""A vehicle that drives another one before it, at the same speed and over a slow network."""

from math import radians, tan

import pytest

from companion.config.fleet import Envelope
from companion.core.safety.fleet_checks import brakes_from_m_s
from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.values import GRAVITY_M_S2, Vector3
from stage_fleets import Body, Link, SeparationFlight, to_goal

SEPARATION_M = 2.0


@pytest.mark.parametrize("speed_m_s", [1.0, 2.0])
def test_a_vehicle_keeps_its_distance_when_pushed_over_a_late_network(speed_m_s: float) -> None:
    """The distance no longer changes, but the pursuer is where its late packet will only report it to be."""

    def straight_on(_now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        return (2.0 * (speed_m_s - vx), -2.0 * vy, -2.0 * vz)

    pursuer = Body(1, (-6.0, 0.0, 2.0), straight_on, phase=FlightPhase.OBSERVE, filters=False)
    pushed = Body(2, (0.0, 0.0, 2.0), to_goal((0.0, 0.0, 2.0)))
    flight = SeparationFlight([pursuer, pushed], SEPARATION_M, link=Link(delay_s=0.1))
    flight.fly(12.0)
    assert flight.nearest_m >= SEPARATION_M


def test_the_required_distance_has_room_for_ripple_when_the_other_makes_no_way() -> None:
    """8 mm below separation_m were flown along a hovering vehicle."""
    hovering = Body(1, (0.0, 0.0, 2.0), to_goal((0.0, 0.0, 2.0)), phase=FlightPhase.HOLD, filters=False)
    near = Body(2, (3.0, 0.0, 2.0), to_goal((3.0, 0.0, 2.0)))
    flight = SeparationFlight([hovering, near], SEPARATION_M)
    flight.fly(0.2)
    nearest = flight.reports[2].nearest
    assert nearest is not None
    assert nearest.required_m >= SEPARATION_M + 0.05


@pytest.mark.parametrize(("tilt_deg", "margin_m"), [(3.0, 1.0), (5.0, 2.0), (10.0, 0.5), (25.0, 0.5)])
def test_a_vehicle_keeps_off_a_neighbour_no_faster_than_the_fleet_check_says(tilt_deg: float, margin_m: float) -> None:
    """One several times as fast it does not."""
    speed_m_s = brakes_from_m_s(0.3 * GRAVITY_M_S2 * tan(radians(tilt_deg)), margin_m)
    assert nearest_to_a_pilot_m(speed_m_s, tilt_deg, margin_m) >= 1.0
    assert nearest_to_a_pilot_m(4.0 * speed_m_s, tilt_deg, margin_m) < 0.9


def nearest_to_a_pilot_m(speed_m_s: float, tilt_deg: float, margin_m: float) -> float:
    """A pilot flies a neighbour out of its slot, `margin_m` farther away than separation_m of 1 m, towards this vehicle."""

    def flies(_now_s: float, vehicle: VehicleState) -> Vector3:
        vx, vy, vz = vehicle.velocity_enu_m_s
        return (min(5.0, max(-5.0, -5.0 * (vx + speed_m_s))), -2.0 * vy, -2.0 * vz)

    hovering = Body(2, (0.0, 0.0, 3.0), to_goal((0.0, 0.0, 3.0)))
    piloted = Body(1, (1.0 + margin_m, 0.0, 3.0), flies, phase=FlightPhase.OBSERVE, filters=False)
    flight = SeparationFlight([hovering, piloted], 1.0, envelope=Envelope(max_tilt_deg=tilt_deg))
    flight.fly(8.0)
    return flight.nearest_m
