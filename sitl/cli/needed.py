"""Packages that the base install does not contain, and the commands that need them."""

from __future__ import annotations

from importlib.util import find_spec

from companion import GROUND_INSTALL
from companion.config.file import ConfigError

NEEDED: dict[str, tuple[str, ...]] = {
    "fly": ("matplotlib", "rich"),
    "fleet": ("rich",),
    "run": ("matplotlib", "rich"),
    "sweep": ("matplotlib", "rich"),
    "study": ("matplotlib", "rich", "scipy"),
    "gauntlet": ("matplotlib", "rich", "scipy"),
    "switching": ("matplotlib", "rich", "scipy"),
    "paper": ("matplotlib", "jinja2", "rich", "scipy"),
}


def check_installed(command: str) -> None:
    """To be called before any module of the command is imported. Raises ConfigError."""
    missing = [package for package in NEEDED.get(command, ()) if find_spec(package) is None]
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        raise ConfigError(f"sitl {command}", ", ".join(missing), f"{verb} not installed; {GROUND_INSTALL}")
