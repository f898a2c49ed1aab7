"""Other vehicles nearby, through a whole agent: what it flies, and what its status and its events say."""

from __future__ import annotations

import pytest
from msgspec import Struct

from common import codes_of
from companion.types.autopilot import AttitudeTarget
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.notices import Code, Notice
from companion.types.peers import TrafficSample
from companion.types.status import NearestVehicle, Status
from companion.types.values import ZERO3, Vector3
from one_agent import AgentFlight

FROM_THE_NORTH = TrafficSample((-1.5, 1.6, 1.0), (0.0, -1.0, 0.0))  # straight at the vehicle, which is at (-1.5, 0, 1)


class Seen(Struct):
    """What the ground has seen of some ticks: the last status and all events; and the last setpoint and its acceleration."""

    status: Status
    events: list[Notice]
    target: AttitudeTarget
    acceleration_enu_m_s2: Vector3


def after(flight: AgentFlight, seconds: float) -> Seen:
    events: list[Notice] = []
    status = None
    for _ in range(round(seconds / 0.02)):
        outbox = flight.tick()
        events += outbox.events
        status = outbox.status or status
    assert status is not None and outbox.attitude_target is not None and outbox.peer_packet is not None
    return Seen(status, events, outbox.attitude_target, outbox.peer_packet.motion.acceleration_enu_m_s2)


def nearest_of(status: Status) -> NearestVehicle:
    nearest = status.safety.separation.nearest
    assert nearest is not None
    return nearest


def test_traffic_changes_attitude_and_acceleration_and_the_status_shows_it() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    alone = after(flight, 2.0)
    assert alone.status.safety.separation.changed_m_s2 == 0.0
    flight.traffic["ABCDEF"] = FROM_THE_NORTH
    beside = after(flight, 1.0)
    assert beside.acceleration_enu_m_s2[1] < alone.acceleration_enu_m_s2[1] - 0.3
    assert abs(beside.target.roll_rad - alone.target.roll_rad) > 0.03
    separation, nearest = beside.status.safety.separation, nearest_of(beside.status)
    assert separation.changed_m_s2 == pytest.approx(-beside.acceleration_enu_m_s2[1], abs=0.05)
    assert nearest.name == "ABCDEF"
    assert nearest.distance_m == pytest.approx(1.6)
    assert codes_of(beside.events) == [Code.SEPARATION_INTERVENES]
    assert "nearest vehicle: ABCDEF at 1.60 m" in beside.events[0].text


def test_traffic_received_before_formation_counts_in_formation() -> None:
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    flight.traffic["ABCDEF"] = TrafficSample((-1.5, 5.0, 1.0), ZERO3)
    flight.tick()
    flight.traffic.clear()
    flight.tick(CommandName.FORM)
    after(flight, 1.0)
    assert flight.agent.phase is FlightPhase.FORMATION
    flight.peer_position = (5.0, 5.0, 1.0)  # out of the way
    assert nearest_of(after(flight, 0.2).status).name == "ABCDEF"


VIOLATED = HealthFlag.SEPARATION_VIOLATED
TOO_NEAR: Vector3 = (-0.7, 0.0, 1.0)  # 0.8 m before the vehicle
APART: Vector3 = (0.0, 0.0, 1.0)  # as their slots are


def test_a_peer_nearer_than_separation_is_flagged_and_shown_while_it_is_there() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    assert VIOLATED not in after(flight, 1.0).status.safety.flags
    flight.peer_position = TOO_NEAR
    near = after(flight, 1.0)
    nearest, separation = nearest_of(near.status), near.status.safety.separation
    assert VIOLATED in near.status.safety.flags
    assert separation.violated
    assert nearest.name == "1"
    assert nearest.distance_m == pytest.approx(0.8)
    assert nearest.required_m >= flight.fleet.separation_m
    assert separation.changed_m_s2 > 1.0
    assert near.acceleration_enu_m_s2[0] < -0.5
    assert flight.agent.phase is FlightPhase.FORMATION
    flight.peer_position = APART
    apart = after(flight, 1.0).status
    assert VIOLATED not in apart.safety.flags
    assert not apart.safety.separation.violated
    assert nearest_of(apart).distance_m == pytest.approx(1.5)


def test_a_peer_that_stays_too_near_is_reported_once() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    after(flight, 1.0)
    flight.peer_position = TOO_NEAR
    near = after(flight, 20.0)
    assert codes_of(near.events) == [Code.SEPARATION_INTERVENES, Code.SEPARATION_VIOLATED, Code.NOT_SHAKEN_OFF]
    assert "nearest vehicle: 1 at 0.80 m, required" in near.events[0].text
    assert near.events[2].text == "no evasion shakes off another vehicle: 1"


def test_why_a_phase_ends_stays_in_the_status_although_the_filter_intervenes_in_the_same_tick() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    after(flight, 1.0)
    flight.peer_position = TOO_NEAR
    ends = flight.tick(CommandName.HOLD)
    assert codes_of(ends.events) == [Code.SEPARATION_INTERVENES, Code.PHASE_CHANGED]
    assert ends.status is not None and ends.status.last_event == ends.events[-1]


def test_a_peer_that_comes_too_near_again_is_reported_again() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    after(flight, 1.0)
    for _ in range(2):
        flight.peer_position = TOO_NEAR
        assert codes_of(after(flight, 3.0).events).count(Code.SEPARATION_INTERVENES) == 1
        flight.peer_position = APART
        assert codes_of(after(flight, 3.0).events) == []


def test_a_peer_too_near_is_flagged_also_while_another_vehicle_lacks_more_of_its_required_distance() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = TOO_NEAR
    flight.traffic["ABCDEF"] = TrafficSample((-1.5, 3.0, 1.0), ZERO3, error_m=5.0)
    near = after(flight, 1.0)
    assert nearest_of(near.status).name == "ABCDEF"
    assert near.status.safety.separation.violated
    assert VIOLATED in near.status.safety.flags


def test_a_vehicle_too_near_is_pushed_away_while_the_agent_hands_over() -> None:
    """In the level setpoints at first, and in the braking of an autopilot that does not take over."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    after(flight, 1.0)
    flight.executes_requests = False
    flight.tick(CommandName.HOLD)
    flight.peer_position = TOO_NEAR
    for seconds in (0.2, 1.5):
        near = after(flight, seconds)
        assert flight.agent.phase is FlightPhase.RELEASE
        assert near.acceleration_enu_m_s2[0] < -1.0
        assert near.target.pitch_rad < -0.1
        assert nearest_of(near.status).name == "1"
        assert nearest_of(near.status).required_m == pytest.approx(1.15, abs=0.01)  # it makes way alone
        assert VIOLATED in near.status.safety.flags
