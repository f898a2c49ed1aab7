"""The configuration reference as Markdown, from the types of the files: python docs/generate/configuration.py > FILE."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from msgspec import NODEFAULT, Meta, Struct, to_builtins
from msgspec.structs import FieldInfo, fields

from companion.config.fleet import FleetConfig, FleetSettings
from companion.config.fleet_check import SlotsSection
from companion.config.planned_flight import ScenarioFleet
from companion.config.reference import Reference, ReferenceSection
from companion.config.values import PositionM, Section
from companion.config.vehicle import VehicleConfig
from companion.ground.mocap.file import MocapFile
from sitl.flight.external import ExternalFile
from sitl.flight.scenario import ScenarioFile
from sitl.vehicle.config import AutopilotFile

HEAD = """\
# Configuration reference

All files are YAML. Lengths are in metres in the fleet frame, ENU: x east, y north, z up. The unit
of a number is in the name of its key. A file with an unknown key, a missing key or a value out of
bounds is refused, with one line for each error. `sitl new` and `companion init` write first files.

This page is generated from the types: `make docs`.
"""
FILES: tuple[tuple[str, str, type[Struct]], ...] = (
    (
        "Fleet file",
        "`companion fleet --fleet FILE`, and named by each vehicle file. All vehicles have the same.",
        FleetConfig,
    ),
    ("Vehicle file", "`companion agent --config FILE`, one for each vehicle.", VehicleConfig),
    ("Scenario file", "`sitl run FILE`, `sitl fly FILE`, `companion analyze FILE`.", ScenarioFile),
    ("External file", "`sitl fly --external FILE`: autopilots that another program has started.", ExternalFile),
    ("Slots file", "`companion fleet formation --slots FILE`.", SlotsSection),
    ("Reference file", "`companion fleet reference --file FILE`.", ReferenceSection),
    ("Camera file", "`companion mocap run FILE`: a motion-capture system and its rigid bodies.", MocapFile),
    ("Stand-in file", "`sitl autopilot --config FILE`: one simulated vehicle by itself.", AutopilotFile),
)
UNITS = {  # by the end of a key, the longest first
    "_n_per_m_s": "N/(m/s)", "_kg_m2": "kg m²", "_rad_s": "rad/s", "_deg_s": "deg/s", "_1_s2": "1/s²", "_m_s2": "m/s²",
    "_percent": "%", "percent": "%", "_norm": "0 to 1", "_m_s": "m/s", "_1_s": "1/s", "_deg": "deg", "_kg": "kg", "_m": "m",
    "_s": "s",
}  # fmt: skip
KEY = re.compile(r"^([a-z]\w*): ", re.MULTILINE)  # before what a docstring says of a key
NUMBER_WORDS = {float: "number", int: "integer", str: "text", bool: "`true` or `false`"}


@dataclass(slots=True)
class Value:
    """What a type accepts: its name, bounds, description and the sections inside it."""

    names: list[str] = field(default_factory=list)
    bounds: list[str] = field(default_factory=list)
    meaning: str = ""
    sections: list[type[Struct]] = field(default_factory=list)


def configuration() -> str:
    """The whole page."""
    return "\n".join([HEAD, *(line for title, use, cls in FILES for line in _file(title, use, cls))]).rstrip() + "\n"


def _file(title: str, use: str, cls: type[Struct]) -> Iterator[str]:
    """A heading, the table of the file's own keys, and one table for each section in it that no file before has."""
    yield from (f"## {title}", "", use, "", *_table(cls))
    for section in _sections_of(cls):
        if section not in _described_before(cls):
            yield from (f"### {_title(section)}", "", *_purpose(section), "", *_table(section))


def _described_before(cls: type[Struct]) -> set[type[Struct]]:
    roots = [root for _, _, root in FILES]
    return {section for root in roots[: roots.index(cls)] for section in _sections_of(root)}


def _sections_of(cls: type[Struct]) -> list[type[Struct]]:
    """All sections inside, in the order in which they appear, each once."""
    found: dict[type[Struct], None] = {}
    for info in fields(cls):
        for section in _value(info.type).sections:
            found |= dict.fromkeys([section, *_sections_of(section)])
    return list(found)


def _purpose(cls: type[Struct]) -> list[str]:
    tag = cls.__struct_config__
    kind = [f"`{tag.tag_field}: {tag.tag}`. "] if tag.tag is not None else [""]
    others = " All other keys are those of the [fleet file](#fleet-file)." if cls is ScenarioFleet else ""
    return textwrap.wrap(kind[0] + _docstring(cls).replace("\n\n", " ") + others, 100)


def _table(cls: type[Struct]) -> list[str]:
    keys = [
        info for info in fields(cls) if cls is not ScenarioFleet or info.name not in FleetSettings.__struct_fields__
    ]
    meanings = _meanings(cls)
    rows = [_row(info, meanings.get(info.name, "")) for info in sorted(keys, key=lambda info: not info.required)]
    return ["| key | type | unit | bounds | default | meaning |", "|---|---|---|---|---|---|", *rows, ""]


