"""Structs as arrays, for JSON that is small and exact: [value of each field, in the order of the type].

Made once from the type. An item of a union begins with the name of its type. `false` stands for None, so that `null` can only
be a number that JSON does not have, NaN or infinity: msgspec writes each as null. A message with any of them begins with the
key `not_finite`: what each null stands for, in the order of the message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from operator import attrgetter
from types import NoneType, UnionType
from typing import Annotated, Any, Generic, TypeVar, Union, get_args, get_origin

import msgspec
from msgspec import Struct
from msgspec.structs import astuple

from companion.types.values import flat_fields, maker

T = TypeVar("T")
Convert = Callable[[Any], Any]


class Form(Generic[T]):
    """How values of one type are written.

    `pack` makes lists, tuples and plain values of one, and is None where the value is written as it is. `wire` is the type by
    which msgspec decodes that, `unpack` makes the value of it.
    """

    def __init__(self, pack: Convert | None, wire: Any, unpack: Convert | None) -> None:
        self.pack = pack
        self.wire = wire
        self.unpack = unpack


def form_of(type_: Any, named: Mapping[str, type]) -> Form[Any]:
    """The form of a type. `named` are the classes that may occur as values themselves, by their names."""
    return _Forms(named).of(type_)


class _Forms:
    def __init__(self, named: Mapping[str, type]) -> None:
        self._named = named
        self._structs: dict[tuple[type, bool], Form[Any]] = {}

    def of(self, type_: Any) -> Form[Any]:
        origin = get_origin(type_)
        if origin is Annotated:
            return self._bounded(type_)
        if origin in (Union, UnionType):
            return self._union(get_args(type_))
        if origin is tuple:
            return self._tuple(get_args(type_))
        if origin in (list, dict):
            inner = [self.of(part) for part in get_args(type_)]
            assert all(form.pack is None for form in inner), f"{type_}: only plain values"
            return Form(None, origin[tuple(form.wire for form in inner)], None)
        if isinstance(type_, type) and issubclass(type_, Struct):
            return self._struct(type_, tagged=False)
        if type_ is type:
            return Form(lambda value: value.__name__, str, lambda name: self._named[name])
        return Form(None, type_, None)

    def _bounded(self, type_: Any) -> Form[Any]:
        """Bounds of numbers that count and of lengths stay; a float may be any, and a text was checked where it came from."""
        form = self.of(type_.__origin__)
        if form.wire in (float, str):
            return form
        return Form(form.pack, Annotated[(form.wire, *type_.__metadata__)], form.unpack)

    def _tuple(self, parts: tuple[Any, ...]) -> Form[Any]:
        if len(parts) == 2 and parts[1] is Ellipsis:
            item = self.of(parts[0])
            pack, unpack = item.pack, item.unpack
            return Form(
                pack and (lambda values: [pack(value) for value in values]),
                tuple[item.wire, ...],  # type: ignore[name-defined]
                unpack and (lambda values: tuple(unpack(value) for value in values)),
            )
        inner = [self.of(part) for part in parts]
        assert all(form.pack is None for form in inner), f"{parts}: only plain values"
        return Form(None, tuple[tuple(form.wire for form in inner)], None)  # type: ignore[misc]

    def _union(self, parts: tuple[Any, ...]) -> Form[Any]:
        """One type or None; several Structs, by their names; or plain values."""
        optional = NoneType in parts
        inner = [part for part in parts if part is not NoneType]
        structs = [part for part in inner if isinstance(part, type) and issubclass(part, Struct)]
        if len(inner) == 1:
            form = self.of(inner[0])
        elif structs:
            assert len(structs) == len(inner), f"{parts}: Structs and other values"
            form = self._any_of(structs)
        else:
            forms = [self.of(part) for part in inner]
            assert all(one.pack is None for one in forms) and not optional, f"{parts}: only plain values"
            return Form(None, Union[tuple(one.wire for one in forms)], None)  # noqa: UP007 -- made of a list
        return _optional(form) if optional else form

    def _any_of(self, types: list[type]) -> Form[Any]:
        forms = {type_: self._struct(type_, tagged=True) for type_ in types}
        packs = {type_: form.pack for type_, form in forms.items()}
        unpacks = {form.wire: form.unpack for form in forms.values()}
        return Form(
            lambda value: packs[type(value)](value),  # type: ignore[misc]
            Union[tuple(form.wire for form in forms.values())],  # noqa: UP007 -- made of a list
            lambda value: unpacks[type(value)](value),  # type: ignore[misc]
        )

    def _struct(self, type_: type[Struct], tagged: bool) -> Form[Any]:
        if (type_, tagged) not in self._structs:
            self._structs[type_, tagged] = self._new_struct(type_, tagged)
        return self._structs[type_, tagged]

    def _new_struct(self, type_: type[Struct], tagged: bool) -> Form[Any]:
        found = flat_fields(type_)
        values_of = attrgetter(*found) if any("." in path for path in found) else astuple
        make, forms = maker(type_), [(field.name, self.of(field.type)) for field in found.values()]
        packs = [(i, form.pack) for i, (_, form) in enumerate(forms) if form.pack]
        unpacks = [(i, form.unpack) for i, (_, form) in enumerate(forms) if form.unpack]
        wire = msgspec.defstruct(
            type_.__name__,
            [(name, form.wire) for name, form in forms],
            array_like=True,
            tag=type_.__name__ if tagged else None,
            forbid_unknown_fields=True,
            frozen=True,
        )
        tag = (type_.__name__,)

        def pack(value: Struct) -> Any:
            values = list(values_of(value))
            for i, convert in packs:
                values[i] = convert(values[i])
            return values

        def unpack(value: Struct) -> Struct:
            values = list(astuple(value))
            for i, convert in unpacks:
                values[i] = convert(values[i])
            return make(values)

        packed: Convert = pack if packs else values_of
        if tagged:
            untagged = packed
            packed = lambda value: (*tag, *untagged(value))  # noqa: E731
        return Form(packed, wire, unpack)


def _optional(form: Form[Any]) -> Form[Any]:
    pack, unpack = form.pack, form.unpack
    return Form(
        lambda value: False if value is None else pack(value) if pack else value,
        form.wire | bool if isinstance(form.wire, type) else Union[form.wire, bool],  # noqa: UP007
        lambda value: None if value is False else unpack(value) if unpack else value,
    )


KEY = "not_finite"
START = b'{"' + KEY.encode() + b'":'

_encoder = msgspec.json.Encoder()
_decoder = msgspec.json.Decoder()


def encode_exact(record: dict[str, Any]) -> bytes:
    """The record as JSON. Its values are plain, and none of them is None."""
    data = _encoder.encode(record)
    if b"null" in data and (numbers := _not_finite(record)):
        return _encoder.encode({KEY: [repr(number) for number in numbers], **record})
    return data


def has_not_finite(data: bytes) -> bool:
    """Whether `decode_exact` is needed."""
    return data.startswith(START)


def decode_exact(data: bytes) -> Any:
    """The plain content of a message with numbers that are not finite. Raises ValueError, as msgspec's errors are."""
    record = _decoder.decode(data)
    stand_for = record.pop(KEY)
    if not isinstance(stand_for, list) or any(number not in ("nan", "inf", "-inf") for number in stand_for):
        raise ValueError(f"{KEY}: expected a list of nan, inf and -inf")
    numbers = [float(number) for number in reversed(stand_for)]
    restored = _restored(record, numbers)
    if numbers:
        raise ValueError(f"{KEY}: more numbers than nulls")
    return restored


def _not_finite(value: Any) -> list[float]:
    if isinstance(value, float):
        return [] if isfinite(value) else [value]
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, list | tuple):
        return []
    return [number for item in value for number in _not_finite(item)]


def _restored(value: Any, numbers: list[float]) -> Any:
    """The value with the last of the numbers for its first null, and so on."""
    if value is None:
        if not numbers:
            raise ValueError(f"{KEY}: fewer numbers than nulls")
        return numbers.pop()
    if isinstance(value, dict):
        return {key: _restored(item, numbers) for key, item in value.items()}
    if isinstance(value, list):
        return [_restored(item, numbers) for item in value]
    return value
