"""Files that a configuration file names beside it: read together with it, and copied where it is written again."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from companion.config.file import SET, ConfigError, override
from companion.config.law import LawSection, overridden
from companion.config.reference import KINDS

Section = dict[str, Any]
T = TypeVar("T")
LAW = "--law"
OF_LAW = re.compile(rf"({LAW}: )?((fleet\.)?law\.(file|name): )?")  # what the user of --law has not written


class Named(Protocol):
    """A section that may name files."""

    def read(self, section: Section, where: str, beside: Path) -> Section:
        """The plain section with what it names read."""

    def carried(self, section: Section, folder: Path) -> Section:
        """The plain section with copies of its files in the folder."""


def read_named(data: Any, beside: Path) -> Any:
    """The plain content of a file with all that its sections name read (see `BaseReference.read`). Raises ConfigError."""
    return _each_section(data, lambda named, section, where: named.read(section, where, beside))


def law_override(law: str) -> str:
    """The override that --law is: the name of the law, wherever the file has it."""
    return f"{LAW}={law}"


def changed(data: Any, overrides: Sequence[str], example: str, read: Callable[[Path, Any], T]) -> T:
    """What `read` makes of the content with these values. Raises ConfigError, which names the option of what is wrong."""
    try:
        return read(SET, with_overrides(data, overrides, example))
    except ConfigError:
        for line in overrides:
            if line.startswith(f"{LAW}="):
                _try_law(data, line, example, read)
        raise


def _try_law(data: Any, line: str, example: str, read: Callable[[Path, Any], T]) -> None:
    """Raise ConfigError where the law alone is the problem."""
    try:
        read(Path(LAW), with_overrides(data, [line], example))
    except ConfigError as error:
        path = line.partition("=")[2]
        lines = error.renamed(Path(path).resolve(), path).lines
        raise ConfigError.of([ConfigError(LAW, "", OF_LAW.sub("", each, count=1)) for each in lines]) from error


def with_overrides(data: Any, overrides: Sequence[str], example: str) -> Any:
    """`override`; and where it sets the name of a law, what belongs to that law. Raises ConfigError."""
    key = "fleet.law.name" if isinstance(data, dict) and "fleet" in data else "law.name"
    data = override(
        data, [line.replace(LAW, key, 1) if line.startswith(f"{LAW}=") else line for line in overrides], example
    )
    for holder in (data, data.get("fleet")) if isinstance(data, dict) else ():
        if isinstance(holder, dict) and isinstance(holder.get("law"), dict):
            holder["law"] = overridden(holder["law"])
    return data


def carried(data: Any, folder: Path) -> Any:
    """The plain content for a file in this folder, with copies there of the files that its sections name."""
    return _each_section(data, lambda named, section, _: named.carried(section, folder))


def _each_section(data: Any, change: Callable[[Named, Section, str], Section], where: str = "") -> Any:
    if isinstance(data, list | tuple):
        return [_each_section(item, change, f"{where}[{index}]") for index, item in enumerate(data)]
    if not isinstance(data, dict):
        return data
    inside = {key: _each_section(item, change, f"{where}.{key}".lstrip(".")) for key, item in data.items()}
    kind = inside.get("kind")
    if isinstance(kind, str) and kind in KINDS:
        return change(KINDS[kind], inside, where)
    return change(LawSection, inside, where) if where.rpartition(".")[2] == "law" else inside
