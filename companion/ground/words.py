"""How the ground says which formation and which reference a vehicle flies. Pure."""

from __future__ import annotations

from math import degrees

from companion.types import EAST, FlownSlot, Heading, HeldReference


def formation_in_words(slot: FlownSlot, heading: Heading) -> str:
    """ "1", "1, 2 to come", or "on the way to 2"; and where it points, if that is not to the east."""
    pointed = "" if heading == EAST else f" at {degrees(heading.angle_rad):.0f} deg"
    return _formation(slot) + pointed


def _formation(slot: FlownSlot) -> str:
    if slot.waiting != slot.formation:
        return _to_come(slot.formation, slot.waiting)
    return str(slot.formation) if not slot.moves else f"on the way to {slot.formation}"


def reference_in_words(held: HeldReference | None, target_age_s: float | None) -> str:
    """ "1", "1, 2 to come", with how old the word of a target is that it follows; "-" where it holds none."""
    if held is None:
        return "-"
    reference = str(held.flown) if held.waiting == held.flown else _to_come(held.flown, held.waiting)
    return reference if target_age_s is None else f"{reference}, target {target_age_s:.1f} s old"


def _to_come(now: int, then: int) -> str:
    return f"{now}, {then} to come"
