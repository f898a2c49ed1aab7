"""Agent.step from telemetry to setpoint: when setpoints are sent, when not, and what peers receive."""

from itertools import pairwise
from math import dist, inf, nan

import pytest
from msgspec.structs import replace

from common import codes_of, outcome, with_fields
from companion.assembly import trajectory_of
from companion.config.fleet import FleetConfig, FormationMember
from companion.config.law import LawSection
from companion.config.reference import Figure8Reference, PointReference
from companion.core.command.hand_over import BRAKES_WITHIN_S, LEVEL_BEFORE_HAND_OVER_S, TAKES_OVER_WITHIN_S
from companion.core.control.setpoint import STOPS_IN_S, level_acceleration
from companion.types.autopilot import (
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    HeartbeatSample,
    LandedSample,
    LandedState,
    ModeSample,
    PositionSample,
    RequestOrigin,
    RequestParameter,
    SetMode,
)
from companion.types.commands import CommandName, Lead, ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference, LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.peers import ReceivedPeerPacket
from companion.types.tick import Inbox, Outbox
from companion.types.values import Vector3
from one_agent import FLEET, POINT, AgentFlight


def test_no_setpoint_is_sent_on_the_ground() -> None:
    flight = AgentFlight()
    asked = [request for _ in range(1000) for request in flight.tick().requests]
    asked = [request for request in asked if not isinstance(request, RequestParameter)]
    assert asked == [RequestOrigin()] * 4  # in 20 s: a change of origin may have been lost
    assert flight.targets == []


def test_a_geodetic_fleet_asks_for_the_origin_once_a_second() -> None:
    from companion.config.fleet import GeodeticOrigin

    origin = GeodeticOrigin(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=400.0)
    flight = AgentFlight(
        fleet=FleetConfig(name="pair", origin=origin, vehicles=FLEET.vehicles, neighbours=FLEET.neighbours)
    )
    flight.sends_origin = False
    asked = [request for _ in range(150) for request in flight.tick().requests]
    asked = [request for request in asked if not isinstance(request, RequestParameter)]
    assert asked == [RequestOrigin()] * 3
    reply = flight.tick(CommandName.PREPARE).replies[0]
    assert not reply.accepted
    assert reply.code is Code.FRAME_UNKNOWN


def test_every_tick_in_formation_sends_one_setpoint() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    for _ in range(50):
        flight.tick()
    assert len(flight.targets) - before == 50


def test_the_follower_follows_eq_14() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)  # the leader is 0.5 m ahead of the position that fits this vehicle's slot
    for _ in range(20):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.motion.acceleration_enu_m_s2 == pytest.approx((1.39 * 0.5, 0.0, 0.0))
    target = flight.targets[-1]
    assert target.yaw_rad == pytest.approx(0.3)  # the heading it had when the stream began
    assert target.pitch_rad > 0.0


def test_the_leader_tracks_its_reference() -> None:
    flight = AgentFlight(vehicle_id=1)
    flight.position, flight.peer_position = (0.0, 0.0, 0.0), (-1.5, 0.0, 1.0)
    flight.fly_to(FlightPhase.FORMATION)
    for _ in range(20):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.motion.acceleration_enu_m_s2 == pytest.approx((1.39 * 1.0, 0.0, 0.0))
    beacon = flight.outbox.peer_packet.leader.beacon
    assert beacon is not None
    assert (beacon.leader_id, beacon.epoch, beacon.stamp) == (1, 0, int(flight.now_s * 1000))
    assert beacon.reference_s == pytest.approx(0.02 * flight.formation_ticks, abs=0.03)


