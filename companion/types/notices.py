"""Notices: a stable code with a text, for every refusal, finding and event."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from companion.types.errors import CompanionError
from companion.types.generated.codes import Code as Code
from companion.types.values import Finite, Line, Word

Accepts = Annotated[tuple[tuple[Word, Finite], ...], Meta(max_length=8)]
"""Keys, in their units, each with a value that would be accepted."""


class Notice(Struct, frozen=True, gc=False, omit_defaults=True):
    """A refusal, finding or event. `text` names what is wrong, where, what was expected and what to do.

    `accepts`: of a refusal, what would be accepted instead where that is known.
    """

    code: Code
    text: Line
    accepts: Accepts = ()

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"

    def about(self, subject: str) -> Notice:
        """The same with its subject before the text."""
        return Notice(self.code, f"{subject}: {self.text}", self.accepts)


class Answer(NamedTuple):
    """Whether a command is accepted, and why not or what happens now."""

    accepted: bool
    notice: Notice


class Judged(NamedTuple):
    """The answer to a change, and what carries the change out where it is accepted. A check leaves it at the answer."""

    answer: Answer
    carry_out: Callable[[], None] = lambda: None

    def carried_out(self) -> Answer:
        """Carry the change out, and answer."""
        self.carry_out()
        return self.answer


class Refused(CompanionError):  # noqa: N818 -- what happens to a request, not an error of this program
    """Ends the check of a request. `notice` is the reason."""

    def __init__(self, code: Code, text: str) -> None:
        super().__init__(text)
        self.notice = Notice(code, text)


def accept(code: Code, text: str) -> Answer:
    return Answer(True, Notice(code, text))


def refuse(code: Code, text: str) -> Answer:
    return Answer(False, Notice(code, text))
