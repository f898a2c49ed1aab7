"""What the assembly makes of a fleet file and a vehicle file, where no other test would see that it is not passed on."""

from __future__ import annotations

from math import hypot, radians, tan

import pytest
from msgspec.structs import replace

from companion.assembly import fleet_limits
from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig, FormationMember, PeerLimits
from companion.types.flight import Role
from companion.types.vectors import GRAVITY_M_S2

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
