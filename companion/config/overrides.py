"""KEY.PATH=VALUE of a command line: one value in the plain content of a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml

from companion.config.file import ConfigError, StrictLoader

SET = Path("--set")  # named in errors instead of a file
LONGEST_KEY = 200


def overridden(data: Any, overrides: Sequence[str], example: str) -> Any:
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
        raise ConfigError(SET, field, f"{text!r} is not a YAML value") from error
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
        raise ConfigError(SET, place, f"is {node!r}, which has no keys inside; set it as a whole")
    if not isinstance(step, int):
        raise ConfigError(
            SET, f"{place}.{step}", f"{place} is a list; expected a number, {place}[0] to [{len(node) - 1}]"
        )
    if step >= len(node):
        raise ConfigError(SET, f"{place}[{step}]", f"no such item; expected {place}[0] to [{len(node) - 1}]")
