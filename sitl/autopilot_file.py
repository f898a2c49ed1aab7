"""The file of `sitl autopilot --config`, with what the command line says instead."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

import msgspec

from companion.config_file import ConfigError, load
from companion.types import AutopilotKind
from sitl.config import AutopilotFile, StandIn
from sitl.manners import MANNERS


def load_autopilot_file(path: Path | None, vehicle_id: int | None, autopilot: AutopilotKind | None) -> AutopilotFile:
    """The file, or defaults without one, with another id and autopilot where they are given. Raises ConfigError."""
    file = load(path, AutopilotFile) if path else AutopilotFile()
    if vehicle_id is not None:
        if not 1 <= vehicle_id <= 250:
            raise ConfigError("--id", "", f"{vehicle_id}: expected 1 to 250")
        file = msgspec.structs.replace(file, id=vehicle_id)
    if autopilot is not None:
        file = msgspec.structs.replace(file, stand_in=msgspec.structs.replace(file.stand_in, autopilot=autopilot))
    check_parameters(path or "", file.stand_in)
    return file


def check_parameters(path: Path | str, stand_in: StandIn) -> None:
    """Every overridden parameter must exist. Raises ConfigError that names the nearest."""
    known = MANNERS[stand_in.autopilot].parameters
    for name in stand_in.parameters:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f'; did you mean "{near[0]}"?' if near else "; take it out"
            problem = f"the stand-in ({stand_in.autopilot}) has no such parameter{hint}"
            raise ConfigError(path, f"stand_in.parameters.{name}", problem)
