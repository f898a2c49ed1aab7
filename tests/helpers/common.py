"""Where the repository is, what tests compare of notices and answers, messages with other fields, and counted work."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from companion.types.commands import CommandReply
from companion.types.notices import Answer, Code, Notice
from companion.types.values import Part

ROOT = Path(__file__).parents[2]


def code_of(notice: Notice | None) -> Code | None:
    return notice.code if notice else None


def codes_of(notices: Iterable[Notice]) -> list[Code]:
    return [notice.code for notice in notices]


def texts_of(notices: Iterable[Notice]) -> list[str]:
    return [notice.text for notice in notices]


def outcome(answer: Answer | CommandReply | None) -> tuple[bool, Code]:
    """Whether it was accepted, and the code of why."""
    assert answer is not None
    return (answer.accepted, answer.code if isinstance(answer, CommandReply) else answer.notice.code)


M = TypeVar("M", bound=Struct)


def with_fields(message: M, **values: Any) -> M:
    """A message with some fields changed, wherever its parts hold them.

    `values` by the name of the field, in the message itself or in one of its parts.
    """
    own = {name: value for name, value in values.items() if name in message.__struct_fields__}
    for name in message.__struct_fields__:
        part = getattr(message, name)
        if isinstance(part, Part):
            inner = {key: value for key, value in values.items() if key in part.__struct_fields__ and key not in own}
            if inner:
                own[name] = replace(part, **inner)
    known = own.keys() | {key for part in own.values() if isinstance(part, Part) for key in part.__struct_fields__}
    assert values.keys() <= known, f"{type(message).__name__} has no {sorted(values.keys() - known)}"
    return replace(message, **own)


@dataclass
class Work:
    """How many functions were called, those in C included: the same on every machine, unlike a time."""

    calls: int = 0


@contextmanager
def count_calls() -> Iterator[Work]:
    """Count the function calls of the block."""
    work = Work()

    def observe(_frame: object, event: str, _argument: object) -> None:
        work.calls += event in ("call", "c_call")

    sys.setprofile(observe)
    try:
        yield work
    finally:
        sys.setprofile(None)