def test_the_hand_over_begins_level_and_steps_little() -> None:
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    flight.peer_position, flight.peer_phase = (5.0, 0.0, 1.0), FlightPhase.HOLD  # a peer that forms with it
    for _ in range(20):
        flight.tick()
    flight.tick(CommandName.FORM)
    for _ in range(60):
        flight.tick()
    assert flight.agent.phase is FlightPhase.FORMATION
    first = flight.targets[0]
    assert (first.roll_rad, first.pitch_rad, first.thrust_norm) == (0.0, 0.0, 0.5)
    steps = [abs(b.pitch_rad - a.pitch_rad) for a, b in zip(flight.targets, flight.targets[1:], strict=False)]
    assert 0.0 < max(steps) <= 400.0 * 0.02 * 3.1416 / 180.0 + 1e-9


ENDS_AFTER_TICKS = 3  # ENDS_AFTER_S of 20 ms each, and the tick in which it is over


@pytest.mark.parametrize("ticks", [1, 5, 20])
def test_no_setpoint_is_sent_without_a_fresh_state(ticks: int) -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    for _ in range(ticks):
        flight.tick(telemetry=[])
    # The autopilot goes on with the last setpoint for a while: it ends no evasion, but level.
    assert len(flight.targets) - before == (ticks >= ENDS_AFTER_TICKS)
    assert flight.targets[-1].roll_rad == flight.targets[-1].pitch_rad == 0.0
    assert flight.agent.phase is FlightPhase.FORMATION
    before = len(flight.targets)
    flight.tick()
    assert len(flight.targets) == before + 1


@pytest.mark.parametrize(("age_s", "setpoints"), [(0.0, 1), (0.039, 1), (0.041, 0)])
def test_no_setpoint_is_sent_from_a_position_older_than_40_ms(age_s: float, setpoints: int) -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    for _ in range(ENDS_AFTER_TICKS):
        flight.tick(telemetry=[])
    before, came_s = len(flight.targets), flight.now_s + 0.02 - age_s
    flight.tick(telemetry=[PositionSample(came_s, came_s - 100.0 + flight.boot_s, flight.position, flight.velocity)])
    assert len(flight.targets) - before == setpoints


def test_the_stream_stays_ended_after_a_long_silence() -> None:
    """PX4 re-enters OFFBOARD when a stream returns: an agent that was silent must wait for a command."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    for _ in range(30):
        flight.tick(telemetry=[])
    assert flight.agent.phase is FlightPhase.OBSERVE
    before = len(flight.targets)
    for _ in range(50):
        flight.tick()
    assert len(flight.targets) == before
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_an_arducopter_that_still_waits_for_setpoints_after_a_long_silence_is_asked_to_hold() -> None:
    """Its own failsafe does not act: it drifts. No pilot has taken over."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.kind = AutopilotKind.ARDUPILOT
    flight.tick()
    for _ in range(30):
        flight.tick(telemetry=[])
    before = len(flight.targets)
    assert flight.agent.phase is FlightPhase.OBSERVE
    for _ in range(40):
        flight.tick()
    assert len(flight.targets) == before
    assert flight.agent.phase is FlightPhase.HOLD
    assert flight.mode is AutopilotMode.HOLD


def test_a_pilot_who_took_over_in_a_long_silence_keeps_the_vehicle() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.kind = AutopilotKind.ARDUPILOT
    flight.tick()
    for _ in range(30):
        flight.tick(telemetry=[])
    flight.mode = AutopilotMode.OTHER
    for _ in range(50):
        flight.tick()
    assert flight.agent.phase is FlightPhase.OBSERVE
    assert flight.mode is AutopilotMode.OTHER


def test_the_last_setpoint_before_a_silence_brakes() -> None:
    """An autopilot goes on with it for a while: an evasion would go on, too."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.velocity = (1.2, 0.0, 0.0)
    flight.tick()
    for _ in range(ENDS_AFTER_TICKS):
        flight.tick(telemetry=[])
    last = flight.targets[-1]
    east_m_s2, north_m_s2 = level_acceleration(last.roll_rad, last.pitch_rad, last.yaw_rad)
    assert -1.2 / STOPS_IN_S <= east_m_s2 <= -0.6  # less than for 1.2 m/s: what the law brakes shows after the lag
    assert north_m_s2 == pytest.approx(0.0, abs=0.05)


def test_no_setpoint_is_sent_when_upside_down() -> None:
    """Remark 1: beyond 90 degrees no thrust carries the vehicle; no setpoint is sent, and the autopilot holds."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    flight.roll_rad = 2.0
    for _ in range(50):
        flight.tick()
    assert len(flight.targets) == before
    assert flight.agent.phase is FlightPhase.HOLD
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert status.rejected == {Code.SETPOINT_IMPOSSIBLE: 25}  # half a second


