"""Plain values: vectors of the world frame, bounds of received numbers and texts, parts of messages, printable text.

msgspec enforces the bounds where a message is decoded; NaN and infinity lie outside every bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from sys import float_info
from typing import Annotated, Any, TypeVar

from msgspec import Meta, Struct
from msgspec.structs import fields

Vector3 = tuple[float, float, float]
ZERO3: Vector3 = (0.0, 0.0, 0.0)
GRAVITY_M_S2 = 9.80665


M = TypeVar("M", bound=Struct)

MAX_COORDINATE_M = 20_000.0
MAX_MISSION_S = 1e6  # eleven days
MIN_CHANGE_S, MAX_CHANGE_S = 0.1, 600.0  # duration of a formation change
MAX_VEHICLES = 250  # MAVLink system ids
MAX_NUMBER = 2**62  # of commands, changes and packets
FLEET_NAME = "^[a-z0-9][a-z0-9_-]{0,40}$"  # it is a part of Zenoh's key expressions
CONTROL = r"\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069"  # control characters, and those that reverse the text

VehicleId = Annotated[int, Meta(ge=1, le=MAX_VEHICLES)]
Number = Annotated[int, Meta(ge=0, le=MAX_NUMBER)]
Finite = Annotated[float, Meta(ge=-float_info.max, le=float_info.max)]
Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Position = tuple[Coordinate, Coordinate, Coordinate]
FiniteVector = tuple[Finite, Finite, Finite]
MissionTime = Annotated[float, Meta(ge=0, le=MAX_MISSION_S)]
ChangeDuration = Annotated[float, Meta(ge=0, le=MAX_CHANGE_S)]
SlotOfVehicle = tuple[VehicleId, Position]
SlotsOfAll = Annotated[tuple[SlotOfVehicle, ...], Meta(max_length=MAX_VEHICLES)]
VehicleIds = Annotated[tuple[VehicleId, ...], Meta(max_length=MAX_VEHICLES)]
FleetName = Annotated[str, Meta(pattern=rf"{FLEET_NAME[:-1]}\Z")]
Word = Annotated[str, Meta(max_length=80, pattern=f"^[^{CONTROL}]*$")]  # a name or a key
Line = Annotated[str, Meta(max_length=2000, pattern=f"^[^{CONTROL}]*$")]  # a sentence, shown on a terminal


def printable(text: str) -> str:
    """The text in one line, with ? for each character that could control a terminal or reverse the text."""
    return "".join(c if c.isprintable() else "?" for c in text)


def printable_lines(text: str) -> str:
    """The same for a text of several lines."""
    return "\n".join(map(printable, text.split("\n")))


class Part(Struct, frozen=True, gc=False):
    """A part of a message. In bytes and in recordings its fields stand in its place, so that the message is flat."""


def flat_paths(message: type[Struct]) -> dict[str, type]:
    """The fields of a message in the order of its bytes: dotted path -> type, with the fields of a part in its place."""
    paths: dict[str, type] = {}
    for field in fields(message):
        if isinstance(field.type, type) and issubclass(field.type, Part):
            paths |= {f"{field.name}.{path}": kind for path, kind in flat_paths(field.type).items()}
        else:
            paths[field.name] = field.type
    return paths


def from_flat(message: type[M], values: Iterator[Any]) -> M:
    """The message of its values in the order of `flat_paths`."""
    return message(
        *[
            from_flat(field.type, values)
            if isinstance(field.type, type) and issubclass(field.type, Part)
            else next(values)
            for field in fields(message)
        ]
    )
