"""Notices: a stable code with a text, for every refusal, finding and event."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from companion.types.errors import CompanionError
from companion.types.generated.codes import Code as Code
from companion.types.values import Line


class Notice(Struct, frozen=True, gc=False):
    """A refusal, finding or event. `text` names what is wrong, where, what was expected and what to do."""

    code: Code
    text: Line

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"

    def about(self, subject: str) -> Notice:
        """The same with its subject before the text."""
        return Notice(self.code, f"{subject}: {self.text}")


class Answer(NamedTuple):
    """Whether a command is accepted, and why not or what happens now."""

    accepted: bool
    notice: Notice


class Refused(CompanionError):  # noqa: N818 -- what happens to a request, not an error of this program
    """Ends the check of a request. `notice` is the reason."""

    def __init__(self, code: Code, text: str) -> None:
        super().__init__(text)
        self.notice = Notice(code, text)


def accept(code: Code, text: str) -> Answer:
    return Answer(True, Notice(code, text))


def refuse(code: Code, text: str) -> Answer:
    return Answer(False, Notice(code, text))
