"""Vehicles that stay where they are, in the way of a commanded formation or reference.

A vehicle in hold, or one that climbs, lands or returns, does not move with the formation. So its position counts, not its slot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from math import dist

from companion.geometry.separation import counted
from companion.geometry.vectors import minus, plus, scaled
from companion.types.flight import HELD, ON_GROUND, STREAMING, FlightPhase
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import Vector3

Tracks = Mapping[int, Sequence[Vector3]]
"""Positions over time by vehicle id, ENU metres."""


def refusal_of_tracks(tracks_enu_m: Tracks, peers: Iterable[PeerPacket], separation_m: float) -> Notice | None:
    """The refusal where a vehicle on its track comes nearer than `separation_m` to a peer that stays.

    Of a peer in hold the height counts; one that climbs or comes down is in the way at every height. A vehicle that is already
    nearer at the beginning of its track is the separation filter's matter.
    """
    for peer in peers:
        if not stays(peer):
            continue
        has_height = peer.phase in HELD
        at = counted(peer.position_enu_m, has_height)
        for vehicle_id, track_enu_m in tracks_enu_m.items():
            points = [counted(point, has_height) for point in track_enu_m]
            longest_m = max((dist(a, b) for a, b in pairwise(points)), default=0.0)
            if min(dist(at, point) for point in points) - longest_m >= separation_m:
                continue  # no segment comes nearer than that
            apart_m = min((_off(at, a, b) for a, b in pairwise(points)), default=dist(at, points[0]))
            if apart_m < separation_m <= dist(at, points[0]):
                return Notice(
                    Code.VEHICLE_IN_THE_WAY,
                    f"vehicle {vehicle_id} would come within {apart_m:.2f} m of vehicle {peer.vehicle_id}, which is in phase"
                    f" {peer.phase}; expected at least separation_m, {separation_m:g} m",
                )
    return None


def stays(peer: PeerPacket) -> bool:
    """Whether a peer is in the air and not in formation."""
    return peer.armed and peer.phase not in STREAMING and peer.phase not in ON_GROUND


def members(own_id: int, peers: Iterable[PeerPacket]) -> list[int]:
    """The vehicles in formation, this one included."""
    return [own_id, *(peer.vehicle_id for peer in peers if peer.phase is FlightPhase.FORMATION)]


def tracks_about(
    rft_enu_m: Sequence[Vector3], slots_enu_m: Mapping[int, Vector3], vehicle_ids: Collection[int]
) -> dict[int, list[Vector3]]:
    """Tracks of these vehicles in slots that do not move about these positions of the RFT."""
    return {i: [plus(r, slots_enu_m[i]) for r in rft_enu_m] for i in vehicle_ids}


def _off(point: Vector3, a: Vector3, b: Vector3) -> float:
    """Distance of a point from a segment."""
    way, to = minus(b, a), minus(point, a)
    squared = sum(c * c for c in way)
    share = sum(c * d for c, d in zip(way, to, strict=True)) / squared if squared > 0.0 else 0.0
    return dist(point, plus(a, scaled(way, min(max(share, 0.0), 1.0))))
