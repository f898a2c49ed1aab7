"""Use of the autopilot's own thrust, and of its hover thrust parameter."""

from itertools import pairwise
from math import degrees, hypot, nan

import pytest

from companion.types.autopilot import ParameterSample, ThrustSample
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.tick import Outbox
from one_agent import AgentFlight


def reported_hover(flight: AgentFlight) -> float:
    """In the next status."""
    for _ in range(10):
        outbox = flight.tick()
        if outbox.status:
            return outbox.status.control.hover_thrust_norm
    raise AssertionError("no status")


def tick_with_thrust(flight: AgentFlight, thrust_norm: float) -> Outbox:
    return flight.tick(telemetry=[*flight.telemetry(), ThrustSample(flight.now_s + 0.02, thrust_norm)])


def engaging(thrust_norm: float | None) -> AgentFlight:
    """A flight after two seconds in hold, with this thrust reported."""
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    for _ in range(100):
        flight.tick() if thrust_norm is None else tick_with_thrust(flight, thrust_norm)
    return flight


def test_the_hand_over_begins_with_the_thrust_that_the_autopilot_has() -> None:
    flight = engaging(0.37)
    flight.tick(CommandName.FORM, telemetry=[*flight.telemetry(), ThrustSample(flight.now_s + 0.02, 0.37)])
    assert flight.agent.phase is FlightPhase.ENGAGE
    assert flight.outbox.attitude_target is not None
    assert flight.outbox.attitude_target.thrust_norm == pytest.approx(0.37)


def test_the_hand_over_begins_with_the_configured_hover_thrust_without_a_report() -> None:
    flight = engaging(None)
    flight.tick(CommandName.FORM)
    assert flight.outbox.attitude_target is not None
    assert flight.outbox.attitude_target.thrust_norm == pytest.approx(0.5)


def test_hover_thrust_is_estimated_in_hold() -> None:
    assert reported_hover(engaging(0.37)) == pytest.approx(0.37, rel=0.02)
    assert reported_hover(engaging(None)) == 0.5


def test_no_hover_thrust_is_estimated_on_the_ground() -> None:
    flight = AgentFlight().fly_to(FlightPhase.ARMED)
    for _ in range(200):
        tick_with_thrust(flight, 0.08)
    assert reported_hover(flight) == 0.5


def test_an_impossible_thrust_is_refused_and_counted() -> None:
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    for thrust_norm in (nan, -0.1, 1.1):
        tick_with_thrust(flight, thrust_norm)
    for _ in range(6):
        if flight.tick().status:
            break
    assert flight.outbox.status is not None
    assert flight.outbox.status.rejected[Code.THRUST_IMPLAUSIBLE] == 3


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
def test_the_estimate_begins_with_the_autopilot_s_parameter(name: str, value: float, hover: float) -> None:
    flight = AgentFlight()
    flight.tick(telemetry=[*flight.telemetry(), ParameterSample(flight.now_s, name, value)])
    assert reported_hover(flight) == hover


def reported_step_deg(flight: AgentFlight) -> float:
    """In the next status."""
    for _ in range(10):
        if status := flight.tick().status:
            return status.control.largest_step_deg
    raise AssertionError("no status")


def test_the_largest_attitude_step_is_reported_for_each_stream() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    before_deg = reported_step_deg(flight)
    del flight.targets[:-1]
    flight.velocity = (0.3, 0.6, 0.0)
    for _ in range(20):
        flight.tick()
    steps = [hypot(b.roll_rad - a.roll_rad, b.pitch_rad - a.pitch_rad) for a, b in pairwise(flight.targets)]
    assert degrees(max(steps)) > before_deg
    assert reported_step_deg(flight) == pytest.approx(degrees(max(steps)))
    flight.velocity = (0.0, 0.0, 0.0)
    flight.tick(CommandName.HOLD)
    for _ in range(100):
        flight.tick()
    flight.tick(CommandName.FORM)
    assert reported_step_deg(flight) < degrees(max(steps))
