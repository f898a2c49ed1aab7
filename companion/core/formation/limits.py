"""Limits of a commanded formation: separation, speed, fence, obstacles, and vehicles that stay in the way."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist, floor, hypot

from companion.core.reference.blend import reference_box
from companion.core.reference.target import Box
from companion.geometry.airspace import Airspace, leg_conflict_steps, nearest_kind
from companion.geometry.curves import PEAK_SPEED
from companion.geometry.formations import (
    ROUNDING_M,
    closest_approach,
    peak_speed_m_s,
    reach_m,
    swept,
    to_separation_metric,
)
from companion.geometry.vectors import minus, plus, scaled
from companion.types.flight import HELD, ON_GROUND, STREAMING, FlightPhase
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.steps import Steps, coarser
from companion.types.values import Vector3

Slots = Mapping[int, Vector3]
"""d_i0 by vehicle id, ENU metres relative to the RFT."""


@dataclass(frozen=True, slots=True)
class FormationLimits:
    """Limits of the whole fleet. Methods return the refusal or the warning, None where the limits are kept.

    `slots_turn`: the formation turns about the RFT, so that each slot needs room on its whole circle.
    `slots_have_height` is False where each vehicle keeps its own altitude: then only horizontal distances count.
    """

    separation_m: float
    speed_m_s: float  # largest speed of a slot relative to the RFT
    fence: Box
    slots_turn: bool = False
    slots_have_height: bool = True
    airspace: Airspace | None = None  # where it is more than the box of the fence

    def refusal_of_positions(self, slots_enu_m: Slots, rft_enu_m: Iterable[Vector3]) -> Notice | None:
        """Fence: no slot may lie outside it, at any of these positions of the RFT."""
        corners = self._corners(slots_enu_m)
        low_m, high_m = reference_box(self.fence, [corner for _, corner in corners])
        for r_enu_m in rft_enu_m:
            if all(least < r < most for r, least, most in zip(r_enu_m, low_m, high_m, strict=True)):
                continue
            for vehicle_id, slot_enu_m in corners:
                for axis, r, d, least, most in zip("xyz", r_enu_m, slot_enu_m, *self.fence, strict=True):
                    if not least <= r + d <= most:
                        where = f"{axis} = {r + d:.1f} m, outside the fence less clearance_m ({least:g} to {most:g})"
                        return Notice(Code.SLOT_OUTSIDE_FENCE, f"puts vehicle {vehicle_id} at {where}")
        return None

    def refusal_of_extent(self, slots_enu_m: Slots) -> Notice | None:
        """Fence, wherever the RFT is: no slot may be farther from it, and no two from each other, than the fence is wide."""
        for axis, name in enumerate("xyz"):
            width_m = self.fence[1][axis] - self.fence[0][axis]
            along_m = [slot_enu_m[axis] for _, slot_enu_m in self._corners(slots_enu_m)]
            needs_m = max(max(along_m), -min(along_m), max(along_m) - min(along_m))
            if needs_m > width_m:
                text = f"needs {needs_m:.1f} m along {name}; the fence is {width_m:g} m wide"
                return Notice(Code.SLOT_OUTSIDE_FENCE, text)
        return None

    def scale_inside(self, slots_enu_m: Slots, rft_enu_m: Sequence[Vector3]) -> float | None:
        """The largest factor on these slots with which they are inside the fence at all of these positions of the RFT.

        None where the RFT itself is not, or the vehicles would come too near to each other.
        """
        corners, scale = [corner for _, corner in self._corners(slots_enu_m)], 1.0
        for axis, (least, most) in enumerate(zip(*self.fence, strict=True)):
            low_m, high_m = min(corner[axis] for corner in corners), max(corner[axis] for corner in corners)
            needs = [(high_m - low_m, most - least), (high_m, most - least), (-low_m, most - least)]
            if rft_enu_m:
                needs += [(high_m, most - max(r[axis] for r in rft_enu_m))]
                needs += [(-low_m, min(r[axis] for r in rft_enu_m) - least)]
            scale = min(scale, *(room_m / needs_m for needs_m, room_m in needs if needs_m > ROUNDING_M), 1.0)
        scale = floor(scale * 1000.0) / 1000.0
        scaled_m = {i: scaled(slot, scale) for i, slot in slots_enu_m.items()}
        return scale if scale > 0.0 and self.refusal_of_distance(scaled_m) is None else None

    def airspace_steps(
        self, before_enu_m: Slots, after_enu_m: Slots, on_the_way_enu_m: Iterable[Vector3], rft_enu_m: Iterable[Vector3]
    ) -> Steps[Notice | None]:
        """Polygon and obstacles: straight paths between the slots about some positions of the RFT, and the slots about all."""
        if self.airspace is None:
            return None
        at_once = self.airspace.positions_per_step()
        ways = self._conflict(before_enu_m, after_enu_m, on_the_way_enu_m, self.airspace)
        slots = self._conflict(after_enu_m, after_enu_m, rft_enu_m, self.airspace)
        found = (yield from coarser(ways, at_once)) or (yield from coarser(slots, at_once))
        if found is None:
            return None
        vehicle_id, position = found
        x, y, z = position
        text = (
            f"brings vehicle {vehicle_id} to ({x:.1f}, {y:.1f}, {z:.1f}), too near to"
            f" {nearest_kind(self.airspace, position)}; expected slots and paths that keep envelope.clearance_m,"
            f" {self.airspace.clearance_m:g} m"
        )
        return Notice(Code.SLOT_OUTSIDE_AIRSPACE, text)

    def _conflict(
        self, before_enu_m: Slots, after_enu_m: Slots, rft_enu_m: Iterable[Vector3], airspace: Airspace
    ) -> Steps[tuple[int, Vector3] | None]:
        outermost_m = max(hypot(*slot) for slots in (before_enu_m, after_enu_m) for slot in slots.values())
        for r_enu_m in rft_enu_m:
            yield
            if airspace.room_m(r_enu_m) >= outermost_m:
                continue
            for vehicle_id, after in after_enu_m.items():
                before, around_m = before_enu_m[vehicle_id], 0.0
                if self.slots_turn:
                    around_m = reach_m([before, after])
                    before, after = (0.0, 0.0, before[2]), (0.0, 0.0, after[2])
                start_m, end_m = plus(r_enu_m, before), plus(r_enu_m, after)
                found = yield from leg_conflict_steps(airspace, start_m, end_m, around_m)
                if found is not None:
                    return vehicle_id, found
        return None

    def _corners(self, slots_enu_m: Slots) -> list[tuple[int, Vector3]]:
        if not self.slots_turn:
            return list(slots_enu_m.items())
        return [(i, corner) for i, slot_enu_m in slots_enu_m.items() for corner in swept([slot_enu_m])]

    def refusal_of_change(self, before_enu_m: Slots, after_enu_m: Slots, lasts_s: float) -> Notice | None:
        """Separation of the new slots, and speed on straight paths to them. Paths may cross: see `crossing`."""
        if refusal := self.refusal_of_distance(after_enu_m):
            return refusal
        speed_m_s = peak_speed_m_s(before_enu_m, after_enu_m, lasts_s)
        if not speed_m_s <= self.speed_m_s + PEAK_SPEED * ROUNDING_M / lasts_s:
            text = f"slots move at up to {speed_m_s:.1f} m/s; expected at most {self.speed_m_s:g} m/s"
            return Notice(Code.SLOT_TOO_FAST, text)
        return None

    def refusal_of_distance(self, slots_enu_m: Slots) -> Notice | None:
        """Separation of any two slots of a formation."""
        if (nearest := self._nearest(slots_enu_m, slots_enu_m)) is None:
            return None
        distance_m, i, j = nearest
        return Notice(
            Code.SLOT_TOO_CLOSE,
            f"the slots of vehicles {i} and {j} come within {distance_m:.2f} m of each other;"
            f" expected at least separation_m, {self.separation_m:g} m",
        )

    def crossing(self, before_enu_m: Slots, after_enu_m: Slots) -> Notice | None:
        """The warning of paths, flown in step, that come too near: the separation filter keeps these vehicles apart."""
        if (nearest := self._nearest(before_enu_m, after_enu_m)) is None:
            return None
        distance_m, i, j = nearest
        return crossing_notice(i, j, distance_m, self.separation_m)

    def _nearest(self, before_enu_m: Slots, after_enu_m: Slots) -> tuple[float, int, int] | None:
        """(distance [m], both vehicles) of the nearest two on their paths, where that is less than `separation_m`."""
        nearest = closest_approach(self._in_separation_metric(before_enu_m), self._in_separation_metric(after_enu_m))
        return None if nearest[0] >= self.separation_m - ROUNDING_M else nearest

    def _in_separation_metric(self, slots_enu_m: Slots) -> Slots:
        return {i: to_separation_metric(slot_enu_m, self.slots_have_height) for i, slot_enu_m in slots_enu_m.items()}


def crossing_notice(i: int, j: int, distance_m: float, separation_m: float) -> Notice:
    """The warning of two vehicles whose straight paths come within this distance, although both make way."""
    return Notice(
        Code.PATHS_CROSS,
        f"straight paths of vehicles {i} and {j} come within {distance_m:.2f} m, less than separation_m {separation_m:g} m;"
        " the separation filter makes them pass each other",
    )


Tracks = Mapping[int, Sequence[Vector3]]
"""Positions over time by vehicle id, ENU metres."""


def refusal_of_tracks(tracks_enu_m: Tracks, peers: Iterable[PeerPacket], separation_m: float) -> Notice | None:
    """The refusal where a vehicle on its track comes nearer than `separation_m` to a peer that stays.

    Of a peer in hold the height counts; one that climbs or comes down is in the way at every height. A vehicle that is already
    nearer at the beginning of its track is the separation filter's matter.

    A vehicle in hold, or one that climbs, lands or returns, does not move with the formation. So its position counts, not its
    slot.
    """
    for peer in peers:
        if not stays(peer):
            continue
        has_height = peer.phase in HELD
        at = to_separation_metric(peer.motion.position_enu_m, has_height)
        for vehicle_id, track_enu_m in tracks_enu_m.items():
            points = [to_separation_metric(point, has_height) for point in track_enu_m]
            longest_m = max((dist(a, b) for a, b in pairwise(points)), default=0.0)
            if min(dist(at, point) for point in points) - longest_m >= separation_m:
                continue  # no segment comes nearer than that
            apart_m = min((_off(at, a, b) for a, b in pairwise(points)), default=dist(at, points[0]))
            if apart_m < separation_m <= dist(at, points[0]):
                return Notice(
                    Code.VEHICLE_IN_THE_WAY,
                    f"vehicle {vehicle_id} would come within {apart_m:.2f} m of vehicle {peer.sender.vehicle_id}, which is in"
                    f" phase {peer.phase}; expected at least separation_m, {separation_m:g} m",
                )
    return None


def stays(peer: PeerPacket) -> bool:
    """Whether a peer is in the air and not in formation."""
    return peer.armed and peer.phase not in STREAMING and peer.phase not in ON_GROUND


def members(own_id: int, peers: Iterable[PeerPacket]) -> list[int]:
    """The vehicles in formation, this one included."""
    return [own_id, *(peer.sender.vehicle_id for peer in peers if peer.phase is FlightPhase.FORMATION)]


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
