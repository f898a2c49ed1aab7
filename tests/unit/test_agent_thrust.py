"""What an agent makes of the thrust that its autopilot commands, and of the hover thrust that a parameter names."""

from itertools import pairwise
from math import degrees, hypot, nan

import pytest
from test_agent import Flight

from companion.types import CommandName, FlightPhase, Outbox, ParameterSample, ThrustSample


def hover_told(flight: Flight) -> float:
    """By the next status."""
    for _ in range(10):
        outbox = flight.tick()
        if outbox.status:
            return outbox.status.hover_thrust_norm
    raise AssertionError("no status")


def told(flight: Flight, thrust_norm: float) -> Outbox:
    return flight.tick(telemetry=[*flight.telemetry(), ThrustSample(flight.now_s + 0.02, thrust_norm)])


def engaging(thrust_norm: float | None) -> Flight:
    """In hold for two seconds, then told to form."""
    flight = Flight().fly_to(FlightPhase.HOLD)
    for _ in range(100):
        flight.tick() if thrust_norm is None else told(flight, thrust_norm)
    return flight


def test_the_hand_over_begins_with_the_thrust_that_the_autopilot_has() -> None:
    flight = engaging(0.37)
    flight.tick(CommandName.FORM, telemetry=[*flight.telemetry(), ThrustSample(flight.now_s + 0.02, 0.37)])
    assert flight.agent.phase is FlightPhase.ENGAGE
    assert flight.outbox.attitude_target is not None
    assert flight.outbox.attitude_target.thrust_norm == pytest.approx(0.37)


def test_where_that_is_not_told_it_begins_with_the_hover_thrust_of_the_file() -> None:
    flight = engaging(None)
    flight.tick(CommandName.FORM)
    assert flight.outbox.attitude_target is not None
    assert flight.outbox.attitude_target.thrust_norm == pytest.approx(0.5)


def test_hover_thrust_is_found_in_hold() -> None:
    assert hover_told(engaging(0.37)) == pytest.approx(0.37, rel=0.02)
    assert hover_told(engaging(None)) == 0.5


def test_standing_on_the_ground_tells_nothing_of_hover_thrust() -> None:
    flight = Flight().fly_to(FlightPhase.ARMED)
    for _ in range(200):
        told(flight, 0.08)
    assert hover_told(flight) == 0.5


def test_a_thrust_that_cannot_be_is_refused_and_counted() -> None:
    flight = Flight().fly_to(FlightPhase.HOLD)
    for thrust_norm in (nan, -0.1, 1.1):
        told(flight, thrust_norm)
    for _ in range(6):
        if flight.tick().status:
            break
    assert flight.outbox.status is not None
    assert flight.outbox.status.rejected["thrust not plausible"] == 3


@pytest.mark.parametrize(
    ("name", "value", "hover"),
    [
        ("MPC_THR_HOVER", 0.42, 0.42),
        ("MOT_THST_HOVER", 0.35, 0.5),  # not one of PX4
        ("MPC_THR_MAX", 0.42, 0.5),
        ("MPC_THR_HOVER", 0.0, 0.5),
        ("MPC_THR_HOVER", nan, 0.5),
    ],
)
def test_a_parameter_of_the_autopilot_says_where_to_begin(name: str, value: float, hover: float) -> None:
    flight = Flight()
    flight.tick(telemetry=[*flight.telemetry(), ParameterSample(flight.now_s, name, value)])
    assert hover_told(flight) == hover


def step_told_deg(flight: Flight) -> float:
    """By the next status."""
    for _ in range(10):
        if status := flight.tick().status:
            return status.largest_step_deg
    raise AssertionError("no status")


def test_the_largest_step_of_the_attitude_is_told_and_begins_anew_with_each_stream() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    before_deg = step_told_deg(flight)
    del flight.targets[:-1]
    flight.velocity = (0.3, 0.6, 0.0)
    for _ in range(20):
        flight.tick()
    steps = [hypot(b.roll_rad - a.roll_rad, b.pitch_rad - a.pitch_rad) for a, b in pairwise(flight.targets)]
    assert degrees(max(steps)) > before_deg
    assert step_told_deg(flight) == pytest.approx(degrees(max(steps)))
    flight.velocity = (0.0, 0.0, 0.0)
    flight.tick(CommandName.HOLD)
    for _ in range(100):
        flight.tick()
    flight.tick(CommandName.FORM)
    assert step_told_deg(flight) < degrees(max(steps))
