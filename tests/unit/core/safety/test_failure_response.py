"""What is sent after a stage of the tick has failed, without the rest of the agent."""

from __future__ import annotations

from math import nan

import pytest
from msgspec.structs import replace

from common import slot_peer, with_fields
from companion.core.safety.safeguard import FailureResponse, Response
from companion.types.autopilot import AckSample, AttitudeTarget, AutopilotMode, ModeSample, SetMode
from companion.types.flight import Flight, FlightPhase
from companion.types.formation import FormationChange, FormationState
from companion.types.values import ZERO3

P = FlightPhase
LAST = with_fields(slot_peer(3), phase=P.FORMATION, velocity_enu_m_s=(1.0, 2.0, 0.0))
HOVERS = AttitudeTarget(0.1, -0.2, 0.7, 0.6)
STREAMS = Flight(phase=P.FORMATION, streams=True, in_formation=True)


def failing(mode: AutopilotMode = AutopilotMode.OFFBOARD, flight: Flight = STREAMS) -> FailureResponse:
    response = FailureResponse()
    response.receive([ModeSample(10.0, mode, "")])
    response.sent(flight, HOVERS, 0.55)
    return response


def test_it_levels_at_once_with_the_heading_and_the_thrust_that_hovers() -> None:
    assert failing().step(10.0) == Response(
        AttitudeTarget(0.0, 0.0, 0.7, 0.55), (SetMode(AutopilotMode.HOLD),), ended=False
    )


@pytest.mark.parametrize(
    ("target", "hover_thrust_norm"),
    [(None, 0.55), (HOVERS, 0.0), (HOVERS, 1.0), (HOVERS, nan), (AttitudeTarget(0.0, 0.0, nan, 0.5), 0.55)],
)
def test_a_setpoint_that_cannot_be_levelled_leaves_the_last_one(
    target: AttitudeTarget | None, hover_thrust_norm: float
) -> None:
    response = failing()
    response.sent(STREAMS, target, hover_thrust_norm)
    assert response.step(10.0).target == AttitudeTarget(0.0, 0.0, 0.7, 0.55)


def test_a_new_stream_does_not_take_the_heading_of_the_last_one() -> None:
    response = failing()
    response.sent(Flight(phase=P.HOLD), None, 0.55)
    response.sent(STREAMS, None, 0.55)
    assert response.step(10.0) == Response(None, (SetMode(AutopilotMode.HOLD),), ended=False)


def test_hold_is_requested_ten_times_a_second_for_half_a_second() -> None:
    response, requested, ended = FailureResponse(), [], []
    response.sent(STREAMS, HOVERS, 0.55)
    for now_s in (0.0, 0.099, 0.1, 0.199, 0.21, 0.31, 0.5, 0.501):
        response.receive([ModeSample(now_s, AutopilotMode.OFFBOARD, "")])
        found = response.step(now_s)
        requested.append(len(found.requests))
        ended.append(found.ended)
    assert requested == [1, 0, 1, 0, 1, 1, 1, 0]
    assert ended == [False] * 7 + [True]


def test_after_a_tenth_of_a_second_without_telemetry_nothing_is_repeated() -> None:
    """The first response is sent at any age: the fault may be in what reads the telemetry."""
    for now_s, ended in ((10.1, False), (10.11, True)):
        response = failing()
        assert not response.step(10.05).ended
        assert response.step(now_s).ended is ended
    assert not failing().step(12.0).ended


@pytest.mark.parametrize("mode", sorted(set(AutopilotMode) - {AutopilotMode.OFFBOARD}))
def test_a_mode_that_the_agent_did_not_command_is_the_pilots(mode: AutopilotMode) -> None:
    assert failing(mode).step(10.0) == Response()


@pytest.mark.parametrize("mode", sorted(AutopilotMode))
def test_a_stream_that_the_autopilot_may_be_about_to_take_is_ended_by_hold(mode: AutopilotMode) -> None:
    found = failing(mode, Flight(phase=P.ENGAGE, streams=True)).step(10.0)
    asks = mode in (AutopilotMode.OFFBOARD, AutopilotMode.HOLD)
    assert (found.ended, len(found.requests)) == (not asks, int(asks))
    assert (found.target is not None) is (mode is AutopilotMode.OFFBOARD)


@pytest.mark.parametrize("phase", sorted(P))
def test_without_a_stream_only_a_hold_that_is_under_way_is_requested_again(phase: FlightPhase) -> None:
    response = failing(flight=Flight(phase=phase))
    assert response.step(10.0).ended is (phase is not P.RELEASE)


def test_telemetry_of_any_kind_is_telemetry() -> None:
    response = failing()
    response.step(10.0)
    response.receive([AckSample(10.2, (SetMode,), False, "")])
    assert not response.step(10.25).ended
    response.receive([ModeSample(10.3, AutopilotMode.OTHER, ""), AckSample(10.3, (SetMode,), False, "")])
    assert response.step(10.3).ended


def test_the_packet_after_a_failure_is_released_brakes_and_ages() -> None:
    response = failing()
    motion = replace(LAST.motion, acceleration_enu_m_s2=(1.0, 0.0, 0.0), state_age_s=0.01, sent_s=5.0)
    assert LAST.change is None and LAST.rft is None
    joins = FormationChange(1, ((0.0, 0.0, 0.0),), 0.0, 0.0)
    response.publishes(replace(LAST, motion=motion, change=joins, rft=FormationState(ZERO3, ZERO3, ZERO3)))
    first, second = response.packet(5.02), response.packet(5.01)
    assert first and second
    assert first.phase is second.phase is P.RELEASE
    assert [p.sender.sequence - LAST.sender.sequence for p in (first, second)] == [1, 2]
    assert [p.motion.state_age_s for p in (first, second)] == pytest.approx([0.03, 0.03])  # a clock that goes back
    assert [p.motion.sent_s for p in (first, second)] == [5.02, 5.01]
    assert first.motion.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)
    assert (first.change, first.rft, first.motion.velocity_enu_m_s) == (None, None, (1.0, 2.0, 0.0))
    response.publishes(None)
    assert response.packet(6.0) is None


def test_before_anything_was_heard_or_sent_there_is_nothing_to_end() -> None:
    assert FailureResponse().step(1.0) == Response(None, (), ended=True) == Response()
    response = FailureResponse()
    response.receive([ModeSample(1.0, AutopilotMode.OFFBOARD, "")])
    response.sent(STREAMS, None, 0.55)
    assert response.step(1.0).target is None


def test_telemetry_is_fresh_for_exactly_a_tenth_of_a_second() -> None:
    response = FailureResponse()
    response.receive([ModeSample(0.0, AutopilotMode.OFFBOARD, "")])
    response.sent(STREAMS, HOVERS, 0.55)
    assert [response.step(now_s).ended for now_s in (0.0, 0.1, 0.1001)] == [False, False, True]


def test_without_a_packet_published_before_a_failure_none_is_published_after_it() -> None:
    assert FailureResponse().packet(1.0) is None
