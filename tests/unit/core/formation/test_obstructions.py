"""Vehicles that stay in the way of vehicles in formation."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from common import code_of, slot_peer, with_fields
from companion.core.formation.limits import members, refusal_of_tracks, tracks_about
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.peers import PeerPacket
from companion.types.values import Vector3

P = FlightPhase
EAST: list[Vector3] = [(0.0, 0.0, 5.0), (3.0, 0.0, 5.0), (6.0, 0.0, 5.0)]


def at(position: Vector3, phase: FlightPhase = P.HOLD, armed: bool = True) -> PeerPacket:
    return with_fields(slot_peer(3, air=True), position_enu_m=position, phase=phase, armed=armed)


@pytest.mark.parametrize("phase", [P.HOLD, P.RELEASE, P.LAND, P.RETURN, P.TAKEOFF, P.OBSERVE])
def test_a_vehicle_out_of_formation_is_in_the_way_where_it_is(phase: FlightPhase) -> None:
    tracks = {2: EAST}
    refusal = refusal_of_tracks(tracks, [at((4.5, 0.4, 5.0), phase)], 1.0)  # between two points of the track
    assert code_of(refusal) is Code.VEHICLE_IN_THE_WAY
    assert "vehicle 2 would come within 0.40 m of vehicle 3" in refusal.text
    assert refusal_of_tracks(tracks, [at((4.5, 1.4, 5.0), phase)], 1.0) is None


@pytest.mark.parametrize(("phase", "in_the_way"), [(P.HOLD, False), (P.LAND, True)])
def test_a_vehicle_that_lands_is_in_the_way_at_every_height(phase: FlightPhase, in_the_way: bool) -> None:
    refusal = refusal_of_tracks({2: EAST}, [at((4.5, 0.4, 15.0), phase)], 1.0)
    assert (refusal is not None) is in_the_way


@pytest.mark.parametrize(
    "packet", [at((4.5, 0.4, 5.0), P.FORMATION), at((4.5, 0.4, 5.0), P.READY), at((4.5, 0.4, 5.0), P.OBSERVE, False)]
)
def test_vehicles_in_formation_and_on_the_ground_are_not_in_the_way(packet: PeerPacket) -> None:
    assert refusal_of_tracks({2: EAST}, [packet], 1.0) is None


def test_a_vehicle_too_close_at_the_beginning_refuses_nothing() -> None:
    """Else the fleet could not fly away from it."""
    assert refusal_of_tracks({2: EAST}, [at((0.0, 0.4, 5.0))], 1.0) is None


def test_tracks_are_those_of_the_vehicles_in_formation() -> None:
    peers = [at((0.0, 0.0, 5.0)), replace(slot_peer(1, air=True), phase=P.FORMATION)]
    assert members(2, peers) == [2, 1]
    tracks = tracks_about(EAST, {1: (0.0, 1.0, 0.0), 2: (0.0, 0.0, 0.0), 3: (9.0, 0.0, 0.0)}, [2, 1])
    assert tracks == {2: EAST, 1: [(0.0, 1.0, 5.0), (3.0, 1.0, 5.0), (6.0, 1.0, 5.0)]}
