"""The stand-in autopilots by make, behind one interface for flights in virtual and in real time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.config.file import ConfigError, load, refuse
from companion.config.validation import Problem, did_you_mean
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.ardupilot import link as ardupilot_link_end
from sitl.autopilots.ardupilot import parameters as ardupilot_parameters
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.link_end import LinkEnd
from sitl.autopilots.px4 import link as px4_link_end
from sitl.autopilots.px4 import parameters as px4_parameters
from sitl.autopilots.px4.autopilot import Px4
from sitl.vehicle.config import AutopilotFile, StandIn


@dataclass(frozen=True, slots=True)
class AutopilotType:
    """What differs between the makes: the autopilot, its link ends, its parameters with their defaults.

    `tcp_link` is None for an autopilot that does not listen on TCP.
    """

    vehicle: Callable[[AutopilotFile, float], Autopilot]
    onboard_link: Callable[[Autopilot], LinkEnd]
    ground_link: Callable[[Autopilot], LinkEnd]
    tcp_link: Callable[[Autopilot], LinkEnd] | None
    parameters: Mapping[str, float]


AUTOPILOT_TYPES: dict[AutopilotKind, AutopilotType] = {
    AutopilotKind.PX4: AutopilotType(
        Px4, px4_link_end.onboard_link, px4_link_end.ground_link, None, px4_parameters.DEFAULTS
    ),
    AutopilotKind.ARDUPILOT: AutopilotType(
        ArduCopter,
        ardupilot_link_end.onboard_link,
        ardupilot_link_end.ground_link,
        ardupilot_link_end.tcp_link,
        ardupilot_parameters.DEFAULTS,
    ),
}


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
    refuse(path or "", parameter_problems(file.stand_in))
    return file


def parameter_problems(stand_in: StandIn) -> Iterator[Problem]:
    """Every overridden parameter must exist in this autopilot."""
    known = AUTOPILOT_TYPES[stand_in.autopilot].parameters
    for name in stand_in.parameters:
        if name not in known:
            hint = did_you_mean(name, known) or "; take it out"
            problem = f"the stand-in ({stand_in.autopilot}) has no such parameter{hint}"
            yield Problem(f"stand_in.parameters.{name}", problem)
