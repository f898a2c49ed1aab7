"""All errors of a file's content, section by section: msgspec itself stops at the first one.

msgspec decides about every value, with its types and bounds. This module walks the types, so that one wrong value does not
hide the next, and adds to each message what a person needs: the value, the allowed names, the nearest known key.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from functools import wraps
from math import isfinite
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, NoReturn, ParamSpec, TypeVar, Union, cast, get_args, get_origin

import msgspec
from msgspec import NODEFAULT, Meta, Struct
from msgspec.structs import FieldInfo, fields

from companion.types.errors import CompanionError
from companion.types.values import quoted

Arguments = ParamSpec("Arguments")
T = TypeVar("T")
BLANK_MISSING = "a blank is missing after the colon"
LISTED_UP_TO = 6  # keys of a section that an unknown key is answered with
PLAIN_WORDS = {
    "object": "a section with keys",
    "array": "a list",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "null": "nothing",
}  # what messages say instead of msgspec's names for types


class Problem(NamedTuple):
    """One error: the path of the field, like `fleet.vehicles[1].id`, and what is wrong with it.

    `accepts`: keys of the section, each with a value that would do, where they are known.
    """

    field: str
    text: str
    accepts: tuple[tuple[str, float], ...] = ()


class InvalidFieldError(CompanionError):
    """A check has used a field whose value is invalid."""


class _Invalid:
    """Takes the position of an invalid value, so that checks of the valid fields beside it can run."""


def _refuse_use(*_: object) -> NoReturn:
    raise InvalidFieldError


_USES = """getattr getitem iter len contains bool call format str hash eq ne lt le gt ge float int index abs neg
    add radd sub rsub mul rmul truediv rtruediv"""
for _name in _USES.split():
    setattr(_Invalid, f"__{_name}__", _refuse_use)
INVALID: Any = _Invalid()


def each(*checks: Iterable[T]) -> Iterator[T]:
    """The problems that independent checks find. A check ends where it needs a field that is invalid."""
    for check in checks:
        try:
            yield from check
        except InvalidFieldError:
            continue


def without_pauses(checks: Callable[Arguments, Iterator[T | None]]) -> Callable[Arguments, Iterator[T]]:
    """The same check without the None that it yields after each part of the work."""

    @wraps(checks)
    def found(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Iterator[T]:
        return (result for result in checks(*args, **kwargs) if result is not None)

    return found


def examine(data: Any, type_: Any, field: str = "") -> tuple[Any, list[Problem]]:
    """The value as this type, with INVALID in the position of what cannot be used, and all problems in it."""
    part = _part_for(data, type_)
    problems: list[Problem] = []
    value: Any = INVALID
    if wrong_kind := _wrong_tag(data, part, field):
        return INVALID, [wrong_kind]
    if _is_struct(part) and isinstance(data, dict):
        value, problems = _examine_section(data, part, field)
    elif get_origin(part) is dict and isinstance(data, dict):
        value, problems = _examine_dict(data, part, field)
    elif get_origin(part) in (tuple, list) and isinstance(data, list):
        value, problems = _examine_list(data, part, field)
    if problems and _is_struct(part):  # msgspec's message about a section is about one of its keys
        return value, problems
    if own := _own_problem(data, type_, field):
        return INVALID, [own, *problems]
    return (value, problems) if problems else (msgspec.convert(data, type_, strict=True), [])


def unless_invalid(compute: Callable[[], T]) -> T:
    """The result; INVALID if it depends on an invalid value."""
    try:
        return compute()
    except InvalidFieldError:
        return cast(T, INVALID)


def needs(value: Any) -> None:
    """Ends a check where this value is invalid: for a match statement, which would not notice."""
    if value is INVALID:
        raise InvalidFieldError


def in_file_order(data: Any, problems: Iterable[Problem]) -> list[Problem]:
    """Each problem once, in the order of the fields in the file. What is missing comes last in its section."""
    return sorted(dict.fromkeys(problems), key=lambda problem: _position(data, problem.field))


def all_finite(data: Any) -> bool:
    """False where a number anywhere inside is infinite or not a number."""
    if isinstance(data, float):
        return isfinite(data)
    if isinstance(data, dict):
        return all(map(all_finite, data.values()))
    return not isinstance(data, list) or all(map(all_finite, data))


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """A hint at the known name that is most like this one; empty where none is."""
    near = nearest(name, known)
    return f'; did you mean "{near}"?' if near else ""


def nearest(name: object, known: Iterable[str]) -> str | None:
    """The known name that is most like this one."""
    from difflib import get_close_matches  # not loaded for a file without errors

    names = sorted(known)
    near = get_close_matches(str(name), names, n=1) or [longer for longer in names if longer.startswith(f"{name}_")]
    return near[0] if near else None


# ---------------------------------------------------------------- one level of a file


def _examine_section(data: dict[Any, Any], cls: Any, field: str) -> tuple[Any, list[Problem]]:
    known = {info.encode_name: info for info in fields(cls)}
    tag_field = cls.__struct_config__.tag_field
    problems = [
        Problem(_join(field, key), "unknown key" + (_cut_in_two(key, data[key]) or _hint(field, key, known, cls)))
        for key in data
        if key not in known and key != tag_field
    ]
    values: dict[str, Any] = {}
    for key, info in known.items():
        if key in data:
            values[info.name], found = examine(data[key], info.type, _join(field, key))
            problems += found
        elif info.required:
            values[info.name] = INVALID
            problems.append(Problem(_join(field, key), "missing; this key is required"))
        else:
            values[info.name] = _default(info)
    return cls(**values), problems


def _examine_dict(data: dict[Any, Any], type_: Any, field: str) -> tuple[Any, list[Problem]]:
    key_type, value_type = get_args(type_)
    value: dict[Any, Any] = {}
    problems: list[Problem] = []
    of_keys: list[Problem] = []
    for key, item in data.items():
        examined, wrong = examine(key, key_type, _join(field, key))
        of_keys += wrong
        item_value, more = examine(item, value_type, _join(field, key))
        problems += more
        if not wrong:
            value[examined] = item_value
    if not of_keys:
        return value, problems
    return INVALID, [_of_keys(of_keys), *problems]  # without its keys no check of the section means anything


def _of_keys(problems: list[Problem]) -> Problem:
    """The first of them, which stands for all: a file with words for ids has one error, not as many as ids."""
    field, text, _ = problems[0]
    more = f" (and {len(problems) - 1} more like it)" if len(problems) > 1 else ""
    return Problem(field, f"the key {text}{more}")


def _examine_list(data: list[Any], type_: Any, field: str) -> tuple[Any, list[Problem]]:
    arguments = [item for item in get_args(type_) if item is not Ellipsis]
    items = arguments if len(arguments) == len(data) else arguments[:1] * len(data)
    examined = [
        examine(item, of, f"{field}[{index}]") for index, (item, of) in enumerate(zip(data, items, strict=True))
    ]
    return tuple(value for value, _ in examined), [problem for _, found in examined for problem in found]


def _own_problem(data: Any, type_: Any, field: str) -> Problem | None:
    """What msgspec finds in this value itself, not in the values inside it."""
    if isinstance(data, float) and not isfinite(data):
        return Problem(field, f"{data} is not a finite number")
    try:
        msgspec.convert(data, type_, strict=True)
    except msgspec.ValidationError as error:
        problem, inside, _ = str(error).partition(" - at `")
        return None if inside else Problem(field, _explain(data, type_, problem))
    return None


def _wrong_tag(data: Any, type_: Any, field: str) -> Problem | None:
    """Problem of a section of several kinds whose tag is missing or wrong."""
    kinds = [part.__struct_config__ for part in alternatives(type_) if _is_struct(part)]
    if len(kinds) < 2 or not isinstance(data, dict):
        return None
    key, tags = kinds[0].tag_field, sorted(str(kind.tag) for kind in kinds)
    if key not in data:
        hints = (_cut_in_two(name, content) for name, content in data.items() if str(name).startswith(f"{key}:"))
        return Problem(_join(field, key), f"missing; expected one of {', '.join(tags)}{next(hints, '')}")
    return Problem(
        _join(field, key), f"{quoted(data[key])}: expected one of {', '.join(tags)}{did_you_mean(data[key], tags)}"
    )


# ---------------------------------------------------------------- types


def _part_for(data: Any, type_: Any) -> Any:
    """The alternative of a type that a value is meant for: the one of the same form, for a section the one with its tag."""
    parts = alternatives(type_)
    fits: list[Any] = []
    if isinstance(data, dict):
        fits = [part for part in parts if _is_struct(part) or get_origin(part) is dict]
    elif isinstance(data, list):
        fits = [part for part in parts if get_origin(part) in (tuple, list)]
    if len(fits) > 1:
        fits = [part for part in fits if _is_struct(part) and _has_tag(data, part)]
    return fits[0] if len(fits) == 1 else type_


def alternatives(type_: Any) -> list[Any]:
    """The members of a union without their annotations; another type as the only one."""
    if get_origin(type_) is Annotated:
        return alternatives(get_args(type_)[0])
    if get_origin(type_) in (Union, UnionType):
        return [part for member in get_args(type_) for part in alternatives(member)]
    return [type_]


def _annotations(type_: Any) -> Iterator[Meta]:
    """The annotations of a type and of the members of a union, the outermost last."""
    if get_origin(type_) is Annotated:
        yield from _annotations(get_args(type_)[0])
        yield from (meta for meta in type_.__metadata__ if isinstance(meta, Meta))
    elif get_origin(type_) in (Union, UnionType):
        for member in get_args(type_):
            yield from _annotations(member)


def _is_struct(type_: Any) -> bool:
    return isinstance(type_, type) and issubclass(type_, Struct)


def _has_tag(data: dict[Any, Any], cls: Any) -> bool:
    config = cls.__struct_config__
    return bool(config.tag_field is not None and data.get(config.tag_field) == config.tag)


def _default(info: FieldInfo) -> Any:
    return info.default if info.default is not NODEFAULT else info.default_factory()


def _choices(type_: Any) -> list[str]:
    """The names that a value may be: of literals and of enumerations."""
    names: list[str] = []
    for part in alternatives(type_):
        if get_origin(part) is Literal:
            names += map(str, get_args(part))
        elif isinstance(part, type) and issubclass(part, Enum):
            names += (str(member.value) for member in part)
    return sorted(names)


def _keys_inside(type_: Any, path: str = "") -> dict[str, str]:
    """All keys of the sections inside a type, each with the first path to it."""
    paths: dict[str, str] = {}
    for part in alternatives(type_):
        inside: Iterable[tuple[Any, str]] = ((item, path) for item in get_args(part) if item is not Ellipsis)
        if get_origin(part) in (tuple, list):
            inside = [(item, f"{path}[N]") for item, _ in inside]
        elif _is_struct(part):
            inside = [(info.type, _join(path, info.encode_name)) for info in fields(part)]
            paths = {info.encode_name: _join(path, info.encode_name) for info in fields(part)} | paths
        for item, place in inside:
            if not isinstance(item, str | int | NoneType):  # arguments of a literal
                paths = _keys_inside(item, place) | paths
    return paths


# ---------------------------------------------------------------- words


def _explain(value: Any, type_: Any, problem: str) -> str:
    """msgspec's "Expected `float`, got `str`" in plain words, with the value and what is allowed."""
    if problem.startswith(("Invalid enum value", "Invalid value")) and (choices := _choices(type_)):
        return f"{quoted(value)}: expected one of {', '.join(choices)}{did_you_mean(value, choices)}"
    if "matching regex" in problem:
        formats = (meta.extra["format"] for meta in _annotations(type_) if meta.extra and "format" in meta.extra)
        if wanted := next(formats, None):
            return f"{quoted(value)}: expected {wanted}"
    text = in_plain_words(problem)
    if isinstance(value, dict | list):
        return text
    hint = _as_section(value, type_) if text.startswith(f"expected {PLAIN_WORDS['object']}") else _quotes(value, text)
    return f"{_as_in_yaml(value)}: {text.partition(', got ')[0]}{_as_yaml_number(value)}{hint}"


