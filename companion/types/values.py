"""Plain values: vectors of the world frame, bounds of received numbers and texts, parts of messages, printable text.

msgspec enforces the bounds where a message is decoded; NaN and infinity lie outside every bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter, itemgetter
from sys import float_info
from typing import Annotated, Any, Generic, TypeVar

from msgspec import Meta, Struct, defstruct
from msgspec.structs import FieldInfo, astuple, fields

Vector3 = tuple[float, float, float]
ZERO3: Vector3 = (0.0, 0.0, 0.0)
GRAVITY_M_S2 = 9.80665


M = TypeVar("M", bound=Struct)

MAX_COORDINATE_M = 20_000.0
MAX_MISSION_S = 1e6  # eleven days
MIN_CHANGE_S, MAX_CHANGE_S = 0.1, 600.0  # duration of a formation change
MAX_VEHICLES = 250  # MAVLink system ids
MAX_NUMBER = 2**62  # largest number of a command, change or packet
FLEET_NAME = "^[a-z0-9][a-z0-9_-]{0,40}$"  # it is a part of Zenoh's key expressions
CONTROL = r"\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069"  # control characters, and those that reverse the text

VehicleId = Annotated[int, Meta(ge=1, le=MAX_VEHICLES)]
Number = Annotated[int, Meta(ge=0, le=MAX_NUMBER)]
Finite = Annotated[float, Meta(ge=-float_info.max, le=float_info.max)]
Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Position = tuple[Coordinate, Coordinate, Coordinate]
Place = tuple[Coordinate, Coordinate]  # east and north
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


LONGEST_QUOTE = 60  # characters of a value in a message


def cut(text: str, most: int = LONGEST_QUOTE) -> str:
    """The text, or the beginning of a longer one with three dots."""
    return text if len(text) <= most else text[:most] + "..."


def quoted(value: object) -> str:
    """A value of a file or an argument in a message: a message never has a whole file in it."""
    return cut(repr(value))


class Part(Struct, frozen=True, gc=False):
    """A part of a message. In bytes and in recordings its fields stand in its place, so that the message is flat."""


def flat_fields(message: type[Struct]) -> dict[str, FieldInfo]:
    """The fields of a message in the order of its bytes, by their dotted paths, with those of a part in its place.

    Fields with a default came later: they stand behind the others, those of `LATER` first.
    """
    later = getattr(message, "LATER", ())
    order = {name: index for index, name in enumerate(later)}
    paths = sorted(_paths(message), key=lambda item: 0 if item[1].required else 1 + order.get(item[1].name, len(later)))
    return dict(paths)


def _paths(message: type[Struct]) -> Iterator[tuple[str, FieldInfo]]:
    for field in fields(message):
        if _is_part(field):
            yield from ((f"{field.name}.{path}", inner) for path, inner in _paths(field.type))
        else:
            yield field.name, field


def _is_part(field: FieldInfo) -> bool:
    return isinstance(field.type, type) and issubclass(field.type, Part)


def maker(message: type[M]) -> Callable[[Sequence[Any]], M]:
    """Makes the message of its values in the order of `flat_fields`."""
    return _maker(message, "", {path: index for index, path in enumerate(flat_fields(message))})


def _maker(message: type[M], prefix: str, index: Mapping[str, int]) -> Callable[[Sequence[Any]], M]:
    getters = [
        _maker(field.type, f"{prefix}{field.name}.", index)
        if _is_part(field)
        else itemgetter(index[prefix + field.name])
        for field in fields(message)
    ]
    return lambda values: message(*[get(values) for get in getters])


class FlatForm(Generic[M]):
    """A message as the struct `type`, which has the fields of the parts in their place: so it is in bytes."""

    def __init__(self, message: type[M]) -> None:
        found = flat_fields(message)
        self.type: type[Any] = defstruct(
            message.__name__,
            [(field.name, field.type, *(() if field.required else (field.default,))) for field in found.values()],
            frozen=True,
            gc=False,
        )
        self._values = attrgetter(*found)
        self._make = maker(message)

    def flat(self, message: M) -> Any:
        return self.type(*self._values(message))

    def whole(self, flat: Any) -> M:
        return self._make(astuple(flat))
