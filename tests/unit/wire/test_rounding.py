"""What is published is rounded, by far less than any sensor resolves."""

from __future__ import annotations

from math import inf, isnan, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from common import with_fields
from companion.types.autopilot import AttitudeTarget
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference, LeaderBeacon
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.tick import Outbox
from companion.wire.rounding import round_outbox, round_target

numbers = st.floats(-1e5, 1e5)
vectors = st.tuples(numbers, numbers, numbers)
PACKET = PeerPacket(
    sender=Sender(vehicle_id=3, session=1, sequence=2, formation_hash=3),
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    motion=Motion(
        position_enu_m=(1 / 3, 2 / 3, 3.0),
        velocity_enu_m_s=(0.1, 0.2, 1 / 3),
        acceleration_enu_m_s2=(1 / 3, 0.02, 0.03),
        state_age_s=1 / 3,
        sent_s=1234.5,
    ),
    leader=LeaderReport(prc=4, beacon=LeaderBeacon(1, 7, 60, 1 / 3)),
    slot=FlownSlot((-1 / 3, 0.0, 0.5)),
    reference=HeldReference(1, 2, 1 / 3),
)


def sent(**values: object) -> PeerPacket:
    packet = round_outbox(Outbox(peer_packet=with_fields(PACKET, **values))).peer_packet
    assert packet is not None
    return packet


@given(vectors, vectors, vectors, numbers)
def test_rounding_changes_less_than_any_sensor_resolves(position, velocity, acceleration, time_s) -> None:  # type: ignore[no-untyped-def]
    packet = sent(
        position_enu_m=position, velocity_enu_m_s=velocity, acceleration_enu_m_s2=acceleration, sent_s=time_s,
    )  # fmt: skip
    assert packet.motion.position_enu_m == pytest.approx(position, rel=0.0, abs=0.5001e-4)
    assert packet.motion.velocity_enu_m_s == pytest.approx(velocity, rel=0.0, abs=0.5001e-3)
    assert packet.motion.acceleration_enu_m_s2 == pytest.approx(acceleration, rel=0.0, abs=0.5001e-2)
    assert packet.motion.sent_s == pytest.approx(time_s, rel=0.0, abs=0.5001e-4)


@given(vectors, vectors, numbers)
def test_what_was_rounded_stays_as_it_is(position, velocity, time_s) -> None:  # type: ignore[no-untyped-def]
    outbox = round_outbox(
        Outbox(peer_packet=with_fields(PACKET, position_enu_m=position, rft=(velocity,) * 3, sent_s=time_s))
    )
    assert round_outbox(outbox) == outbox


def test_numbers_that_are_not_finite_stay() -> None:
    x, y, z = sent(position_enu_m=(nan, inf, -inf)).motion.position_enu_m
    assert isnan(x)
    assert (y, z) == (inf, -inf)


def test_what_vehicles_compare_stays_exact() -> None:
    change = FormationChange(1, ((1, (1 / 3, 0.0, 0.0)),), 1 / 3, 4.0)
    packet = sent(change=change)
    assert packet.change == change
    assert packet.reference == PACKET.reference


angles = st.floats(-pi, pi)


@given(angles, angles, angles, st.floats(0.0, 1.0))
def test_a_setpoint_is_rounded_to_a_microradian(roll: float, pitch: float, yaw: float, thrust: float) -> None:
    wanted = AttitudeTarget(roll, pitch, yaw, thrust)
    target = round_outbox(Outbox(attitude_target=wanted)).attitude_target
    assert target == round_target(wanted)
    assert astuple(target) == pytest.approx(astuple(wanted), rel=0.0, abs=0.5001e-6)
