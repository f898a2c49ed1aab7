"""Limits of a commanded formation: separation of slots and of the paths to them, speed, fence and obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import hypot

from companion.core.reference.blend import reference_box
from companion.core.reference.room import Box
from companion.geometry.airspace import Airspace
from companion.geometry.clear_path import leg_conflict_steps, nearest_kind
from companion.geometry.curves import PEAK_SPEED
from companion.geometry.separation import counted
from companion.geometry.transition import ROUNDING_M, closest_approach, peak_speed_m_s
from companion.geometry.turning import reach_m, swept
from companion.geometry.vectors import plus
from companion.types.notices import Code, Notice
from companion.types.steps import Steps, coarser, whole
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
    speed_m_s: float  # of a slot relative to the RFT
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

    def refusal_of_airspace(
        self, before_enu_m: Slots, after_enu_m: Slots, on_the_way_enu_m: Iterable[Vector3], rft_enu_m: Iterable[Vector3]
    ) -> Notice | None:
        """Polygon and obstacles: straight paths between the slots about some positions of the RFT, and the slots about all."""
        return whole(self.airspace_steps(before_enu_m, after_enu_m, on_the_way_enu_m, rft_enu_m))

    def airspace_steps(
        self, before_enu_m: Slots, after_enu_m: Slots, on_the_way_enu_m: Iterable[Vector3], rft_enu_m: Iterable[Vector3]
    ) -> Steps[Notice | None]:
        """`refusal_of_airspace` in steps."""
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
        nearest = closest_approach(self._counted(before_enu_m), self._counted(after_enu_m))
        return None if nearest[0] >= self.separation_m - ROUNDING_M else nearest

    def _counted(self, slots_enu_m: Slots) -> Slots:
        return {i: counted(slot_enu_m, self.slots_have_height) for i, slot_enu_m in slots_enu_m.items()}


def crossing_notice(i: int, j: int, distance_m: float, separation_m: float) -> Notice:
    """The warning of two vehicles whose straight paths come within this distance, although both make way."""
    return Notice(
        Code.PATHS_CROSS,
        f"straight paths of vehicles {i} and {j} come within {distance_m:.2f} m, less than separation_m {separation_m:g} m;"
        " the separation filter makes them pass each other",
    )
