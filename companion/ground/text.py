"""Text for terminals: wrapped lines, the formation and reference of a vehicle."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Collection
from math import degrees

from companion.types.formation import EAST, FlownSlot, Heading, HeldReference
from companion.types.values import printable

WIDEST, NARROWEST = 100, 60  # columns of an answer


def wrapped(head: str, text: str) -> list[str]:
    """`head` and the text in lines of at most WIDEST columns, fewer on a narrow terminal; the text is indented below itself."""
    columns = shutil.get_terminal_size((WIDEST, 24)).columns
    width = min(WIDEST, max(NARROWEST, columns))
    return textwrap.wrap(
        printable(text),
        width,
        initial_indent=head,
        subsequent_indent=" " * min(len(head), width // 2),
        break_on_hyphens=False,
    ) or [head.rstrip()]


def count(vehicles: int) -> str:
    return f"{vehicles} vehicle{'' if vehicles == 1 else 's'}"


def id_list(vehicle_ids: Collection[int]) -> str:
    """ "vehicle 3" or "vehicles 1, 2"."""
    plural = "" if len(vehicle_ids) == 1 else "s"
    return f"vehicle{plural} {', '.join(map(str, sorted(vehicle_ids)))}"


def formation_text(slot: FlownSlot, heading: Heading) -> str:
    """ "1", "1, then 2" or "changing to 2"; with the heading where that is not east."""
    pointed = "" if heading == EAST else f" at {degrees(heading.angle_rad):.0f} deg"
    return _formation(slot) + pointed


def _formation(slot: FlownSlot) -> str:
    if slot.waiting != slot.formation:
        return f"{slot.formation}, then {slot.waiting}"
    return f"changing to {slot.formation}" if slot.moves else str(slot.formation)


def reference_text(held: HeldReference | None, target_age_s: float | None) -> str:
    """ "1" or "1, then 2", with the age of the target followed; "-" where the vehicle holds none."""
    if held is None:
        return "-"
    reference = str(held.flown) if held.waiting == held.flown else f"{held.flown}, then {held.waiting}"
    return reference if target_age_s is None else f"{reference}, target {target_age_s:.1f} s old"
