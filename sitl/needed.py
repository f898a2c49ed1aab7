"""Packages that the base install leaves out, and which commands need them."""

from __future__ import annotations

from importlib.util import find_spec

from companion import GROUND_INSTALL
from companion.config_file import ConfigError

NEEDED: dict[str, tuple[str, ...]] = {
    "fly": ("matplotlib",),
    "run": ("matplotlib",),
    "sweep": ("matplotlib",),
    "study": ("matplotlib", "scipy"),
    "switching": ("matplotlib", "scipy"),
    "paper": ("matplotlib", "jinja2", "scipy"),
}


def check_installed(command: str) -> None:
    """Before any of the command's modules is imported. Raises ConfigError."""
    missing = [package for package in NEEDED.get(command, ()) if find_spec(package) is None]
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        raise ConfigError(f"sitl {command}", ", ".join(missing), f"{verb} not installed; {GROUND_INSTALL}")
