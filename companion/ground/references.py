"""From a described RFT to a command for every vehicle that may lead: in which number, and when it begins."""

from __future__ import annotations

from collections.abc import Sequence

from companion.arguments import COMMAND_LINE
from companion.config.reference import Reference, ReferenceSection, load_reference
from companion.config_file import ConfigError, convert
from companion.fleet_where_options import ReferenceWish
from companion.ground.fleet_time import AHEAD_S, fleet_time_s
from companion.types import Described, ReferenceChange, Status, Vector3

KEY_OF_PLACE = {
    "point": "point_enu_m",
    "waypoints": "points_enu_m",
    "circle": "centre_enu_m",
    "figure_8": "centre_enu_m",
    "target": "start_enu_m",
}


def reference_change(reference: Described, statuses: Sequence[Status]) -> ReferenceChange:
    """`reference` as a file has it; in the next number, and soon by the fleet's own time."""
    numbers = (status.reference.waiting for status in statuses if status.reference)
    return ReferenceChange(max(numbers, default=0) + 1, reference, fleet_time_s(statuses) + AHEAD_S)


def wished(wish: ReferenceWish, here_enu_m: Vector3 | None) -> Reference:
    """What a file or a command line describes; a target is waited for `here_enu_m` unless it says where. Raises ConfigError."""
    if wish.file is not None:
        if wish.described or wish.places_enu_m:
            raise ConfigError(COMMAND_LINE, "--file", "says all by itself; expected it alone, or KIND with its options")
        return load_reference(wish.file)
    described = wish.described
    kind = described.get("kind")
    if not isinstance(kind, str):
        raise ConfigError(COMMAND_LINE, "KIND", f"missing; expected one of {', '.join(KEY_OF_PLACE)}, or --file FILE")
    places = [list(place) for place in wish.places_enu_m]
    if kind == "target" and not places and here_enu_m is not None:
        places = [list(here_enu_m)]
    if kind == "target" and not places:
        raise ConfigError(
            COMMAND_LINE, "--at", "missing; nobody is heard to lead, so say where the target is waited for"
        )
    if not places or (len(places) > 1 and kind != "waypoints"):
        expected = "one or more" if kind == "waypoints" else "one"
        raise ConfigError(COMMAND_LINE, "--at", f"given {len(places)} times; a reference {kind} has {expected}")
    place = {KEY_OF_PLACE[kind]: places if kind == "waypoints" else places[0]}
    return convert(COMMAND_LINE, {"reference": described | place}, ReferenceSection).reference