def _row(info: FieldInfo, meaning: str) -> str:
    value = _value(info.type)
    of_section = _docstring(value.sections[0]).splitlines()[0].rstrip(".") if value.sections else ""
    meaning = meaning or value.meaning or of_section
    cells = (
        f"`{info.encode_name}`", " or ".join(value.names), _unit(info.encode_name), ", ".join(value.bounds),
        _default(info), meaning,
    )  # fmt: skip
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _unit(key: str) -> str:
    core = key.replace("_enu_", "_") if "_enu_" in key else key
    return next((unit for end, unit in UNITS.items() if core.endswith(end)), "")


def _default(info: FieldInfo) -> str:
    if info.required:
        return "required"
    value = info.default if info.default is not NODEFAULT else info.default_factory()
    if value is None:
        return ""
    if isinstance(value, Struct) and not any(part.required for part in fields(type(value))):
        return "as below"
    if isinstance(value, tuple) and value and isinstance(value[0], Struct):
        return "see meaning"
    return f"`{_yaml(to_builtins(value))}`"


def _yaml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_yaml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return '""' if value == "" else str(value)


def _value(type_: Any) -> Value:
    """What an annotation accepts; the outermost description is the one of the field."""
    origin, arguments = get_origin(type_), get_args(type_)
    if type_ in (Reference, Reference | None):
        return Value(["[reference](#reference-file)"], sections=list(get_args(Reference)))
    if origin is Annotated:
        value = _value(arguments[0])
        for meta in arguments[1:]:
            if isinstance(meta, Meta):
                value.bounds += _bounds(meta, "characters" if value.names == ["text"] else "entries")
                value.meaning = meta.description or value.meaning
        return value
    if origin in (Union, UnionType):
        return _union([_value(part) for part in arguments if part is not NoneType])
    if origin is Literal:
        return Value([_choices(map(str, arguments))])
    if type_ == PositionM:
        return Value(["[x, y, z]"], _value(arguments[0]).bounds)
    if type_ == dict[str, Any]:
        return Value(["some of these keys"])
    if origin in (tuple, list):
        return _list([_value(part) for part in arguments if part is not Ellipsis], Ellipsis in arguments)
    if origin is dict:
        key, item = (_value(part) for part in arguments)
        name = "ID" if "integer" in key.names else "NAME"
        return Value([f"section of `{name}: {' or '.join(item.names)}`"], item.bounds, "", item.sections)
    if isinstance(type_, type) and issubclass(type_, Enum):
        return Value([_choices(member.value for member in type_)])
    if isinstance(type_, type) and issubclass(type_, Struct):
        return Value([f"[{_title(type_)}](#{_anchor(_title(type_))})"], sections=[type_])
    return Value([NUMBER_WORDS[type_]])


def _union(values: list[Value]) -> Value:
    def join_values(part: Callable[[Value], Iterable[Any]]) -> list[Any]:
        return list(dict.fromkeys(item for value in values for item in part(value)))

    meaning = next((value.meaning for value in values if value.meaning), "")
    return Value(
        join_values(lambda v: v.names), join_values(lambda v: v.bounds), meaning, join_values(lambda v: v.sections)
    )


def _list(values: list[Value], of_any_length: bool) -> Value:
    first = values[0]
    name = " or ".join(first.names)
    names = [f"list of {name}" if of_any_length else "[" + ", ".join(" or ".join(v.names) for v in values) + "]"]
    return Value(names, first.bounds, "", first.sections)


def _choices(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _bounds(meta: Meta, items: str) -> list[str]:
    low = f"≥ {meta.ge:g}" if meta.ge is not None else f"> {meta.gt:g}" if meta.gt is not None else ""
    high = f"≤ {meta.le:g}" if meta.le is not None else f"< {meta.lt:g}" if meta.lt is not None else ""
    if meta.ge is not None and meta.le is not None:
        return [f"{meta.ge:g} to {meta.le:g}"]
    most = f"to {meta.max_length}" if meta.max_length else "or more"
    sizes = [f"{meta.min_length} {most} {items}"] if meta.min_length else []
    text = [str((meta.extra or {})["format"])] if meta.extra and "format" in meta.extra else []
    return [bound for bound in (low, high) if bound] + sizes + text


def _title(cls: type[Struct]) -> str:
    """The name of a section in words: GeodeticOrigin -> "Geodetic origin"."""
    words = re.sub("(?<=[a-z0-9])(?=[A-Z])|(?<=[a-z])(?=[0-9])", " ", cls.__name__)
    return words.capitalize().replace("Stand in", "Stand-in")


def _anchor(title: str) -> str:
    return title.lower().replace(" ", "-")


def _docstring(cls: type[Struct]) -> str:
    """What a section is for, without its keys."""
    return KEY.split(_whole_docstring(cls), maxsplit=1)[0].strip()


def _meanings(cls: type[Struct]) -> dict[str, str]:
    """What each key means, from the docstrings of a section and its bases: lines like "radius_m: of the circle"."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if issubclass(base, Section):
            _, *texts = KEY.split(_whole_docstring(base))
            found |= {key: " ".join(text.split()) for key, text in zip(texts[::2], texts[1::2], strict=True)}
    unknown = found.keys() - set(cls.__struct_fields__)
    assert not unknown, f"{cls.__name__} describes {unknown}, which it does not have"
    return found


def _whole_docstring(cls: type[Struct]) -> str:
    return inspect.cleandoc(vars(cls).get("__doc__") or "")


if __name__ == "__main__":
    print(configuration(), end="")