@pytest.mark.parametrize("bad", [nan, inf, 1e12])
def test_no_setpoint_is_sent_from_invalid_telemetry(bad: float) -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    flight.position = (bad, 0.0, 1.0)
    for _ in range(10):
        flight.tick()
    assert len(flight.targets) == before + 1  # the last, level one
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.motion.position_enu_m == (-1.5, 0.0, 1.0)


def test_a_lost_leader_ends_in_the_autopilots_hold() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = None
    for _ in range(60):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD
    assert flight.mode is AutopilotMode.HOLD
    assert Code.LEADER_LOST in codes_of(flight.events)
    reply = flight.tick(CommandName.FORM).replies[0]
    assert not reply.accepted
    assert reply.code is Code.LEADER_LOST


def test_a_leader_is_lost_when_its_packets_are_five_seconds_late() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_late_s = 5.0
    statuses = [status for _ in range(60) if (status := flight.tick().status)]
    assert flight.agent.phase is FlightPhase.HOLD
    assert Code.LEADER_LOST in codes_of(flight.events)
    assert set(statuses[-1].rejected) == {f"{Code.PEER_LATE} 1"}


def test_leaving_the_fence_ends_in_the_autopilots_hold() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.position = (-101.0, 0.0, 1.0)
    for _ in range(30):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD


def test_the_pilots_mode_stops_the_stream_at_once() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.mode = AutopilotMode.OTHER
    assert flight.tick().attitude_target is None
    assert flight.agent.phase is FlightPhase.OBSERVE
    assert flight.tick().requests == ()


def test_own_altitude_hold_leaves_the_horizontal_law_alone() -> None:
    fleet = FleetConfig(
        name="pair",
        origin="indoor",
        vehicles=FLEET.vehicles,
        neighbours=FLEET.neighbours,
        law=LawSection(name="weighted", altitude="hold"),
        takeoff_height_m=1.0,
    )
    flight = AgentFlight(fleet=fleet).fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 7.0)  # a neighbour's altitude is not used
    flight.position = (-1.5, 0.0, 0.9)  # 0.1 m below where it was when the formation began
    for _ in range(20):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.motion.acceleration_enu_m_s2 == pytest.approx((1.39 * 0.5, 0.0, 0.2))


def test_a_peer_with_another_fleet_file_is_not_used() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.fleet = FleetConfig(name="other", origin="indoor", vehicles=FLEET.vehicles, neighbours=FLEET.neighbours)
    for _ in range(40):
        flight.tick()
    assert flight.agent.phase in (FlightPhase.HOLD, FlightPhase.RELEASE)
    status = next(flight.outbox.status for _ in range(10) if flight.tick().status)
    assert status is not None
    assert any(key.startswith(Code.PEER_OTHER_FLEET_FILE) for key in status.rejected)


def test_the_same_inputs_give_the_same_outputs_to_the_bit() -> None:
    def outputs() -> list[AttitudeTarget]:
        flight = AgentFlight().fly_to(FlightPhase.FORMATION)
        for tick in range(200):
            flight.peer_position = (0.001 * tick, 0.01, 1.0)
            flight.tick()
        return flight.targets

    assert outputs() == outputs()


def test_commands_are_answered_with_their_number() -> None:
    flight = AgentFlight()
    flight.tick()
    outbox = flight.tick(CommandName.PREPARE, CommandName.LAND)
    assert [(reply.number, reply.accepted) for reply in outbox.replies] == [(1, True), (2, False)]
    assert all(reply.vehicle_id == 2 for reply in outbox.replies)


