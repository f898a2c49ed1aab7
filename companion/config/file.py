"""One YAML file -> one validated type, or one line for each error: file, field, value, what was expected.

Files are named by a user or another file: only regular ones of limited size are read. A file of another kind than expected is
refused as such. KEY.PATH=VALUE of a command line replaces one value in the plain content.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import yaml

from companion.config.validation import Problem, all_finite, each, examine, in_file_order
from companion.types.errors import UnusableError
from companion.types.values import cut, printable, quoted

MAX_BYTES = 128 * 1024  # a fleet of 250 vehicles has 20 kB


def read_regular(path: Path, most_bytes: int = MAX_BYTES) -> tuple[bytes, os.stat_result]:
    """The content and state of a file. Raises OSError, also for a device, pipe or folder and for a larger file.

    O_NONBLOCK: opening a named pipe would otherwise wait for its writer.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return read_descriptor(descriptor, most_bytes)
    finally:
        os.close(descriptor)


def read_descriptor(descriptor: int, most_bytes: int = MAX_BYTES) -> tuple[bytes, os.stat_result]:
    """`read_regular` of a file that is open."""
    state = os.fstat(descriptor)
    if stat.S_ISDIR(state.st_mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(state.st_mode):
        raise OSError(errno.EINVAL, "not a regular file")
    content = b""
    while len(content) <= most_bytes and (chunk := os.read(descriptor, most_bytes + 1 - len(content))):
        content += chunk
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"larger than {most_bytes // 1024} kB")
    return content, state


LONGEST_KEY, LONGEST_YAML_ERROR = 200, 200  # characters in a message
MOST_LINES = 50  # of one error: a file of another kind has a line for each of its keys
MAX_DEPTH = 50  # levels of a file; ours have five
MAX_VALUES = 10_000  # largest number of values in a file, aliases expanded; 250 vehicles have 2500
TOO_MANY_VALUES = f"more than {MAX_VALUES} values, counting each alias as what it stands for"

T = TypeVar("T")


class ConfigError(UnusableError):
    """A file that cannot be used. str() has one line for each error: file, field, value, what was expected, what to do."""

    def __init__(self, file: Path | str, field: str, problem: str) -> None:
        line = f"{file}: {cut(field, LONGEST_KEY)}: {problem}" if field else f"{file}: {problem}"
        self.lines: tuple[str, ...] = (printable(line.replace("\n", "\\n")),)
        super().__init__(self.lines[0])

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def __reduce__(self) -> tuple[Callable[[tuple[str, ...]], ConfigError], tuple[tuple[str, ...]]]:
        """Out of a process that flies a batch: an exception that cannot be restored would end all of them."""
        return _of_lines, (self.lines,)

    @staticmethod
    def of(errors: Sequence[ConfigError]) -> ConfigError:
        """The error with the lines of all these."""
        lines = tuple(line for one in errors for line in one.lines)
        more = (f"and {len(lines) - MOST_LINES} more errors",) if len(lines) > MOST_LINES else ()
        return _of_lines(lines[:MOST_LINES] + more)

    def renamed(self, file: Path | str, by: str) -> ConfigError:
        """The error with another name for a file in it, as its user wrote it."""
        return _of_lines(tuple(line.replace(str(file), printable(by)) for line in self.lines))


def _of_lines(lines: tuple[str, ...]) -> ConfigError:
    error = ConfigError("", "", "")
    error.lines = lines
    return error


def refuse(file: Path | str, problems: Iterable[Problem]) -> None:
    """Raises ConfigError with all of the problems, if there are any."""
    if errors := [ConfigError(file, problem.field, problem.text) for problem in problems]:
        raise ConfigError.of(errors)


def load(path: Path, type_: type[T]) -> T:
    """Read a YAML file into a msgspec type. Raises ConfigError."""
    return convert(path, read_yaml(path), type_)


def read_text(path: Path) -> str:
    """Raises ConfigError."""
    try:
        return read_regular(path)[0].decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(path, "", f"is not UTF-8 text (byte {error.start})") from error
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        reason = error.strerror if isinstance(error, OSError) else "a zero byte in its name"
        raise ConfigError(path, "", f"cannot be read: {reason}; {_what_to_do(path)}") from error


