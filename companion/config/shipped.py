"""The scenarios that are installed with the program: found by their names, and listed."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path

from companion.config.file import ConfigError, read_yaml
from companion.config.law import LawSection

SHIPPED = (
    Path(__file__).parents[2] / "sitl" / "scenarios"
)  # package data: a link to config/scenarios in the source tree
MOST_HINTS = 3


def scenario_file(given: Path) -> Path:
    """The file of a scenario that is given by its path, or a shipped one by its name. Raises ConfigError."""
    name = str(given)
    if given.suffix or given.name != name or given.is_file():
        return given
    shipped = SHIPPED / f"{name}.yaml"
    if shipped.is_file():
        return shipped
    near = get_close_matches(name, shipped_names(), n=MOST_HINTS)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise ConfigError(
        name, "", f"no such file, and no shipped scenario of this name; {hint}`sitl scenarios` lists them"
    )


def shipped_names() -> list[str]:
    """The names of all shipped scenarios, sorted."""
    return sorted(file.stem for file in SHIPPED.glob("*.yaml"))


def shipped_lines() -> Iterator[str]:
    """A line for each shipped scenario: name, vehicles, law, and the first sentence of its description."""
    names = shipped_names()
    for name in names:
        content = read_yaml(SHIPPED / f"{name}.yaml")
        fleet, (sentence, _, _) = content["fleet"], content["description"].partition(". ")
        count = fleet["vehicles"] if isinstance(fleet["vehicles"], int) else len(fleet["vehicles"])
        law = fleet.get("law", {}).get("name", LawSection().name)
        yield f"{name:<{max(map(len, names))}}  {count:>3} vehicles  {law:<11}  {sentence.rstrip('.')}."
