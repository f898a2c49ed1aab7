"""Latitude and longitude where metres are expected: a warning about what a file, or a command, holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import dist
from typing import Any, Literal

from msgspec import Struct

from companion.config.fleet import GeodeticOrigin
from companion.types.notices import Code, Notice

NEAR_ORIGIN_DEG = 0.5
LOOKS, METRES = "looks like latitude and longitude", "metres east, north and up"
Origin = GeodeticOrigin | Literal["indoor"]
POSITIONS = "_enu_m"  # the end of each key that has one or more


def degree_notices(origin: Origin, content: Any, where: str = "") -> Iterator[Notice]:
    """A warning about the positions in this content that look like latitude and longitude near the origin.

    `where` is the path of the content in its file, like "fleet".
    """
    found = [(key, position) for key, position in _positions(content, where) if _is_in_degrees(origin, position)]
    if found:
        key, position = found[0]
        more = f", and {len(found) - 1} more" if len(found) > 1 else ""
        yield Notice(Code.LOOKS_LIKE_DEGREES, f"{key}: {list(position)} {LOOKS}{more}; expected {METRES}")


def degree_hint(origin: Origin, *positions_enu_m: tuple[float, ...]) -> str:
    """The end of a refusal that is because of these positions; empty where none is in degrees."""
    in_degrees = any(_is_in_degrees(origin, position) for position in positions_enu_m)
    return f"; it {LOOKS}; expected {METRES}" if in_degrees else ""


def _is_in_degrees(origin: Origin, position_enu_m: tuple[float, ...]) -> bool:
    """Both of its first numbers have four decimals or more and are near those of the origin, in any order."""
    if not isinstance(origin, GeodeticOrigin):
        return False
    pair = position_enu_m[:2]
    of_origin = (origin.latitude_deg, origin.longitude_deg)
    near = any(dist(pair, place) < NEAR_ORIGIN_DEG for place in (of_origin, of_origin[::-1]))
    return near and all(round(number, 3) != number for number in pair)


def _positions(content: Any, key: str) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Each position (x, y) or (x, y, z) below a key of positions, with the path of that key."""
    inside: list[tuple[str, Any]] = []
    if isinstance(content, Struct):
        inside = [(f"{key}.{name}", getattr(content, name)) for name in content.__struct_fields__]
    elif isinstance(content, Mapping):
        inside = [(f"{key}.{name}", value) for name, value in content.items()]
    elif isinstance(content, tuple | list):
        if content and isinstance(content[0], float):
            if POSITIONS in key:
                yield key.removeprefix("."), tuple(content)
            return
        inside = [(f"{key}[{index}]", value) for index, value in enumerate(content)]
    for name, value in inside:
        yield from _positions(value, name)
