"""Foreign text for terminals and logs: from files, arguments, autopilots, other programs."""

from __future__ import annotations


def printable(text: str) -> str:
    """The text in one line, with ? for each character that could control a terminal or reverse the text."""
    return "".join(c if c.isprintable() else "?" for c in text)


def printable_lines(text: str) -> str:
    """The same for a text of several lines."""
    return "\n".join(map(printable, text.split("\n")))
