"""The path into a formation that others fly: begin, end, speed and refusals."""

from __future__ import annotations

from math import dist, hypot

import numpy as np
import pytest

from common import FLEET, NOW_S, PEER_SLOTS, peer
from companion.core.consensus.peers import PeerState
from companion.core.formation.entry import JOINS_AFTER_S, Joining
from companion.core.formation.paths import Entering
from companion.geometry.formations import turned_slot
from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import EAST, FlownSlot, Heading
from companion.types.notices import Refused
from companion.types.values import ZERO3, Vector3


def joining() -> Joining:
    return Joining(3, separation_m=1.0, speed_m_s=1.0)


def entering(at: Vector3, *peers: PeerState, heading: Heading = EAST, slot: Vector3 = PEER_SLOTS[3]) -> Entering:
    return Entering(NOW_S, VehicleState(position_enu_m=at), peers, heading, {3: slot})


def test_joining_is_due_when_a_peer_has_been_in_formation_for_a_while() -> None:
    plan = joining()
    plan.update(0.0, [1])
    assert not plan.is_due(JOINS_AFTER_S)
    plan.update(JOINS_AFTER_S + 0.1, [1, 2])
    assert plan.is_due(JOINS_AFTER_S + 0.1)
    plan.update(3.0, [])
    assert not plan.is_due(3.0)


@pytest.mark.parametrize("moves_m_s", [ZERO3, (2.0, 0.0, 0.0)])
def test_the_path_begins_at_position_and_velocity_and_ends_in_the_slot(moves_m_s: Vector3) -> None:
    start: Vector3 = (0.0, 3.0, 2.0)
    delta, lasts_s = joining().path(entering(start, peer(1, moves_m_s), peer(2, moves_m_s)))
    begin, end = delta(0.0), delta(lasts_s)
    assert begin[0] == pytest.approx((-6.0, 3.0, -3.0))  # of x - r - d
    assert begin[1] == pytest.approx([-v for v in moves_m_s])
    assert end[0] == end[1] == pytest.approx(ZERO3)
    motions = [delta(t) for t in np.linspace(0.0, lasts_s, 300).tolist()]
    assert max(hypot(*velocity) for _, velocity, _ in motions) <= (1.0 + hypot(*moves_m_s)) * 1.01
    assert max(hypot(*acceleration) for _, _, acceleration in motions) <= 1.01


def test_the_path_begins_at_rest_when_the_formation_turns() -> None:
    heading, start = Heading(1.0, 0.2), (0.0, 3.0, 2.0)
    peers = []
    for vehicle_id in (1, 2):
        slot = turned_slot(FlownSlot(PEER_SLOTS[vehicle_id]), heading)
        x, y, z = (r + d for r, d in zip(FLEET, slot.position_enu_m, strict=True))
        peers.append(peer(vehicle_id, slot.velocity_enu_m_s, position_enu_m=(x, y, z), slot=slot))
    delta, lasts_s = joining().path(entering(start, *peers, heading=heading))
    assert delta(lasts_s)[0] == pytest.approx(ZERO3)
    position, velocity, _ = delta(0.0)
    x, y, z = (d + e for d, e in zip(PEER_SLOTS[3], position, strict=True))
    begin = turned_slot(FlownSlot((x, y, z), velocity), heading)
    assert begin.position_enu_m == pytest.approx([a - b for a, b in zip(start, FLEET, strict=True)])
    assert begin.velocity_enu_m_s == pytest.approx(ZERO3)


@pytest.mark.parametrize(
    ("peers", "text"),
    [
        ([peer(1, phase=FlightPhase.HOLD)], "no vehicle is in formation any more"),
        ([peer(1), peer(2, slot=FlownSlot((-4.3, 0.0, 0.0)))], "its slot is taken: vehicle 2 flies 0.30 m from it"),
        (
            [peer(1), peer(2, slot=FlownSlot(PEER_SLOTS[2], (0.1, 0.0, 0.0), moves_for_s=1.0))],
            "vehicle 2 is not in its slot yet",
        ),
        ([peer(1), peer(2, slot=FlownSlot(PEER_SLOTS[2], waiting=1))], "vehicle 2 is not in its slot yet"),
        ([peer(1), peer(2, phase=FlightPhase.ENGAGE)], "vehicle 2 is joining; give form again then"),
        (
            [peer(1), peer(2, phase=FlightPhase.HOLD, position_enu_m=(2.0, 0.2, 5.0))],
            "comes within 0.20 m of vehicle 2",
        ),
        ([peer(1, velocity_enu_m_s=ZERO3)], "too far"),
    ],
)
def test_joining_is_refused_with_the_reason_when_there_is_no_path(peers: list[PeerState], text: str) -> None:
    start: Vector3 = (-5000.0, 0.0, 5.0) if text == "too far" else (-2.0, 0.0, 5.0)
    with pytest.raises(Refused, match=text):
        joining().path(entering(start, *peers))


def test_a_path_beside_the_formation_keeps_the_separation() -> None:
    """From ahead of the column to its end, 1.2 m beside it; straight through it is refused."""
    beside: Vector3 = (14.0, 4.0, 5.0)
    delta, lasts_s = joining().path(entering(beside, peer(1), peer(2), slot=(-4.0, 4.0, 0.0)))
    points = [
        tuple(d + e for d, e in zip((-4.0, 4.0, 0.0), delta(t)[0], strict=True)) for t in np.linspace(0, lasts_s, 99)
    ]
    assert min(dist(point, PEER_SLOTS[i]) for point in points for i in (1, 2)) >= 1.0
    with pytest.raises(Refused, match="of vehicle 1; expected at least separation_m, 1 m"):
        joining().path(entering((14.0, 0.0, 5.0), peer(1), peer(2)))