def test_a_status_comes_ten_times_a_second() -> None:
    flight = AgentFlight()
    statuses = [status for _ in range(100) if (status := flight.tick().status)]
    assert len(statuses) == 20
    assert with_fields(statuses[-1], state_age_s=0.0).phase is FlightPhase.OBSERVE


# ---------------------------------------------------------------- pilot take-over, stale telemetry


def test_a_failsafe_in_the_tick_of_the_pilots_take_over_does_not_override_the_pilot() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.mode, flight.position = AutopilotMode.OTHER, (-101.0, 0.0, 1.0)
    for _ in range(200):
        outbox = flight.tick()
        assert outbox.attitude_target is None
        assert [r for r in outbox.requests if isinstance(r, SetMode)] == []
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_a_command_in_the_tick_of_the_pilots_take_over_is_refused() -> None:
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    flight.mode = AutopilotMode.OTHER
    reply = flight.tick(CommandName.FORM).replies[0]
    assert not reply.accepted
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_a_stopping_agent_hands_over_unless_a_pilot_flies() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.stopping = True
    assert not flight.agent.has_handed_over
    for _ in range(30):
        flight.tick()
    assert flight.mode is AutopilotMode.HOLD
    assert flight.agent.has_handed_over
    flown = AgentFlight().fly_to(FlightPhase.FORMATION)
    flown.stopping, flown.mode = True, AutopilotMode.OTHER
    for _ in range(30):
        assert [r for r in flown.tick().requests if isinstance(r, SetMode)] == []


@pytest.mark.parametrize("kind", [ModeSample, AttitudeSample])
def test_the_stream_stops_without_mode_or_attitude(kind: type) -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.withheld = (kind,)
    for _ in range(65):  # MODE_STALE after 1.2 s
        flight.tick()
    assert flight.outbox.attitude_target is None


@pytest.mark.parametrize("kind", [HeartbeatSample, LandedSample])
def test_a_hand_over_follows_without_armed_or_landed_state(kind: type) -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.withheld = (kind,)
    for _ in range(200):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD
    assert not flight.tick(CommandName.FORM).replies[0].accepted


def test_no_formation_from_outside_the_fence() -> None:
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    flight.position = (-101.0, 0.0, 1.0)
    reply = flight.tick(CommandName.FORM).replies[0]
    assert not reply.accepted
    assert reply.code is Code.OUTSIDE_FENCE


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.TAKEOFF, FlightPhase.LAND, FlightPhase.RETURN])
def test_a_peer_that_lands_or_is_flown_by_its_pilot_is_no_neighbour(phase: FlightPhase) -> None:
    flight = AgentFlight().fly_to(FlightPhase.HOLD)
    flight.peer_phase = phase
    statuses = [status for _ in range(20) if (status := flight.tick().status)]
    assert statuses[-1].neighbourhood.neighbours == ()


def test_the_status_has_the_weights_and_the_ages_of_the_neighbours() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    status = [status for _ in range(20) if (status := flight.tick().status)][-1]
    assert len(status.neighbourhood.neighbours) == 1
    assert status.neighbourhood.weights == (1.0,)
    assert 0.0 <= status.neighbourhood.neighbour_ages_s[0] <= FLEET.peers.max_age_s
    flight.peer_phase = FlightPhase.LAND
    alone = [status for _ in range(20) if (status := flight.tick().status)][-1]
    assert (alone.neighbourhood.weights, alone.neighbourhood.neighbour_ages_s) == ((), ())


def test_a_landing_is_requested_again_when_the_state_is_stale() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.tick(CommandName.LAND)
    flight.mode = AutopilotMode.OFFBOARD  # the one request was lost
    for _ in range(40):
        flight.tick(telemetry=[])
    assert flight.agent.phase is FlightPhase.LAND
    for _ in range(30):
        assert flight.tick().attitude_target is None
    assert flight.mode is AutopilotMode.LAND


