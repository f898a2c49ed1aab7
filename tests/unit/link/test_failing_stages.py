"""A fault in every stage of the tick, for both autopilots: level attitude, the autopilot's hold, the reason, the end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from companion.core.safety.failure_response import HAND_OVER_WITHIN_S
from companion.mavlink.codec import mavlink
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from failing_flight import PERIOD_S, FailingFlight
from profile_flight import BOTH, HOLD, MANUAL

P = FlightPhase
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
LEVEL = 1e-6

# Owner and method of each stage, in the order of the tick.
STAGES: dict[str, Callable[[FailingFlight], tuple[Any, str]]] = {
    "peers and commands received": lambda flight: (flight.peers, "receive"),
    "perception": lambda flight: (flight.agent._perception, "step"),
    "phases, observed": lambda flight: (flight.agent._phases, "observe"),
    "arbitration": lambda flight: (flight.agent._arbitration, "step"),
    "consensus": lambda flight: (flight.agent._consensus, "step"),
    "guidance": lambda flight: (flight.agent._guidance, "step"),
    "safety": lambda flight: (flight.agent._safeguard, "step"),
    "dispatcher": lambda flight: (flight.agent._dispatcher, "step"),
    "phases": lambda flight: (flight.agent._phases, "step"),
    "setpoint": lambda flight: (flight.agent._setpoint, "step"),
    "setpoint encoded": lambda flight: (flight.translator, "attitude_target"),
    "request encoded": lambda flight: (flight.translator, "request"),
    "report": lambda flight: (flight.agent._report, "step"),
    "reply": lambda flight: (flight.peers, "reply"),
    "peer packet published": lambda flight: (flight.peers, "publish_peer"),
    "status published": lambda flight: (flight.peers, "publish_status"),
}


def set_modes(flight: FailingFlight) -> int:
    return sum(message.command == SET_MODE for message in flight.autopilot.commands)


def tilt(flight: FailingFlight) -> float:
    return max(abs(component) for component in flight.last_target.q[1:3])


@BOTH
@pytest.mark.parametrize("stage", STAGES)
def test_a_failing_stage_levels_the_vehicle_and_requests_hold(kind: AutopilotKind, stage: str) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.north_m_s = 2.0
    flight.ticks(0.4)
    assert tilt(flight) > 0.03  # it leans against its velocity, by 4 degrees
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(*STAGES[stage](flight))
    if stage == "request encoded":
        flight.tick(CommandName.HOLD)  # in a quiet tick nothing is requested
    flight.ticks(2.0)
    assert flight.failed_s is not None
    assert flight.ended_s is not None
    assert flight.ended_s - flight.failed_s <= HAND_OVER_WITHIN_S + 2 * PERIOD_S
    if stage == "setpoint encoded":
        assert len(flight.autopilot.targets) == sent  # the encoder is what failed
    else:
        assert tilt(flight) < LEVEL
        assert flight.last_target.thrust == pytest.approx(0.5, rel=0.2)  # the hover thrust estimated so far
    if stage == "request encoded":
        return  # the level setpoints are all that can be sent; the autopilot's failsafe follows
    assert set_modes(flight) == requested + 1
    assert flight.holds
    if stage != "status published":
        event = flight.peers.reports[-1].status.last_event
        assert event is not None
        assert event.code is Code.AGENT_FAILED


@BOTH
def test_level_setpoints_and_requests_are_repeated_until_the_autopilot_holds(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    requested = set_modes(flight)
    flight.inject(flight.agent._consensus, "step")
    flight.ticks(0.3)
    assert set_modes(flight) - requested in (3, 4)
    assert flight.ended_s is None
    del flight.autopilot.refuses[SET_MODE]
    flight.ticks(0.2)
    assert flight.holds
    assert flight.ended_s is not None


@BOTH
def test_an_autopilot_that_refuses_hold_gets_silence_after_the_last_level_setpoint(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    flight.inject(flight.agent._consensus, "step")
    flight.ticks(1.0)
    assert flight.failed_s is not None
    assert flight.ended_s is not None
    assert flight.ended_s - flight.failed_s == pytest.approx(HAND_OVER_WITHIN_S, abs=2 * PERIOD_S)
    assert tilt(flight) < LEVEL


@BOTH
@pytest.mark.parametrize("seen", ["before the fault", "in the tick of the fault", "after the fault"])
def test_a_pilot_who_has_taken_over_keeps_the_vehicle(kind: AutopilotKind, seen: str) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)  # the agent's hold is not what ends the mode
    pilots_mode = MANUAL[kind]
    if seen == "before the fault":
        flight.autopilot.custom_mode = pilots_mode
        flight.tick()
    flight.inject(flight.agent._guidance, "step")
    if seen == "in the tick of the fault":
        flight.autopilot.custom_mode = pilots_mode
    if seen == "after the fault":
        flight.tick()
        flight.autopilot.custom_mode = pilots_mode
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.ticks(1.0)
    assert (len(flight.autopilot.targets), set_modes(flight)) == (sent, requested)
    assert flight.autopilot.custom_mode == pilots_mode
    assert flight.ended_s is not None


@BOTH
@pytest.mark.parametrize("phase", [P.OBSERVE, P.READY, P.ARMED, P.HOLD])
def test_a_failure_outside_formation_sends_nothing(kind: AutopilotKind, phase: FlightPhase) -> None:
    """The autopilot flies itself or stands on the ground; ArduCopter is in GUIDED all the while."""
    flight = FailingFlight(kind).fly_to(phase)
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(flight.agent._guidance, "step")
    flight.ticks(1.0)
    assert flight.ended_s == flight.failed_s
    assert (len(flight.autopilot.targets), set_modes(flight)) == (sent, requested)


@BOTH
def test_a_failure_while_the_autopilot_takes_the_stream_requests_hold(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.HOLD)
    flight.autopilot.custom_mode = HOLD[kind]
    flight.tick()
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)  # OFFBOARD or GUIDED is still under way
    flight.ticks(0.1)
    flight.form()
    assert flight.agent.phase is P.ENGAGE
    flight.inject(flight.agent._guidance, "step")
    flight.tick()
    request = flight.autopilot.commands[-1]
    wanted = HOLD[kind]
    main, sub = int(request.param2), int(request.param3)
    assert (main << 16 | sub << 24 if kind is AutopilotKind.PX4 else main) == wanted


@BOTH
def test_blind_after_the_failure_nothing_is_repeated(kind: AutopilotKind) -> None:
    """Without telemetry a pilot's change of mode would remain unseen."""
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    flight.inject(flight.agent._guidance, "step")
    flight.tick()
    flight.inject(flight.link, "drain")  # the decoder fails as well
    sent = len(flight.autopilot.targets)
    flight.ticks(1.0)
    assert len(flight.autopilot.targets) - sent <= 6
    assert flight.ended_s is not None