def _what_to_do(path: Path) -> str:
    """With a path that cannot be read. The folder of a flight has the files that were flown."""
    if not path.is_dir():
        return "check the path"
    inside = [str(path / name) for name in ("scenario.yaml", "fleet.yaml") if (path / name).is_file()]
    return f"use {' or '.join(inside)}" if inside else "expected a file"


def read_yaml(path: Path) -> Any:
    """The plain content of a YAML file. Raises ConfigError; a key that is given twice is an error."""
    if path.suffix == ".py" and path.is_file():
        raise ConfigError(path, "", "is Python; expected a YAML file, and a law of your own after --law")
    text = read_text(path)
    try:
        return yaml.load(text, Loader=StrictLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ConfigError(path, place, f"not valid YAML: {_yaml_in_words(error)}") from error
    except yaml.YAMLError as error:
        problem = cut(" ".join(str(error).split()), LONGEST_YAML_ERROR)
        raise ConfigError(path, "", f"not valid YAML: {problem}") from error


YAML_WORDS = (
    (r"character '\\t'", "a tab, where YAML wants spaces"),
    (
        "mapping values are not allowed",
        "no colon can be here: this line is indented too far, or the line above has no colon with a blank after it",
    ),
    (
        "<block end>|<document start>",
        "this line is not indented like those of its section, or a value goes on after its end",
    ),
    ("expected ',' or", "a bracket is not closed, or a comma is missing"),
    ("unexpected end of stream", "a quote is not closed"),
    ("cannot start any token", "a text that begins with this character needs quotes"),
)


def _yaml_in_words(error: yaml.MarkedYAMLError) -> str:
    """The mistakes that are made often, in words for a reader who does not know how YAML is parsed."""
    problem = str(error.problem)
    words = next((words for pattern, words in YAML_WORDS if re.search(pattern, problem)), None)
    if words is None:
        return cut(problem, LONGEST_YAML_ERROR)
    begun = error.context_mark
    return f"{words}, in what begins in line {begun.line + 1}" if begun and "not closed" in words else words


def convert(path: Path, data: Any, type_: type[T], check: Callable[[T], Iterable[Problem]] | None = None) -> T:
    """Plain content -> type. `path` only names the file in errors. Raises ConfigError with all errors in file order.

    `check` finds what no single field can show. It also runs where some fields are invalid, as far as it needs none of them.
    """
    if data is None:
        raise ConfigError(path, "", "is empty")
    value, problems = _convert(data, type_)
    if check is not None:
        problems += each(_of_check(check, value))
    refuse(path, in_file_order(data, problems))
    return value


def _of_check(check: Callable[[T], Iterable[Problem]], value: T) -> Iterator[Problem]:
    """The problems that it finds; called in `each`, as it may need a field of a section that is invalid as a whole."""
    yield from check(value)


def _convert(data: Any, type_: type[T]) -> tuple[T, list[Problem]]:
    if all_finite(data):
        try:
            return msgspec.convert(data, type_, strict=True), []
        except msgspec.ValidationError:
            pass
    return examine(data, type_)


class StrictLoader(yaml.SafeLoader):
    """A SafeLoader that raises yaml.MarkedYAMLError for everything that it does not accept.

    SafeLoader silently keeps the last of two equal keys; here that is an error. So is an anchor that contains itself.
    """

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._count = 0  # values read so far
        self._open_anchors: list[str | None] = []  # anchors of the nodes that enclose the one being read

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        anchor, mark = getattr(event, "anchor", None), event.start_mark
        if isinstance(event, yaml.AliasEvent) and anchor in self._open_anchors:
            raise yaml.constructor.ConstructorError(None, None, f"&{cut(str(anchor))} contains itself", mark)
        if len(self._open_anchors) >= MAX_DEPTH:
            problem = f"more than {MAX_DEPTH} levels inside each other"
            raise yaml.constructor.ConstructorError(None, None, problem, mark)
        self._count += 1
        if self._count > MAX_VALUES:
            raise yaml.constructor.ConstructorError(None, None, TOO_MANY_VALUES, mark)
        self._open_anchors.append(anchor)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._open_anchors.pop()
        return node

    def compose_document(self) -> yaml.Node | None:
        node: yaml.Node | None = super().compose_document()
        if node is not None and _values(node, {}) > MAX_VALUES:
            raise yaml.constructor.ConstructorError(None, None, TOO_MANY_VALUES, node.start_mark)
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
                problem = f'key "{cut(str(key))}" is given twice'
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def _values(node: yaml.Node, known: dict[yaml.Node, int]) -> int:
    """Number of values in a node, where a node that several aliases name counts once for each of them."""
    if node not in known:
        children: Iterable[yaml.Node] = ()
        if isinstance(node, yaml.SequenceNode):
            children = node.value
        elif isinstance(node, yaml.MappingNode):
            children = (child for pair in node.value for child in pair)
        known[node] = 1 + sum(_values(child, known) for child in children)
    return known[node]


FileKind = Literal["scenario", "vehicle", "fleet", "external", "slots", "reference"]
FILE_KINDS: dict[FileKind, tuple[str, frozenset[str]]] = {  # name in messages, and keys that no other kind has
    "scenario": ("a scenario", frozenset({"starts_enu_m", "timeline"})),
    "vehicle": ("a vehicle file", frozenset({"mavlink", "hover_thrust_norm"})),
    "fleet": ("a fleet file", frozenset({"vehicles", "neighbours", "takeoff_height_m"})),
    "external": ("a file of external vehicles", frozenset({"external_vehicles"})),
    "slots": ("a file with slots_enu_m", frozenset({"slots_enu_m"})),
    # Scenarios and vehicle files have such a section, too.
    "reference": ("a file with nothing but a reference", frozenset()),
}


HINTS: dict[tuple[FileKind, ...], str] = {  # by the kind of the file, then all that are expected
    ("fleet", "scenario"): ": this file under `fleet`, a reference and a timeline (docs/simulation-to-vehicles.md)",
}


def kind_of_file(data: Any) -> FileKind | None:
    """The kind by the keys; None if they do not show one kind."""
    kinds = [kind for kind, (_, keys) in FILE_KINDS.items() if isinstance(data, dict) and keys & data.keys()]
    return kinds[0] if len(kinds) == 1 else None


def read_as(path: Path, *expected: FileKind) -> Any:
    """The plain content of a YAML file of one of these kinds. Raises ConfigError."""
    data = read_yaml(path)
    kind = kind_of_file(data)
    if kind is not None and kind not in expected:
        wanted = " or ".join(FILE_KINDS[kind][0] for kind in expected)
        raise ConfigError(
            path, "", f"this is {FILE_KINDS[kind][0]}; {wanted} is expected{HINTS.get((kind, *expected), '')}"
        )
    return data


SET = Path("--set")  # named in errors instead of a file


def override(data: Any, overrides: Sequence[str], example: str) -> Any:
    """A copy of the content with these values. Raises ConfigError, where `example` may help."""
    data = deepcopy(data)
    for override in overrides:
        _put(data, override, example)
    return data


def _put(data: Any, override: str, example: str) -> None:
    """Set the value, written in YAML; sections that are missing are made. Raises ConfigError, where `example` may help."""
    field, equals, text = override.partition("=")
    steps = _steps(field) if len(field) <= LONGEST_KEY else []  # Python refuses to read a number of thousands of digits
    if not equals or not steps:
        raise ConfigError(SET, override, f"expected KEY=VALUE, like {example}")
    try:
        value = yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise ConfigError(SET, field, f"{quoted(text)} is not a YAML value") from error
    node, place = data, ""
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        _check_step(node, place, step)
        if following is None:
            node[step] = value
        elif isinstance(node, dict):
            if node.get(step) is None:
                node[step] = {}
            node = node[step]
        else:
            node = node[step]
        place = f"{place}[{step}]" if isinstance(step, int) else f"{place}.{step}".lstrip(".")


def _steps(field: str) -> list[str | int]:
    """ "timeline[3].for_s" -> ["timeline", 3, "for_s"]; a bare number is a number, too (starts_enu_m.1)."""
    if not re.fullmatch(r"\w+(\.\w+|\[\d+\])*", field):
        return []
    return [int(step) if step.isdecimal() else step for step in re.findall(r"\w+", field)]


def _check_step(node: Any, place: str, step: str | int) -> None:
    if isinstance(node, dict):
        return
    if not isinstance(node, list):
        raise ConfigError(SET, place, f"is {quoted(node)}, which has no keys inside; set it as a whole")
    if not isinstance(step, int):
        raise ConfigError(
            SET, f"{place}.{step}", f"{place} is a list; expected a number, {place}[0] to [{len(node) - 1}]"
        )
    if step >= len(node):
        raise ConfigError(SET, f"{place}[{step}]", f"no such item; expected {place}[0] to [{len(node) - 1}]")
