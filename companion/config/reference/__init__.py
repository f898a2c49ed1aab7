"""The `reference` (RFT) of a vehicle file, a scenario or a command: the registry of its kinds.

A kind is one module of this package with one class, its KIND: the keys with their bounds, where it leads, how fast it is, what
slows it down, and the option and the input of the page for each key (ASKED). Files, commands, page and documentation find it
here. One whose trajectory is not known beforehand, like that of a target, also has an RFT of its own in `core/reference`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from importlib import import_module
from operator import or_
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_origin, get_type_hints

from companion.config.file import convert, read_as
from companion.config.reference.base import Asked as Asked
from companion.config.reference.base import BaseReference as BaseReference
from companion.config.reference.circle import CircleReference as CircleReference
from companion.config.reference.figure_8 import Figure8Reference as Figure8Reference
from companion.config.reference.point import PointReference as PointReference
from companion.config.reference.target import TargetReference as TargetReference
from companion.config.reference.waypoints import WaypointsReference as WaypointsReference
from companion.config.validation import Problem
from companion.config.values import Section


def _kinds() -> Iterator[type[BaseReference]]:
    """Those of all modules of this package: first what is at rest, then by name."""
    modules = (import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__))
    found: list[type[BaseReference]] = [module.KIND for module in modules if hasattr(module, "KIND")]
    yield from sorted(found, key=lambda kind: (kind.MOVES, str(kind.__struct_config__.tag)))


KINDS: dict[str, type[BaseReference]] = {str(kind.__struct_config__.tag): kind for kind in _kinds()}
PLACED = {name: kind for name, kind in KINDS.items() if kind.PLACED}
ASKED: dict[str, Asked] = {key: asked for kind in KINDS.values() for key, asked in kind.ASKED.items()}
if TYPE_CHECKING:
    Reference: TypeAlias = BaseReference
    KnownReference: TypeAlias = BaseReference
    FirstKind: TypeAlias = str
else:  # what files may hold is what the registry holds
    Reference = reduce(or_, KINDS.values())
    KnownReference = reduce(
        or_, (kind for kind in KINDS.values() if not kind.AWAITED)
    )  # whose curve is known beforehand
    FirstKind = Literal[tuple(name for name, kind in KINDS.items() if kind.first(10.0, 3.0))]


class ReferenceSection(Section, frozen=True):
    """A file, command line or command with a reference and nothing else.

    reference: the trajectory of the formation (RFT)
    """

    reference: Reference


def load_reference(path: Path) -> Reference:
    """Read a file with a section `reference` and nothing else, for a command. Raises ConfigError."""
    return commanded(path, read_as(path, "reference"))


def commanded(where: Path, data: Any) -> Reference:
    """The reference of a command; `where` is named in errors. Raises ConfigError, also for one that no command may bring."""
    return convert(where, data, ReferenceSection, lambda section: command_problems(section.reference)).reference


def command_problems(reference: Reference, where: str = "reference") -> Iterator[Problem]:
    """Why vehicles do not take this reference from a command, beside the limits of the fleet."""
    refusal = reference.refusal_as_command()
    for key, text in [refusal] if refusal else reference.contradictions():
        yield Problem(f"{where}.{key}", text)


def type_of_key(key: str) -> type:
    """float, bool, str or tuple of a key in ASKED."""
    kind = next(kind for kind in KINDS.values() if key in kind.ASKED)
    plain: type = get_type_hints(kind)[key]
    return get_origin(plain) or plain