def test_a_hand_over_brakes_then_levels_and_brakes_again_when_the_autopilot_does_not_take_over() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.tick()
    flight.peer_position = (-120.0, 0.0, 1.0)  # a neighbour that would pull it farther out
    flight.position, flight.velocity = (-101.0, 0.0, 0.9), (3.0, 0.0, -0.2)
    flight.executes_requests, began_s = False, flight.now_s
    up_m_s2 = pytest.approx(2.0 * 0.1 + 2.4 * 0.2, abs=0.01)
    brakes = [
        reported_acceleration(flight.tick()) for _ in range(round(BRAKES_WITHIN_S / 0.02))
    ]  # nothing slows it down
    assert all(-1.4 < ux < -1.0 and uz == up_m_s2 for ux, _, uz in brakes)
    while reported_acceleration(flight.tick()) != (0.0, 0.0, up_m_s2):
        assert flight.now_s < began_s + BRAKES_WITHIN_S + 0.5
    for _ in range(round((LEVEL_BEFORE_HAND_OVER_S + TAKES_OVER_WITHIN_S) / 0.02) - 1):
        assert reported_acceleration(flight.tick()) == (0.0, 0.0, up_m_s2)
    assert flight.agent.phase is FlightPhase.RELEASE
    flight.tick()
    ux, _, uz = reported_acceleration(flight.tick())
    assert ux < -1.0
    assert uz == up_m_s2


def reported_acceleration(outbox: Outbox) -> Vector3:
    assert outbox.peer_packet is not None
    return outbox.peer_packet.motion.acceleration_enu_m_s2


