"""One YAML file -> one validated type, or one line that says which file, field and value, and what was expected."""

from __future__ import annotations

import re
from collections.abc import Hashable
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml
from msgspec.inspect import (
    DictType,
    EnumType,
    ListType,
    LiteralType,
    Metadata,
    StructType,
    TupleType,
    Type,
    UnionType,
    VarTupleType,
)

MAX_DEPTH = 50  # levels of a file; ours have five

T = TypeVar("T")


class ConfigError(Exception):
    """A file that cannot be used. str() is one line: file, field, value, what was expected, what to do."""

    def __init__(self, file: Path | str, field: str, problem: str) -> None:
        super().__init__(f"{file}: {field}: {problem}" if field else f"{file}: {problem}")


def load(path: Path, type_: type[T]) -> T:
    """Read a YAML file into a msgspec type. Raises ConfigError."""
    return convert(path, read_yaml(path), type_)


def read_yaml(path: Path) -> Any:
    """The plain content of a YAML file. Raises ConfigError; a key that stands twice is an error, too."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, "", f"cannot be read: {error.strerror}; check the path") from error
    except UnicodeDecodeError as error:
        raise ConfigError(path, "", f"is not UTF-8 text (byte {error.start})") from error
    try:
        return yaml.load(text, Loader=StrictLoader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigError(path, line, f"not valid YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise ConfigError(path, "", "not valid YAML: " + " ".join(str(error).split())) from error


def convert(path: Path, data: Any, type_: type[T]) -> T:
    """Plain content -> type. `path` only names the file in errors. Raises ConfigError."""
    if data is None:
        raise ConfigError(path, "", "is empty")
    _refuse_non_finite(path, data, "")
    try:
        return msgspec.convert(data, type_, strict=True)
    except msgspec.ValidationError as error:
        raise _explain(path, data, type_, str(error)) from error


def _refuse_non_finite(path: Path, data: Any, where: str) -> None:
    if isinstance(data, float) and not isfinite(data):
        raise ConfigError(path, where, f"{data} is not a finite number")
    if isinstance(data, dict):
        for key, value in data.items():
            _refuse_non_finite(path, value, f"{where}.{key}".lstrip("."))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            _refuse_non_finite(path, value, f"{where}[{index}]")


def _explain(path: Path, data: Any, type_: type, message: str) -> ConfigError:
    """msgspec's "Expected `float`, got `str` - at `$.law.gains`" with the value, and the nearest key for an unknown one."""
    problem, _, place = message.partition(" - at `")
    field = place.rstrip("`").removeprefix("$").removeprefix(".")
    unknown = re.search(r"unknown field `(.*)`", problem)
    if unknown:
        key = unknown[1]
        near = get_close_matches(key, sorted(_field_names(msgspec.inspect.type_info(type_))), n=1)
        hint = f'; did you mean "{near[0]}"?' if near else "; take it out"
        return ConfigError(path, f"{field}.{key}".lstrip("."), "unknown key" + hint)
    missing = re.search(r"missing required field `(.*)`", problem)
    if missing:
        return ConfigError(path, f"{field}.{missing[1]}".lstrip("."), "missing; this key is required")
    value = _value_at(data, field)
    if problem.startswith(("Invalid enum value", "Invalid value")):
        choices = sorted(_choices_at(msgspec.inspect.type_info(type_), field))
        near = get_close_matches(str(value), choices, n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ""
        return ConfigError(path, field, f"{value!r}: expected one of {', '.join(choices)}{hint}")
    if "matching regex" in problem and (wanted := _description_at(msgspec.inspect.type_info(type_), field)):
        return ConfigError(path, field, f"{value!r}: expected {wanted}")
    shown = "" if isinstance(value, dict | list) else f"{value!r}: "
    said = problem.replace("`object`", "a section with keys").replace("`array`", "a list").replace("`", "")
    return ConfigError(path, field, shown + said[:1].lower() + said[1:] + _as_yaml_number(value))


def _as_yaml_number(value: Any) -> str:
    """YAML takes 1e9 for a word: a hint for such values."""
    found = re.fullmatch(r"([-+]?\d+)(\.\d*)?[eE]([-+]?)(\d+)", value) if isinstance(value, str) else None
    return f"; for YAML this number is {found[1]}{found[2] or '.0'}e{found[3] or '+'}{found[4]}" if found else ""


def _steps(field: str) -> list[str | int]:
    """ "law.gains[0]" -> ["law", "gains", 0]."""
    found = re.findall(r"([^.\[\]]+)|\[(\d+)\]", field)
    return [int(index) if index else name for name, index in found]


def _value_at(data: Any, field: str) -> Any:
    """Follow a field's path into plain content; an empty dict where it does not lead anywhere."""
    for step in _steps(field):
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return {}
    return data


def _choices_at(node: Type, field: str) -> set[str]:
    """The words that are allowed at a field's path."""
    nodes = [node]
    for step in _steps(field):
        nodes = [inner for node in nodes for part in _alternatives(node) for inner in _inside(part, step)]
    choices: set[str] = set()
    for part in (part for node in nodes for part in _alternatives(node)):
        if isinstance(part, LiteralType):
            choices.update(str(value) for value in part.values)
        elif isinstance(part, EnumType):
            choices.update(str(member.value) for member in part.cls)
    return choices


def _description_at(node: Type, field: str) -> str | None:
    """What a type's own words say that is expected at a field's path."""
    nodes = [node]
    for step in _steps(field):
        nodes = [inner for node in nodes for part in _alternatives(node) for inner in _inside(part, step)]
    parts = (part for node in nodes for part in (node.types if isinstance(node, UnionType) else (node,)))
    described = (part for part in parts if isinstance(part, Metadata) and part.extra_json_schema)
    return next((str(node.extra_json_schema["description"]) for node in described if node.extra_json_schema), None)


def _alternatives(node: Type) -> list[Type]:
    """The parts of a union; a type with bounds on it as itself."""
    if isinstance(node, UnionType):
        return [inner for part in node.types for inner in _alternatives(part)]
    if isinstance(node, Metadata):
        return _alternatives(node.type)
    return [node]


def _inside(node: Type, step: str | int | None) -> list[Type]:
    """The types one step further inside; all of them for None."""
    if isinstance(node, StructType):
        if step is not None and step == node.tag_field:
            return [LiteralType((node.tag,))]
        return [field.type for field in node.fields if step is None or field.encode_name == step]
    if isinstance(node, DictType):
        return [node.value_type]
    if isinstance(node, VarTupleType | ListType):
        return [node.item_type]
    if isinstance(node, TupleType):
        return list(node.item_types)
    return []


def _field_names(node: Type, seen: frozenset[type] = frozenset()) -> set[str]:
    """All keys that a type and the types inside it know."""
    names: set[str] = set()
    for part in _alternatives(node):
        if isinstance(part, StructType):
            if part.cls in seen:
                continue
            seen |= {part.cls}
            names.update(field.encode_name for field in part.fields)
        for inner in _inside(part, None):
            names |= _field_names(inner, seen)
    return names


class StrictLoader(yaml.SafeLoader):
    """SafeLoader, whose every refusal is a yaml.MarkedYAMLError.

    SafeLoader keeps the last of two equal keys in silence; here that is an error. So is what contains itself.
    """

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._open_anchors: list[str | None] = []  # of the nodes around the one that is being read

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        anchor, mark = getattr(event, "anchor", None), event.start_mark
        if isinstance(event, yaml.AliasEvent) and anchor in self._open_anchors:
            raise yaml.constructor.ConstructorError(None, None, f"&{anchor} contains itself", mark)
        if len(self._open_anchors) >= MAX_DEPTH:
            problem = f"more than {MAX_DEPTH} levels inside each other"
            raise yaml.constructor.ConstructorError(None, None, problem, mark)
        self._open_anchors.append(anchor)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._open_anchors.pop()
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        problem = f"not a {node.tag.rpartition(':')[2]} that can be used"
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, LookupError, AttributeError) as error:  # "!!float foo", "!!bool maybe", 2024-13-45
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from error
        if isinstance(value, int) and value.bit_length() > 64:  # Python would refuse to print thousands of digits
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                problem = "a list or a mapping cannot be a key; is a pair of braces meant to be brackets?"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f'key "{key}" stands twice', key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)
