"""The file of `sitl autopilot --config`, with what the command line says instead."""

from __future__ import annotations

from pathlib import Path

import msgspec

from companion.config_file import ConfigError, load
from sitl.config import AutopilotFile
from sitl.px4_parameters import DEFAULTS


def load_autopilot_file(path: Path | None, vehicle_id: int | None) -> AutopilotFile:
    """The file, or defaults without one. Raises ConfigError."""
    file = load(path, AutopilotFile) if path else AutopilotFile()
    if vehicle_id is not None:
        if not 1 <= vehicle_id <= 250:
            raise ConfigError("--id", "", f"{vehicle_id}: expected 1 to 250")
        file = msgspec.structs.replace(file, id=vehicle_id)
    for name in file.stand_in.parameters:
        if name not in DEFAULTS:
            raise ConfigError(path or "", f"stand_in.parameters.{name}", "the stand-in has no such parameter")
    return file