def test_packets_have_the_acceleration_that_the_autopilot_still_flies() -> None:
    """A tick without a new position sends no setpoint; the packet has the acceleration of the last one."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)
    commanded = reported_acceleration(flight.tick())
    assert commanded[0] > 0.5
    assert reported_acceleration(flight.tick(telemetry=[])) == commanded
    flight.tick(telemetry=[])
    assert reported_acceleration(flight.tick(telemetry=[])) == (0.0, 0.0, 0.0)  # older than the largest age of a state


def test_packets_have_no_acceleration_that_was_never_sent() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)
    commanded = reported_acceleration(flight.tick())
    flight.peer_position, flight.roll_rad = (2.5, 0.0, 1.0), 2.0  # Remark 1: no attitude gives what the law wants now
    outbox = flight.tick()
    assert outbox.attitude_target is None
    assert reported_acceleration(outbox) == commanded
    for _ in range(3):
        outbox = flight.tick()
    assert reported_acceleration(outbox) == (0.0, 0.0, 0.0)


def test_packets_have_no_acceleration_after_the_stream() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)
    flight.tick()
    flight.mode = AutopilotMode.OTHER
    assert reported_acceleration(flight.tick()) == (0.0, 0.0, 0.0)


# ---------------------------------------------------------------- change of leader


MAY_LEAD = FleetConfig(
    name="pair",
    origin="indoor",
    vehicles=(FLEET.vehicles[0], FormationMember(id=2, role=Role.FOLLOWER, slot_enu_m=(-1.5, 0.0, 0.0), may_lead=True)),
    neighbours=FLEET.neighbours,
    law=LawSection(name="weighted"),
    takeoff_height_m=1.0,
)
EIGHT = Figure8Reference(centre_enu_m=(0.0, 0.0, 1.0), width_m=6.0, height_m=3.0, period_s=40.0)


def test_a_vehicle_that_may_lead_ignores_the_rft_until_it_is_leader() -> None:
    one, other = (AgentFlight(fleet=MAY_LEAD, reference=r).fly_to(FlightPhase.FORMATION) for r in (POINT, EIGHT))
    assert one.targets == other.targets
    status = next(status for _ in range(10) if (status := one.tick().status))
    assert status.formation.reference_enu_m is None


def test_a_commanded_reference_is_in_packets_and_status() -> None:
    change = ReferenceChange(1, {"kind": "point", "point_enu_m": [4.0, 0.0, 1.0]}, 36.0)
    follower = AgentFlight().fly_to(FlightPhase.FORMATION)
    reply = follower.tick(CommandName.REFERENCE, lead=change).replies[0]
    assert outcome(reply) == (False, Code.REFERENCE_NOT_ALLOWED)
    flight = AgentFlight(fleet=MAY_LEAD, reference=EIGHT)
    flight.peer_reference, flight.peer_reference_s = HeldReference(0, 1), 30.0
    flight.fly_to(FlightPhase.FORMATION)
    flight.tick()
    replies = flight.tick(CommandName.REFERENCE, lead=change).replies
    assert (replies or flight.tick().replies)[0].accepted
    packet = flight.tick().peer_packet
    assert packet is not None
    assert packet.reference == HeldReference(0, 1)
    for _ in range(120):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.reference == HeldReference(1, 1, 36.0)
    assert any(event.text.startswith("reference 0 -> 1 (hand-over of ") for event in flight.events)
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert status.formation.reference == HeldReference(1, 1, 36.0)
    assert status.formation.reference_s == pytest.approx(flight.peer_reference_s, abs=0.03)
    assert status.formation.reference_enu_m is None  # it follows


def test_leadership_is_refused_when_the_reference_differs_from_the_leader_s() -> None:
    flight = AgentFlight(fleet=MAY_LEAD, reference=EIGHT)
    flight.peer_reference, flight.peer_reference_s = HeldReference(1, 1, 5.0), 33.0
    flight.fly_to(FlightPhase.FORMATION)
    reply = flight.tick(CommandName.LEAD, lead=Lead((2,), 1)).replies[0]
    assert outcome(reply) == (False, Code.REFERENCE_DIFFERS)
    assert flight.tick(CommandName.LEAD, lead=Lead((1,), 1)).replies[0].accepted  # it may follow


def test_leadership_is_refused_when_the_reference_is_far_from_the_fleet() -> None:
    """Number and begin are those of the leader, but the hand-over to it differed."""
    flight = AgentFlight(fleet=MAY_LEAD, reference=PointReference(point_enu_m=(30.5, 0.0, 1.0)))
    flight.peer_reference_s = 33.0
    flight.fly_to(FlightPhase.FORMATION)
    reply = flight.tick(CommandName.LEAD, lead=Lead((2,), 1)).replies[0]
    assert outcome(reply) == (False, Code.REFERENCE_OFF_FLEET)
    assert "is 30.5 m from" in reply.reason


def test_a_leader_leads_in_when_its_reference_is_away_from_the_fleet() -> None:
    """The fleet lags behind, or the leader was lost while it led in itself."""
    flight = AgentFlight(fleet=MAY_LEAD, reference=PointReference(point_enu_m=(3.5, 0.0, 1.0)))
    flight.peer_reference_s = 33.0
    flight.fly_to(FlightPhase.FORMATION)
    flight.peer_role = Role.FOLLOWER
    assert flight.tick(CommandName.LEAD, lead=Lead((2,), 1)).replies[0].accepted
    assert flight.outbox.status is not None
    statuses = [flight.outbox.status, *(status for _ in range(500) if (status := flight.tick().status))]
    references = [status.formation.reference_enu_m for status in statuses]
    assert references[0] == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)  # where the fleet is
    assert references[-1] == (3.5, 0.0, 1.0)
    steps_m = [dist(a, b) for a, b in pairwise(references) if a and b]
    assert max(steps_m) < 0.11  # in 0.1 s, at slot_speed_m_s


def test_a_commanded_leader_continues_the_rft_in_the_same_tick() -> None:
    flight = AgentFlight(fleet=MAY_LEAD, reference=EIGHT)
    flight.peer_reference_s = 0.1  # R is still near the fleet
    flight.fly_to(FlightPhase.FORMATION)
    flight.peer_role = Role.FOLLOWER
    outbox = flight.tick(CommandName.LEAD, lead=Lead((2,), 1))
    assert outbox.replies[0].accepted
    packet = outbox.peer_packet
    assert packet is not None
    assert packet.leader.beacon is not None
    assert (packet.role, packet.leader.prc, packet.leader.beacon.leader_id, packet.leader.beacon.epoch) == (
        Role.LEADER,
        1,
        2,
        1,
    )
    assert packet.leader.beacon.reference_s == pytest.approx(flight.peer_reference_s, abs=0.02)
    assert outbox.attitude_target is not None  # no tick is without a setpoint
    assert outbox.events == (Notice(Code.ROLE_CHANGED, "follower -> leader in epoch 1 (commanded)"),)
    assert outbox.status is not None
    expected = trajectory_of(EIGHT)(packet.leader.beacon.reference_s).position_enu_m
    assert outbox.status.formation.reference_enu_m == pytest.approx(expected)
    assert (outbox.status.leadership.role, outbox.status.leadership.epoch) == (Role.LEADER, 1)
    flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.leader.beacon is not None
    step_s = flight.outbox.peer_packet.leader.beacon.reference_s - packet.leader.beacon.reference_s
    assert step_s == pytest.approx(0.02)  # from now on it counts by itself


@pytest.mark.parametrize(
    ("fleet", "phase", "lead", "code"),
    [
        (FLEET, FlightPhase.FORMATION, Lead((2,), 1), Code.NOT_A_LEADER),
        (MAY_LEAD, FlightPhase.FORMATION, Lead((2,), 0), Code.EPOCH_TOO_OLD),
        (MAY_LEAD, FlightPhase.ENGAGE, Lead((2,), 1), Code.WRONG_PHASE),
    ],
)
def test_an_invalid_change_of_leader_is_refused_with_the_reason(
    fleet: FleetConfig, phase: FlightPhase, lead: Lead, code: Code
) -> None:
    flight = AgentFlight(fleet=fleet)
    flight.fly_to(FlightPhase.HOLD if phase is FlightPhase.ENGAGE else phase)
    if phase is FlightPhase.ENGAGE:
        flight.tick(CommandName.FORM)
    assert flight.agent.phase is phase
    reply = flight.tick(CommandName.LEAD, lead=lead).replies[0]
    assert outcome(reply) == (False, code)
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.role is Role.FOLLOWER


def test_a_leader_becomes_follower_in_the_tick_of_a_newer_beacon() -> None:
    flight = AgentFlight(vehicle_id=1, fleet=MAY_LEAD)
    flight.position, flight.peer_position = (0.0, 0.0, 0.0), (-1.5, 0.0, 1.0)
    flight.fly_to(FlightPhase.FORMATION)
    packet = with_fields(flight.peer()[0].packet, role=Role.LEADER, prc=1, beacon=LeaderBeacon(2, 1, 5, 7.0))
    outbox = flight.agent.step(
        flight.now_s + 0.02, Inbox(tuple(flight.telemetry()), (ReceivedPeerPacket(flight.now_s + 0.02, packet),))
    )
    assert outbox.peer_packet is not None
    assert outbox.peer_packet.role is Role.FOLLOWER
    assert outbox.peer_packet.leader.beacon is not None
    assert outbox.peer_packet.leader.beacon.leader_id == 2
    assert Notice(Code.ROLE_CHANGED, "leader -> follower in epoch 1 (reported by a peer)") in outbox.events


def reference_s_of(outbox: Outbox) -> float:
    assert outbox.peer_packet is not None
    assert outbox.peer_packet.leader.beacon is not None
    return outbox.peer_packet.leader.beacon.reference_s


@pytest.mark.parametrize("lands", [False, True])
def test_a_leader_s_second_formation_continues_the_rft_unless_it_has_landed(lands: bool) -> None:
    flight = AgentFlight(vehicle_id=1, reference=EIGHT)
    flight.position, flight.peer_position = (0.0, 0.0, 0.0), (-1.5, 0.0, 1.0)
    flight.fly_to(FlightPhase.FORMATION)
    for _ in range(500):
        flight.tick()
    flown_s = reference_s_of(flight.outbox)
    assert flown_s > 10.0
    flight.tick(CommandName.LAND if lands else CommandName.HOLD)
    for _ in range(50):
        flight.tick()
    if lands:
        flight.armed, flight.landed, flight.position = False, LandedState.ON_GROUND, (0.0, 0.0, 0.0)
        flight.tick()
        flight.mode = AutopilotMode.HOLD
        flight.fly_to(FlightPhase.FORMATION)
    else:
        assert reference_s_of(flight.outbox) == 0.0
        flight.tick(CommandName.FORM)
        for _ in range(50):
            flight.tick()
    assert flight.agent.phase is FlightPhase.FORMATION
    assert reference_s_of(flight.outbox) == pytest.approx(0.0 if lands else flown_s, abs=1.1)


SLOTS = ((1, (0.0, 0.0, 0.0)), (2, (-98.0, 0.0, 0.0)))


def test_a_follower_refuses_a_formation_outside_the_fence_at_the_fleet_s_position() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    for _ in range(60):  # until it is in its slot
        flight.tick()
    flight.peer_reference_s = 9.0
    flight.tick()
    change = FormationChange(1, SLOTS, 10.0, 300.0)
    assert flight.tick(CommandName.FORMATION, lead=change).replies[0].accepted  # the fleet is about x = 0
    flight.position = (-4.5, 0.0, 1.0)  # 3 m west of its slot, from which it derives the fleet's position
    flight.tick()
    reply = flight.tick(CommandName.FORMATION, lead=replace(change, number=2)).replies[0]
    assert outcome(reply) == (False, Code.SLOT_OUTSIDE_FENCE)
    assert "vehicle 2 at x = -101.0 m, outside the fence less clearance_m (-99.5 to 99.5)" in reply.reason


def test_a_vehicle_that_may_lead_refuses_a_formation_outside_the_fence_along_the_reference() -> None:
    eight = AgentFlight(fleet=MAY_LEAD, reference=EIGHT)
    eight.tick()
    reply = eight.tick(CommandName.FORMATION, lead=FormationChange(1, SLOTS, 1.0, 10.0)).replies[0]
    assert "puts vehicle 2 at x = -99." in reply.reason  # 3 m west of the eight's centre, half a minute from now


def test_a_formation_without_a_present_vehicle_is_refused() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.peer_reference_s = 9.0
    flight.tick()
    change = FormationChange(1, SLOTS, 12.0, 300.0, absent=(1, 2))
    assert outcome(flight.tick(CommandName.FORMATION, lead=change).replies[0]) == (False, Code.SLOTS_INCOMPLETE)
    flight.peer_changes = {"change": change}  # and the same in a packet of the leader
    flight.tick()
    flight.peer_changes = {}
    statuses = [status for _ in range(10) if (status := flight.tick().status)]
    assert statuses[-1].rejected == {f"{Code.PEER_CHANGE_IMPLAUSIBLE} 1": 1}
    assert flight.agent.phase is FlightPhase.FORMATION


def test_a_formation_commanded_on_the_ground_applies_to_the_next_flight() -> None:
    flight = AgentFlight()
    flight.tick()
    change = FormationChange(1, ((1, (0.0, 0.0, 0.0)), (2, (-3.0, 0.0, 0.0))), 1.0, 10.0)
    flight.peer_phase = FlightPhase.READY
    flight.tick()
    reply = flight.tick(CommandName.FORMATION, lead=change).replies[0]
    assert outcome(reply) == (True, Code.FORMATION_ACCEPTED)
    packet = flight.tick().peer_packet
    assert packet is not None
    assert packet.slot == FlownSlot((-3.0, 0.0, 0.0), formation=1, waiting=1)
