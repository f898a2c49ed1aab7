"""The file of `sitl autopilot --config`, with what the command line says instead."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

import msgspec

from companion.config_file import ConfigError, load
from sitl.config import AutopilotFile, StandIn
from sitl.px4_parameters import DEFAULTS


def load_autopilot_file(path: Path | None, vehicle_id: int | None) -> AutopilotFile:
    """The file, or defaults without one. Raises ConfigError."""
    file = load(path, AutopilotFile) if path else AutopilotFile()
    if vehicle_id is not None:
        if not 1 <= vehicle_id <= 250:
            raise ConfigError("--id", "", f"{vehicle_id}: expected 1 to 250")
        file = msgspec.structs.replace(file, id=vehicle_id)
    check_parameters(path or "", file.stand_in)
    return file


def check_parameters(path: Path | str, stand_in: StandIn) -> None:
    """Every overridden parameter must exist. Raises ConfigError that names the nearest."""
    for name in stand_in.parameters:
        if name not in DEFAULTS:
            near = get_close_matches(name, DEFAULTS, n=1)
            hint = f'; did you mean "{near[0]}"?' if near else "; take it out"
            raise ConfigError(path, f"stand_in.parameters.{name}", f"the stand-in has no such parameter{hint}")
