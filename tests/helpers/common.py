"""Where the repository and its example files are, and what tests compare of notices and answers: their codes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from companion.types.commands import CommandReply
from companion.types.notices import Answer, Code, Notice

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
