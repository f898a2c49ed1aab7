"""The stand-in autopilots by type, one folder each and one line here; and the files of `sitl autopilot --config`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec

from companion.config.file import ConfigError, load, refuse
from companion.config.validation import Problem, did_you_mean
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.ardupilot.link import ARDUPILOT
from sitl.autopilots.autopilot import known_or
from sitl.autopilots.link_end import AutopilotType
from sitl.autopilots.px4.link import PX4
from sitl.vehicle.config import AutopilotFile, StandIn

AUTOPILOT_TYPES: dict[AutopilotKind, AutopilotType] = {AutopilotKind.PX4: PX4, AutopilotKind.ARDUPILOT: ARDUPILOT}


def hover_thrust_norm(stand_in: StandIn) -> float:
    """The hover thrust of its stand-ins, 0 to 1."""
    return known_or(stand_in.airframe.hover_thrust_norm, AUTOPILOT_TYPES[stand_in.autopilot].data.hover_thrust_norm)


def load_autopilot_files(
    paths: Sequence[Path] | None, vehicle_id: int | None, autopilot: AutopilotKind | None
) -> list[AutopilotFile]:
    """The files, or defaults without one, with another id and autopilot where they are given. Raises ConfigError."""
    if vehicle_id is not None and paths and len(paths) > 1:
        raise ConfigError("--id", "", f"one id for {len(paths)} vehicles: set the ids in their files")
    files: dict[int, AutopilotFile] = {}
    for path in paths or (None,):
        file = _loaded(path, vehicle_id, autopilot)
        if file.id in files:
            raise ConfigError(path or "", "id", f"{file.id} is the id of an earlier file, too: expected another one")
        files[file.id] = file
    return list(files.values())


def _loaded(path: Path | None, vehicle_id: int | None, autopilot: AutopilotKind | None) -> AutopilotFile:
    file = load(path, AutopilotFile) if path else AutopilotFile()
    if vehicle_id is not None:
        if not 1 <= vehicle_id <= 250:
            raise ConfigError("--id", "", f"{vehicle_id}: expected 1 to 250")
        file = msgspec.structs.replace(file, id=vehicle_id)
    if autopilot is not None:
        file = msgspec.structs.replace(file, stand_in=msgspec.structs.replace(file.stand_in, autopilot=autopilot))
    refuse(path or "", parameter_problems(file.stand_in.autopilot, file.stand_in.parameters))
    return file


def parameter_problems(kind: AutopilotKind, names: Iterable[str], where: str = "stand_in") -> Iterator[Problem]:
    """Every overridden parameter must exist in this autopilot. `where`: the section of the stand-in."""
    known = AUTOPILOT_TYPES[kind].data.parameters
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known) or "; take it out"
            problem = f"the stand-in ({kind}) has no such parameter{hint}"
            yield Problem(f"{where}.parameters.{name}", problem)
