"""The way into a formation that others fly: where it begins and ends, how fast, and when there is none."""

from __future__ import annotations

from math import dist, hypot

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.joining import JOINS_AFTER_S, Joining
from companion.core.peers import PeerState
from companion.geometry.turning import turned_slot
from companion.types import EAST, ZERO3, FlightPhase, FlownSlot, Heading, PeerPacket, Role, Vector3

SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)}
FLEET: Vector3 = (10.0, 0.0, 5.0)
NOW_S = 100.0


def peer(vehicle_id: int, moves_m_s: Vector3 = ZERO3, **changes: object) -> PeerState:
    x, y, z = (r + d for r, d in zip(FLEET, SLOTS[vehicle_id], strict=True))
    packet = PeerPacket(
        vehicle_id=vehicle_id,
        session=1,
        sequence=1,
        formation_hash=0,
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        position_enu_m=(x, y, z),
        velocity_enu_m_s=moves_m_s,
        acceleration_enu_m_s2=ZERO3,
        state_age_s=0.0,
        sent_s=0.0,
        prc=2,
        leader_word=None,
        slot=FlownSlot(SLOTS[vehicle_id]),
    )
    return PeerState(replace(packet, **changes), NOW_S, NOW_S, NOW_S)


def joining() -> Joining:
    return Joining(3, separation_m=1.0, speed_m_s=1.0)


def test_there_is_a_formation_to_join_once_others_have_flown_it_for_a_while() -> None:
    plan, flying = joining(), [peer(1).packet, replace(peer(2).packet, phase=FlightPhase.HOLD)]
    plan.hear(0.0, flying)
    assert not plan.is_due(JOINS_AFTER_S)
    plan.hear(JOINS_AFTER_S + 0.1, flying)
    assert plan.is_due(JOINS_AFTER_S + 0.1)
    plan.hear(3.0, flying[1:])
    assert not plan.is_due(3.0)


@pytest.mark.parametrize("moves_m_s", [ZERO3, (2.0, 0.0, 0.0)])
def test_the_way_begins_where_the_vehicle_is_and_as_fast_and_ends_in_its_slot(moves_m_s: Vector3) -> None:
    start: Vector3 = (0.0, 3.0, 2.0)
    delta, lasts_s = joining().way(NOW_S, start, ZERO3, SLOTS[3], EAST, [peer(1, moves_m_s), peer(2, moves_m_s)])
    begin, end = delta(0.0), delta(lasts_s)
    assert begin[0] == pytest.approx((-6.0, 3.0, -3.0))  # of x - r - d
    assert begin[1] == pytest.approx([-v for v in moves_m_s])
    assert end[0] == end[1] == pytest.approx(ZERO3)
    motions = [delta(t) for t in np.linspace(0.0, lasts_s, 300).tolist()]
    assert max(hypot(*velocity) for _, velocity, _ in motions) <= (1.0 + hypot(*moves_m_s)) * 1.01
    assert max(hypot(*acceleration) for _, _, acceleration in motions) <= 1.01


def test_the_way_into_a_formation_that_turns_begins_where_the_vehicle_stands() -> None:
    """About its RFT everything goes round; that alone is no reason to wait."""
    heading, start = Heading(1.0, 0.2), (0.0, 3.0, 2.0)
    peers = []
    for vehicle_id in (1, 2):
        slot = turned_slot(FlownSlot(SLOTS[vehicle_id]), heading)
        x, y, z = (r + d for r, d in zip(FLEET, slot.position_enu_m, strict=True))
        peers.append(peer(vehicle_id, slot.velocity_enu_m_s, position_enu_m=(x, y, z), slot=slot))
    delta, lasts_s = joining().way(NOW_S, start, ZERO3, SLOTS[3], heading, peers)
    assert delta(lasts_s)[0] == pytest.approx(ZERO3)
    position, velocity, _ = delta(0.0)
    x, y, z = (d + e for d, e in zip(SLOTS[3], position, strict=True))
    begin = turned_slot(FlownSlot((x, y, z), velocity), heading)
    assert begin.position_enu_m == pytest.approx([a - b for a, b in zip(start, FLEET, strict=True)])
    assert begin.velocity_enu_m_s == pytest.approx(ZERO3)


@pytest.mark.parametrize(
    ("peers", "words"),
    [
        ([peer(1, phase=FlightPhase.HOLD)], "nobody is in formation any more"),
        ([peer(1), peer(2, slot=FlownSlot((-4.3, 0.0, 0.0)))], "its slot is taken: vehicle 2 flies 0.30 m from it"),
        (
            [peer(1), peer(2, slot=FlownSlot(SLOTS[2], (0.1, 0.0, 0.0), moves=True))],
            "vehicle 2 is still to take up its slot",
        ),
        ([peer(1), peer(2, slot=FlownSlot(SLOTS[2], waiting=1))], "vehicle 2 is still to take up its slot"),
        ([peer(1), peer(2, phase=FlightPhase.ENGAGE)], "vehicle 2 joins just now; give form again then"),
        (
            [peer(1), peer(2, phase=FlightPhase.HOLD, position_enu_m=(2.0, 0.2, 5.0))],
            "comes within 0.20 m of vehicle 2",
        ),
        ([peer(1, velocity_enu_m_s=ZERO3)], "too far"),
    ],
)
def test_where_there_is_no_way_it_says_why(peers: list[PeerState], words: str) -> None:
    start: Vector3 = (-5000.0, 0.0, 5.0) if words == "too far" else (-2.0, 0.0, 5.0)
    with pytest.raises(ValueError, match=words):
        joining().way(NOW_S, start, ZERO3, SLOTS[3], EAST, peers)


def test_a_way_past_others_keeps_the_separation() -> None:
    """From ahead of the column to its end, 1.2 m beside it; straight through it is refused."""
    beside: Vector3 = (14.0, 4.0, 5.0)
    delta, lasts_s = joining().way(NOW_S, beside, ZERO3, (-4.0, 4.0, 0.0), EAST, [peer(1), peer(2)])
    ways = [
        tuple(d + e for d, e in zip((-4.0, 4.0, 0.0), delta(t)[0], strict=True)) for t in np.linspace(0, lasts_s, 99)
    ]
    assert min(dist(point, SLOTS[i]) for point in ways for i in (1, 2)) >= 1.0
    with pytest.raises(ValueError, match="of vehicle 1; expected at least separation_m, 1 m"):
        joining().way(NOW_S, (14.0, 0.0, 5.0), ZERO3, SLOTS[3], EAST, [peer(1), peer(2)])
