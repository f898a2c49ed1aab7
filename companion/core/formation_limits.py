"""What a formation that is commanded must keep: slots apart, also on the way to them, slow, and inside the fence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from companion.core.pursuit import Box
from companion.geometry.transition import ROUNDING_M, closest, fastest_m_s
from companion.geometry.turning import swept
from companion.types import Vector3

Slots = Mapping[int, Vector3]
"""d_i0 by vehicle, in ENU about the RFT."""


@dataclass(frozen=True, slots=True)
class FormationLimits:
    """Of a whole fleet. Each method says why not, or None where nothing is against it.

    `slots_turn`: about the RFT, so that they need room all round it.
    """

    separation_m: float
    speed_m_s: float  # of a slot, about the RFT
    fence: Box
    slots_turn: bool = False

    def refusal_of_places(self, slots_enu_m: Slots, rft_enu_m: Iterable[Vector3]) -> str | None:
        """About any of these places of the RFT."""
        for r_enu_m in rft_enu_m:
            for vehicle_id, slot_enu_m in self._corners(slots_enu_m):
                for axis, r, d, least, most in zip("xyz", r_enu_m, slot_enu_m, *self.fence, strict=True):
                    if not least <= r + d <= most:
                        where = f"{axis} = {r + d:.1f} m, outside the fence ({least:g} to {most:g})"
                        return f"puts vehicle {vehicle_id} at {where}"
        return None

    def _corners(self, slots_enu_m: Slots) -> list[tuple[int, Vector3]]:
        if not self.slots_turn:
            return list(slots_enu_m.items())
        return [(i, corner) for i, slot_enu_m in slots_enu_m.items() for corner in swept([slot_enu_m])]

    def refusal_of_way(self, before_enu_m: Slots, after_enu_m: Slots, lasts_s: float) -> str | None:
        """Straight and in step from the one formation to the other."""
        if refusal := self.refusal_of_distance(before_enu_m, after_enu_m):
            return refusal
        speed_m_s = fastest_m_s(before_enu_m, after_enu_m, lasts_s)
        if not speed_m_s <= self.speed_m_s:
            return f"slots move at up to {speed_m_s:.1f} m/s; expected at most {self.speed_m_s:g} m/s"
        return None

    def refusal_of_distance(self, before_enu_m: Slots, after_enu_m: Slots) -> str | None:
        """As `refusal_of_way`, however long it takes; of one formation alone where both are the same."""
        if len(after_enu_m) < 2:
            return None
        distance_m, i, j = closest(before_enu_m, after_enu_m)
        if distance_m >= self.separation_m - ROUNDING_M:
            return None
        return (
            f"the slots of vehicles {i} and {j} come within {distance_m:.2f} m of each other;"
            f" expected at least separation_m, {self.separation_m:g} m"
        )
