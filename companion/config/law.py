"""The formation law of a fleet file, and where laws are found: built in, installed, or in a file beside the fleet file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, ValidationError, convert, field
from msgspec.structs import asdict, replace

import companion.laws
from companion.config.code_file import carried_section, code_error, is_loaded, loaded_code, read_section
from companion.config.file import ConfigError, refuse
from companion.config.validation import INVALID, InvalidFieldError, Problem, all_finite, did_you_mean, examine, needs
from companion.config.values import Section, Text, written
from companion.laws import Law
from companion.laws._trial import trial_problem
from companion.types.values import quoted

USUAL = ("cooperative", "weighted", "average_22", "average_26")  # named first
_OTHERS = {m.name for m in iter_modules(companion.laws.__path__) if not m.name.startswith("_")} - set(USUAL)
BUILT_IN = (*USUAL, *sorted(_OTHERS))
ENTRY_POINTS = "companion.laws"  # group in which an installed package names its laws
GAINS = ("position_gain_1_s2", "velocity_gain_1_s")
PAPER_LAWS = ("weighted", "average_22", "average_26")
PYTHON = ".py"
LAW_NAME = "^[a-z][a-z0-9_]{0,40}$"

Gain = Annotated[float, Meta(gt=0, le=10)]
LawName = Annotated[str, written(LAW_NAME, "at most 41 lower-case letters, digits and _, a letter first")]
Parameter = bool | int | float | str


class AltitudeHoldGains(Section, frozen=True):
    """Gains of the altitude controller of a vehicle that holds its own altitude.

    position_1_s2: on the altitude error
    velocity_1_s: on the climb rate
    """

    position_1_s2: Gain = 2.0
    velocity_1_s: Gain = 2.4


class LawSection(Section, frozen=True):
    """The formation law and its parameters, and what stays the same under any law.

    name: `cooperative` is the law to fly; `weighted` is the paper's; `average_22` and `average_26` are those that the
        paper compares it with; `serial` and `trimmed` are of other publications; the name of an installed law, or with
        `file` any other name
    file: Python file with a law of your own, in the folder of this file; only root and the user of the process may be able
        to write either; vehicles fly together only with the same content
    sha256: hexadecimal SHA-256 that the content of `file` must have; without it any
    parameters: of this law, by name; one that is left out has the value of the law
    altitude: `formation`: the law controls z too; `hold`: each vehicle holds the altitude it entered with
    disturbance_bandwidth_1_s: bandwidth of the observer for wind and hover thrust error; 0 switches it off
    velocity_correction_1_s: bandwidth of the filter that makes the velocity agree with the position; 0 switches it off
    """

    name: LawName = "cooperative"
    file: Text | None = None
    sha256: Annotated[str, written("^[0-9a-f]{64}$", "64 hexadecimal digits")] | None = None
    parameters: dict[str, Parameter] = field(default_factory=dict)
    altitude: Literal["formation", "hold"] = "formation"
    altitude_hold_gains: AltitudeHoldGains = AltitudeHoldGains()
    disturbance_bandwidth_1_s: Annotated[float, Meta(ge=0, le=5)] = 4.0
    velocity_correction_1_s: Annotated[float, Meta(ge=0, le=10)] = 2.0

    @classmethod
    def read(cls, section: dict[str, Any], where: str, beside: Path) -> dict[str, Any]:
        """The plain section with the whole path and the SHA-256 of its file, which is loaded. Raises ConfigError."""
        return read_section(section, where, beside)

    @classmethod
    def carried(cls, section: dict[str, Any], folder: Path) -> dict[str, Any]:
        """The plain section with a copy of its file in the folder."""
        return carried_section(section, folder)

    def __hash__(self) -> int:
        return hash((self.name, self.sha256, *self.parameters.items()))

    def __reduce__(self) -> tuple[Callable[..., LawSection], tuple[Any, ...]]:
        """To another process of this machine, which loads the file itself."""
        return _restored, (asdict(self),)

    def with_name(self, name: str) -> LawSection:
        """Another law with these settings, for comparisons; a name that ends with .py is the path of its file.

        The paper's three laws share their gains. Raises ConfigError for a file.
        """
        if name == self.name:
            return self
        shared = GAINS if name in PAPER_LAWS and self.name in PAPER_LAWS else ()
        kept = {key: value for key, value in self.parameters.items() if key in shared}
        if not name.endswith(PYTHON):
            return replace(self, name=name, file=None, sha256=None, parameters=kept)
        section = replace(self, parameters=kept, **law_in_file(name))
        of_file = (f"{section.file}: ", "law.file", "law.name")
        refuse(
            name,
            [
                Problem("" if at in of_file else at, text.removeprefix(of_file[0]))
                for at, text, _ in law_problems(section, "law")
            ],
        )
        return section

    def agreed(self) -> LawSection:
        """What vehicles must agree on: the content of the file, not its path."""
        return replace(self, file=None)


def law_in_file(path: str) -> dict[str, Any]:
    """Name, file and SHA-256 of a law that the user names by a path, in whatever folder. Raises ConfigError."""
    file = Path(path).resolve()
    try:
        return LawSection.read({"name": file.stem, "file": file.name}, "law", beside=file)
    except ConfigError as error:
        raise error.renamed(file, path) from error


def overridden(law: dict[str, Any]) -> dict[str, Any]:
    """A plain section whose name was set alone, with what belongs to that law. Raises ConfigError.

    A name that ends with .py is the path of a file, in whatever folder.
    """
    name = law.get("name")
    if isinstance(name, str) and name.endswith(PYTHON):
        return law | law_in_file(name)
    if law.get("file") is not None and name in law_names():
        return {key: value for key, value in law.items() if key not in ("file", "sha256", "parameters")}
    return law


def law_of(section: LawSection) -> Law:
    """The law with the parameters of the section.

    Raises InvalidFieldError for one that `law_problems` refuses, ConfigError for a file that has not been read.
    """
    if section.file is not None:
        loaded_code(section.file, section.sha256)
    try:
        return convert(section.parameters, law_class(section))
    except (ValidationError, KeyError, ConfigError) as error:  # what `law_problems` tells
        raise InvalidFieldError from error


def is_built_in(section: LawSection) -> bool:
    """Whether the law is one of this package."""
    return section.file is None and section.name in BUILT_IN


def law_names() -> tuple[str, ...]:
    """Names of all laws that need no file."""
    return (*BUILT_IN, *sorted(_installed()))


def law_class(section: LawSection) -> type[Law]:
    """The class of a law. Raises ConfigError for a file that gives none, KeyError for an unknown name."""
    name, file = section.name, section.file
    if file is not None:
        return _law_in(dict(loaded_code(file, section.sha256).namespace), file)
    if name in BUILT_IN:
        module = import_module(f"companion.laws.{name}")
        return _law_in(vars(module), str(module.__file__))
    found: Any = _installed()[name].load()
    return _law_in({"law": found, "__name__": found.__module__}, name)


def law_problems(section: LawSection, where: str) -> Iterator[Problem]:
    """An unknown law, a file that gives none, parameters that it does not have or that are out of their bounds.

    Nothing can be said of a file that has not been read, as in a recording.
    """
    name, file, parameters = section.name, section.file, section.parameters
    for value in parameters.values():
        needs(value)
    if file is None and name not in BUILT_IN and name not in _installed():
        names = ", ".join(law_names())
        text = f"{quoted(name)} is no law; expected one of {names}, or file with a law of your own"
        yield Problem(f"{where}.name", text + did_you_mean(name, law_names()))
        return
    if file is not None and name in BUILT_IN:
        yield Problem(f"{where}.name", f"{quoted(name)} is a built-in law; expected another name for the law of a file")
        return
    if file is not None and not is_loaded(section.sha256):
        return
    try:
        cls = law_class(section)
    except ConfigError as error:
        yield Problem(f"{where}.file", str(error))
        return
    if not is_built_in(section) and (text := parameter_problem(cls)):
        yield Problem(f"{where}.{'name' if file is None else 'file'}", f"{file or name}: {text}")
        return
    law, problems = examine(parameters, cls, f"{where}.parameters")
    yield from problems
    if law is not INVALID and not problems and all_finite(parameters) and (text := _trial_problem(law, file or name)):
        yield Problem(f"{where}.{'name' if file is None else 'file'}", text)


@lru_cache(maxsize=16)
def parameter_problem(cls: type[Law]) -> str:
    """What is wrong with how a law declares its parameters; empty where nothing is."""
    for name, value in vars(cls).items():
        if isinstance(value, bool | int | float | str) and name.islower() and not (name[0] == "_" or name in vars(Law)):
            expected = f"expected {name}: Gain = {value!r} or another type with bounds, or capitals for a constant"
            return f"{name} has no type, so it is not a parameter and cannot be set; {expected}"
    unbounded = [name for name in cls.__struct_fields__ if not _has_bounds(cls, name)]
    if unbounded:
        return f"{', '.join(unbounded)} without bounds; expected NAME: Annotated[float, Meta(ge=0, le=1)], or Gain"
    return ""


def _has_bounds(cls: type[Law], name: str) -> bool:
    """Whether a number has both bounds; other types count as bounded."""
    struct = msgspec.inspect.type_info(cls)
    assert isinstance(struct, msgspec.inspect.StructType)
    kind = next(info.type for info in struct.fields if info.name == name)
    if not isinstance(kind, msgspec.inspect.FloatType | msgspec.inspect.IntType):
        return True
    return (kind.ge is not None or kind.gt is not None) and (kind.le is not None or kind.lt is not None)


def _trial_problem(law: Law, source: str) -> str:
    try:
        found = trial_problem(law)
        return f"{source}: {found}" if found else ""
    except Exception as error:  # noqa: BLE001 -- the code of a user
        return str(code_error(Path(source), error))


def _law_in(namespace: dict[str, Any], source: str) -> type[Law]:
    """The one law that a module defines itself; what it imports does not count. Raises ConfigError."""
    name = namespace.get("__name__")
    classes = [c for c in namespace.values() if isinstance(c, type) and issubclass(c, Law) and c.__module__ == name]
    if len(classes) != 1:
        found = ", ".join(c.__name__ for c in classes) or "none"
        raise ConfigError(source, "", f"expected one subclass of companion.laws.Law, found {found}")
    return classes[0]


def _restored(fields: dict[str, Any]) -> LawSection:
    if fields["file"] is not None:
        LawSection.read(fields, "law", beside=Path(fields["file"]))
    return LawSection(**fields)


@lru_cache(maxsize=1)
def _installed() -> dict[str, Any]:
    """Laws of installed packages by name. Read only for a name that is not built in: it takes 10 ms."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=ENTRY_POINTS) if point.name not in BUILT_IN}
