"""The vehicle file as it goes to its board: with the identity, and with TLS instead of TCP between agents. Text to text."""

from __future__ import annotations

import re
from typing import Any

import yaml

from companion.config.file import StrictLoader

IDENTITY_FOLDER = "identity"  # beside the vehicle file
IDENTITY_LINE = f"identity: {IDENTITY_FOLDER}"
COMMENT = "# key and certificate; from here on only admitted participants connect"
TOP_LEVEL = re.compile(r"(?P<key>[A-Za-z_][\w]*)\s*:")
TAIL = re.compile(r"(?:^|\s+)#.*|\s*$", re.DOTALL)  # a comment and the end of the line
TCP = re.compile(r"(?<![\w/.-])tcp/")


class BoardFileError(ValueError):
    """A vehicle file that is written in a way that cannot be changed line by line."""


def board_vehicle_file(text: str) -> str:
    """The text with `identity` and with tls/ endpoints in the section zenoh; comments and all other lines stay as they are.

    Raises BoardFileError where the result would say anything else than that.
    """
    section, lines, has_identity = "", [], False
    for line in text.splitlines(keepends=True):
        if found := TOP_LEVEL.match(line):
            section = found["key"]
        if found and section == "identity":
            line, has_identity = _with_value(line), True
        elif section == "zenoh":
            line = _with_tls(line)
        lines.append(line)
    changed = "".join(lines)
    if not has_identity:
        changed += ("" if changed.endswith("\n") else "\n") + f"{IDENTITY_LINE:<28} {COMMENT}\n"
    if _content(changed) != _wanted(_content(text)):
        raise BoardFileError(
            "cannot be changed line by line; write zenoh and identity as companion init does, each key in a line of its own"
        )
    return changed


def _with_value(line: str) -> str:
    return IDENTITY_LINE + line[_tail(line) :]


def _with_tls(line: str) -> str:
    tail = _tail(line)
    return TCP.sub("tls/", line[:tail]) + line[tail:]


def _tail(line: str) -> int:
    found = TAIL.search(line)
    return found.start() if found else len(line)


def _content(text: str) -> Any:
    try:
        return yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise BoardFileError("is not valid YAML") from error


def _wanted(content: Any) -> Any:
    if not isinstance(content, dict):
        raise BoardFileError("has no keys")
    zenoh = content.get("zenoh")
    changed = content | {"identity": IDENTITY_FOLDER}
    if isinstance(zenoh, dict):
        changed["zenoh"] = {key: _endpoints(value) for key, value in zenoh.items()}
    return changed


def _endpoints(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    return [re.sub("^tcp/", "tls/", one) if isinstance(one, str) else one for one in value]
