"""The RFT that a vehicle publishes which the separation filter keeps off its slot, and what its peers make of it."""

from __future__ import annotations

from math import inf

import pytest

from companion.core.consensus.kept_off import BACK_WITHIN_M, INTERVENES_M_S2, LASTS_S, NEARER_WITHIN_S, KeptOff, target
from companion.core.consensus.law import FlownLaw
from companion.core.consensus.peers import PeerState, neighbour_at
from companion.laws import Neighbour
from companion.laws._starting_point import StartingPoint
from companion.laws.serial import Serial
from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationState
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import ZERO3
from tests.helpers.laws import weighted

RFT = FormationState((10.0, 0.0, 5.0), (1.0, 0.0, 0.0), (0.0, 0.5, 0.0))


def off_by(x_m: float) -> FormationState:
    return FormationState((10.0 + x_m, 0.0, 5.0), ZERO3)


def test_a_vehicle_without_intervention_publishes_none() -> None:
    kept_off = KeptOff()
    assert not kept_off.intervened(0.0, 0.0)
    assert not kept_off.intervened(0.0, INTERVENES_M_S2)
    assert kept_off.intervened(0.0, 1.01 * INTERVENES_M_S2)


def test_a_vehicle_kept_off_publishes_the_rft_until_it_is_back() -> None:
    kept_off = KeptOff()
    assert kept_off.intervened(0.0, 1.0)
    assert kept_off.rft(0.0, off_by(0.0), RFT) is RFT  # an intervention has just begun
    after_s = 1.1 * LASTS_S
    assert kept_off.intervened(after_s, 0.0)
    assert kept_off.rft(after_s, off_by(1.1 * BACK_WITHIN_M), RFT) is RFT  # it is not back yet
    assert kept_off.rft(after_s, off_by(0.9 * BACK_WITHIN_M), RFT) is None
    assert not kept_off.intervened(after_s, 0.0)


def seconds_published(speed_m_s: float, began_m: float, lag_m: float) -> float:
    """For how long a vehicle publishes the RFT that comes back at this speed and then lags by `lag_m`."""
    kept_off = KeptOff()
    assert kept_off.intervened(0.0, 1.0)
    for tick in range(1, 5000):
        now_s = 0.02 * tick
        assert kept_off.intervened(now_s, 0.0)
        off_m = max(lag_m, began_m - speed_m_s * max(0.0, now_s - LASTS_S))
        if kept_off.rft(now_s, off_by(off_m), RFT) is None:
            return now_s
    return inf


@pytest.mark.parametrize("lag_m", [0.5, 3.0])
def test_a_vehicle_that_lags_behind_a_moving_rft_is_not_kept_off_for_ever(lag_m: float) -> None:
    """The law lags more than BACK_WITHIN_M: one intervention, by one wrong packet, would shift its peers for the flight."""
    assert seconds_published(0.0, lag_m, lag_m) == pytest.approx(LASTS_S + NEARER_WITHIN_S, abs=0.1)


@pytest.mark.parametrize("speed_m_s", [0.03, 1.0])
def test_a_vehicle_on_its_way_back_publishes_the_rft_until_it_is_there(speed_m_s: float) -> None:
    assert seconds_published(speed_m_s, 1.0, 0.0) == pytest.approx(LASTS_S + (1.0 - BACK_WITHIN_M) / speed_m_s, abs=0.1)


def test_leaving_formation_ends_it() -> None:
    kept_off = KeptOff()
    kept_off.intervened(0.0, 1.0)
    kept_off.end()
    assert not kept_off.intervened(0.1, 0.0)


def test_the_rft_is_that_of_the_law() -> None:
    neighbours = [
        Neighbour(off_by(m).position_enu_m, ZERO3, prc=prc) for prc, m in ((1, 0.0), (3, 4.0))
    ]  # weights 3/4 and 1/4
    assert target(weighted(), neighbours, RFT) is RFT
    assert target(weighted(), [], None) is None
    mean = target(weighted(), neighbours, None)
    assert target(StartingPoint(), neighbours, None) == mean  # a law that tells no weights
    assert mean is not None
    assert mean.position_enu_m == pytest.approx((11.0, 0.0, 5.0))
    assert (mean.velocity_enu_m_s, mean.acceleration_enu_m_s2) == (ZERO3, ZERO3)


def test_peers_use_the_rft_in_place_of_its_offset() -> None:
    packet = PeerPacket(
        sender=Sender(vehicle_id=2, session=1, sequence=1, formation_hash=0),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(13.0, 0.0, 5.0),
            velocity_enu_m_s=(0.0, 2.0, 0.0),
            acceleration_enu_m_s2=(3.0, 0.0, 0.0),
            state_age_s=0.0,
            sent_s=0.0,
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=FlownSlot((1.0, 0.0, 0.0)),
        rft=(RFT.position_enu_m, RFT.velocity_enu_m_s, RFT.acceleration_enu_m_s2),
    )
    peer = PeerState(packet, received_s=1.0, least_apart_s=0.0, measured_s=1.0)
    state = neighbour_at(peer, 1.02, 1)
    assert state.position_enu_m == pytest.approx(
        tuple(x + 0.02 * v for x, v in zip(RFT.position_enu_m, RFT.velocity_enu_m_s, strict=True)), abs=3e-4
    )
    assert state.velocity_enu_m_s == pytest.approx(RFT.velocity_enu_m_s, abs=0.03)
    assert state.acceleration_enu_m_s2 == RFT.acceleration_enu_m_s2
    assert peer.position_at(1.5) == pytest.approx((13.0, 1.0, 5.0))  # what is kept apart is where it is


def test_what_its_law_publishes_is_of_the_rft_too() -> None:
    ahead = Neighbour(RFT.position_enu_m, RFT.velocity_enu_m_s, values=(ZERO3,))
    vehicle, flown = VehicleState(position_enu_m=(13.0, 0.0, 5.0)), FlownLaw(Serial(), 0.0)
    assert flown.values(vehicle, FlownSlot((1.0, 0.0, 0.0)), ZERO3, [ahead], None) == ((2.0, 0.0, 0.0),)
    assert flown.values(vehicle, FlownSlot((1.0, 0.0, 0.0)), ZERO3, [ahead], None, RFT) == (ZERO3,)