def in_plain_words(problem: object) -> str:
    """A message of msgspec without its names for types."""

    def named(found: re.Match[str]) -> str:
        parts = (
            re.sub(r"^\w+", lambda name: PLAIN_WORDS.get(name[0], name[0]), part) for part in found[1].split(" | ")
        )
        return " or ".join(parts)

    text = re.sub("`([^`]*)`", named, str(problem).removeprefix("Object "))
    return text[:1].lower() + text[1:]


def _as_in_yaml(value: Any) -> str:
    if value is None:
        return "empty"
    return str(value).lower() if isinstance(value, bool) else quoted(value)


def _quotes(value: Any, text: str) -> str:
    """A hint at quotes that are too many or missing."""
    if isinstance(value, str) and "number" in text and re.fullmatch(r"[-+]?\d+([.,]\d*)?", value):
        return f"; a number has a point: {value.replace(',', '.')}" if "," in value else "; a number has no quotes"
    return "; put it in quotes" if isinstance(value, int | float) and text.startswith("expected text") else ""


def _as_section(value: Any, type_: Any) -> str:
    """A hint at a section that is written as text: at the blank after its colon, or at the key that a mere name belongs to."""
    if not isinstance(value, str):
        return ""
    if re.match(r"\w+:\S", value):
        return f"; {BLANK_MISSING}"
    sections = [part for part in alternatives(type_) if _is_struct(part)]
    if any(value == part.__struct_config__.tag for part in sections):
        return f"; did you mean {{{sections[0].__struct_config__.tag_field}: {value}, ...}}?"
    named = any("name" in part.__struct_fields__ for part in sections) and re.fullmatch(r"[\w-]{1,40}", value)
    return f"; did you mean {{name: {value}}}?" if named else ""


