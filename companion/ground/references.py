"""The command that changes the reference trajectory (RFT): its content, its number and the time it begins."""

from __future__ import annotations

from collections.abc import Sequence

from companion.config.file import ConfigError, convert
from companion.config.reference import Reference, ReferenceSection, load_reference
from companion.ground.fleet_time import AHEAD_S, fleet_time_s
from companion.ground.requests import ReferenceRequest, command_line
from companion.types.commands import Described, ReferenceChange, next_for_all
from companion.types.status import Status
from companion.types.values import Vector3

POSITION_KEY = {
    "point": "point_enu_m",
    "waypoints": "points_enu_m",
    "circle": "centre_enu_m",
    "figure_8": "centre_enu_m",
    "target": "start_enu_m",
}


def reference_change(reference: Described, statuses: Sequence[Status]) -> ReferenceChange:
    """`reference` as in a file, with the next number, AHEAD_S after the fleet time of these reports."""
    held = [status.reference for status in statuses if status.reference]
    number = next_for_all(number for one in held for number in (one.flown, one.waiting))
    return ReferenceChange(number, reference, fleet_time_s(statuses) + AHEAD_S)


def requested_reference(request: ReferenceRequest, here_enu_m: Vector3 | None) -> Reference:
    """The reference of a request. A target without a position is awaited `here_enu_m`. Raises ConfigError."""
    if request.whole is not None:
        return request.whole
    if request.file is not None:
        if request.described or request.positions_enu_m:
            raise ConfigError(
                command_line("reference"),
                "--file",
                "describes the whole reference; give it alone, or KIND with its options",
            )
        return load_reference(request.file)
    described = request.described
    kind = described.get("kind")
    if not isinstance(kind, str):
        raise ConfigError(
            command_line("reference"), "KIND", f"missing; expected one of {', '.join(POSITION_KEY)}, or --file FILE"
        )
    positions = [list(position) for position in request.positions_enu_m]
    if kind == "target" and not positions and here_enu_m is not None:
        positions = [list(here_enu_m)]
    if kind == "target" and not positions:
        raise ConfigError(
            command_line("reference"),
            "--at",
            "missing; no leader reports a reference: give the position to await the target at",
        )
    if not positions or (len(positions) > 1 and kind != "waypoints"):
        expected = "one or more" if kind == "waypoints" else "one"
        raise ConfigError(
            command_line("reference"), "--at", f"given {len(positions)} times; a reference {kind} has {expected}"
        )
    position = {POSITION_KEY[kind]: positions if kind == "waypoints" else positions[0]}
    return convert(command_line("reference"), {"reference": described | position}, ReferenceSection).reference
