"""Vehicles that stay where they are, in the way of a commanded formation or reference.

A vehicle in hold, or one that climbs, lands or returns, does not move with the formation. So its position counts, not its slot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from companion.geometry.separation import counted
from companion.geometry.vectors import plus
from companion.types.flight import HELD, ON_GROUND, STREAMING, FlightPhase
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.vectors import Vector3

Tracks = Mapping[int, Sequence[Vector3]]
"""Positions over time by vehicle id, ENU metres."""


def refusal_of_tracks(tracks_enu_m: Tracks, peers: Iterable[PeerPacket], separation_m: float) -> Notice | None:
    """The refusal where a vehicle on its track comes nearer than `separation_m` to a peer that stays.

    Of a peer in hold the height counts; one that climbs or comes down is in the way at every height. A vehicle that is already
    nearer at the beginning of its track is the separation filter's matter.
    """
    staying = [peer for peer in peers if stays(peer)]
    if not staying or not tracks_enu_m:
        return None
    tracks = {vehicle_id: np.array(track_enu_m) for vehicle_id, track_enu_m in tracks_enu_m.items()}
    for peer in staying:
        has_height = peer.phase in HELD
        scale = np.array(counted((1.0, 1.0, 1.0), has_height))
        at = np.array(peer.position_enu_m) * scale
        for vehicle_id, track in tracks.items():
            points = track * scale - at
            apart_m, begins_m = _least_m(points), float(np.linalg.norm(points[0]))
            if apart_m < separation_m <= begins_m:
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


def _least_m(points: NDArray[np.float64]) -> float:
    """Least distance from the origin of the segments between these points."""
    starts, ways = points[:-1], np.diff(points, axis=0)
    if not len(ways):
        return float(np.linalg.norm(points[0]))
    squared = (ways**2).sum(axis=1)
    shares = np.clip(-(starts * ways).sum(axis=1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return float(np.linalg.norm(starts + shares[:, None] * ways, axis=1).min())