def _cut_in_two(key: object, value: object) -> str:
    """A hint at a key without a value between braces, where YAML reads "a:b" and "1,5" otherwise than they are meant."""
    if value is None and isinstance(key, int):
        return "; a number has a point, not a comma"
    return f"; {BLANK_MISSING}" if value is None and re.match(r"\w+:\S", str(key)) else ""


def _hint(field: str, key: object, known: Iterable[str], cls: type) -> str:
    """A key of another section is named with its path: it is only in the wrong place."""
    paths = _keys_inside(cls)
    if key not in paths and (hint := did_you_mean(key, known)):
        return hint
    near = nearest(key, paths)
    if near:
        return f'; did you mean "{_join(field, paths[near])}"?'
    names = list(known)
    return f"; expected one of {', '.join(names)}" if 0 < len(names) <= LISTED_UP_TO else "; take it out"


def _as_yaml_number(value: Any) -> str:
    """YAML reads 1e9 as a string: a hint for such values."""
    found = re.fullmatch(r"([-+]?\d+)(\.\d*)?[eE]([-+]?)(\d+)", value) if isinstance(value, str) else None
    return f"; for YAML this number is {found[1]}{found[2] or '.0'}e{found[3] or '+'}{found[4]}" if found else ""


# ---------------------------------------------------------------- paths


def _join(field: str, key: object) -> str:
    return f"{field}.{key}".lstrip(".")


def _position(data: Any, field: str) -> list[int]:
    """Position of a field in a file: the index of each step of its path."""
    position = []
    for name, index in re.findall(r"([^.\[\]]+)|\[(\d{1,9})\]", field):
        keys = [str(key) for key in data] if isinstance(data, dict) else []
        at = int(index) if index else keys.index(name) if name in keys else len(keys)
        position.append(at)
        inside = list(data.values()) if isinstance(data, dict) else data if isinstance(data, list) else []
        data = inside[at] if at < len(inside) else None
    return position
