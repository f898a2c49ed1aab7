"""Values of a Struct as the cells of a table: one column for each number, with its unit in its name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from typing import Annotated, Any, Union, get_args, get_origin

from msgspec import Struct
from msgspec.structs import fields

Getter = Callable[[Any], Any]
AXES = ("east", "north", "up")
NoneType = type(None)


class Table:
    """The columns of a type. Nested values have the names of their fields in theirs; what is None leaves its cells empty."""

    def __init__(self, type_: type[Struct]) -> None:
        columns = list(_of_struct(type_, ""))
        self.names = tuple(name for name, _ in columns)
        self._getters = tuple(getter for _, getter in columns)

    def cells(self, value: Struct) -> list[Any]:
        return [getter(value) for getter in self._getters]


def _of_struct(type_: type[Struct], prefix: str) -> Iterator[tuple[str, Getter]]:
    for field in fields(type_):
        own = _attribute(field.name)
        for name, getter in _columns(field.type, f"{prefix}{field.name}"):
            yield name, _chained(own, getter)


def _columns(type_: Any, name: str) -> Iterator[tuple[str, Getter]]:
    """Columns of a value with this name, each with what makes its cell of the value."""
    origin, parts = get_origin(type_), get_args(type_)
    if origin is Annotated:
        yield from _columns(parts[0], name)
    elif origin is Union or type_.__class__.__name__ == "UnionType":
        inner = [part for part in parts if part is not NoneType]
        for column, getter in _columns(inner[0], name):
            yield column, _unless_none(getter)
    elif isinstance(type_, type) and issubclass(type_, Struct):
        yield from _of_struct(type_, f"{name}_")
    elif origin is tuple and len(parts) == len(AXES) and "_enu_" in name:
        for index, axis in enumerate(AXES):
            yield name.replace("_enu_", f"_{axis}_"), _item(index)
    else:
        yield name, _cell


def _attribute(name: str) -> Getter:
    return lambda value: getattr(value, name)


def _chained(first: Getter, then: Getter) -> Getter:
    return lambda value: then(first(value))


def _unless_none(getter: Getter) -> Getter:
    return lambda value: "" if value is None else getter(value)


def _item(index: int) -> Getter:
    return lambda value: value[index]


def _cell(value: Any) -> Any:
    """A list as its items with spaces between them, a count by key as its sum, a yes or no as 1 or 0."""
    if isinstance(value, tuple | list):
        return " ".join(str(_cell(item)) for item in value)
    if isinstance(value, Mapping):
        return sum(value.values())
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, bool):
        return int(value)
    return value
