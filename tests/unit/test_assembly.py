"""What the assembly makes of a fleet file and a vehicle file, where no other test would see that it is not passed on."""

from __future__ import annotations

from math import hypot, radians, tan

import pytest
from msgspec.structs import replace

from agent_on_bytes import FlightOnBytes
from companion.assembly import build_agent, fleet_limits
from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig, FormationMember, PeerLimits
from companion.config.reference import PointReference
from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code
from companion.types.values import GRAVITY_M_S2

FLEET = FleetConfig(
    name="one",
    origin="indoor",
    vehicles=(FormationMember(id=3, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),),
    neighbours=EdgeNeighbours(edges=()),
)


def test_received_accelerations_are_limited_to_what_tilt_and_thrust_allow() -> None:
    """Level at the largest tilt with the largest thrust, and upwards or downwards, whichever is more."""
    falls = Envelope(max_tilt_deg=25.0, max_thrust_ratio=1.6, min_thrust_ratio=0.3)
    climbs = Envelope(max_tilt_deg=40.0, max_thrust_ratio=2.5, min_thrust_ratio=0.3)
    for envelope, upright_ratio in ((falls, 0.7), (climbs, 1.5)):
        limits = fleet_limits(replace(FLEET, envelope=envelope))
        level_ratio = envelope.max_thrust_ratio * tan(radians(envelope.max_tilt_deg))
        assert limits.acceleration_m_s2 == pytest.approx(GRAVITY_M_S2 * hypot(level_ratio, upright_ratio))
    assert fleet_limits(FLEET).acceleration_m_s2 == pytest.approx(10.03, abs=0.01)


def test_received_speeds_are_limited_by_the_peers_section_and_slots_by_the_fence_without_its_clearance() -> None:
    envelope = Envelope(fence_min_enu_m=(-10.0, -20.0, -1.0), fence_max_enu_m=(30.0, 40.0, 9.0), clearance_m=2.0)
    limits = fleet_limits(replace(FLEET, envelope=envelope, peers=PeerLimits(max_speed_m_s=31.0)))
    assert limits.speed_m_s == 31.0
    assert limits.fence_size_m == (36.0, 56.0, 6.0)


# Of COM_OBL_RC_ACT of PX4.
SINKS, FALLS, HOLDS = (0, 1, 2), 7, 5  # position, altitude and manual mode without a pilot; disarm; hold


def prepared(loss_action: int, accepts: bool) -> FlightOnBytes:
    """An agent with a PX4 that does this when setpoints end, after the command to prepare."""
    flight = FlightOnBytes(AutopilotKind.PX4)
    (member,) = FLEET.vehicles
    vehicle = VehicleConfig(
        id=3,
        fleet="fleet.yaml",
        mavlink="udpin:127.0.0.1:14540",
        hover_thrust_norm=0.5,
        reference=PointReference(point_enu_m=(0.0, 0.0, 2.0)),
        accept_uncontrolled_descent=accepts,
    )
    flight.agent = build_agent(AgentConfig(vehicle, FLEET, member), session=1)
    flight.autopilot.parameters["COM_OBL_RC_ACT"] = loss_action
    flight.ticks(2.0)
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF):
        flight.tick(name)
        flight.ticks(2.0)
    assert flight.agent.phase is FlightPhase.HOLD
    flight.tick(CommandName.FORM)
    flight.ticks(2.0)
    return flight


@pytest.mark.parametrize("loss_action", SINKS)
def test_formation_is_refused_where_the_vehicle_would_sink_unless_its_file_accepts_that(loss_action: int) -> None:
    refused = prepared(loss_action, accepts=False)
    accepted, code, reason = refused.replies[-1]
    assert (accepted, code) == (False, Code.AUDIT_REFUSAL)
    assert "COM_OBL_RC_ACT" in reason
    flown = prepared(loss_action, accepts=True)
    assert flown.replies[-1][0], flown.replies[-1]
    assert flown.agent.phase is FlightPhase.FORMATION
    assert any(Code.SETPOINT_LOSS_ACTION_UNSAFE is event.code for event in flown.events)  # as a warning


def test_a_vehicle_that_would_fall_is_refused_although_its_file_accepts_to_sink() -> None:
    accepted, code, reason = prepared(FALLS, accepts=True).replies[-1]
    assert (accepted, code) == (False, Code.AUDIT_REFUSAL)
    assert "COM_OBL_RC_ACT" in reason
    assert prepared(HOLDS, accepts=False).replies[-1][0]
