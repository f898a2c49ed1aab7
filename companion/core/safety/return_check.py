"""Return check: whether a vehicle can return in its autopilot's own mode without coming near another vehicle.

On the path home autopilots do not know of each other, and climb to one altitude. So paths are checked horizontally and as a
whole: vehicles whose straight paths stay apart stay apart themselves, at any speed and start time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import hypot

from companion.types.autopilot import VehicleState
from companion.types.commands import CommandName
from companion.types.flight import RULES, FlightPhase
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import Vector3

# Phases in which a vehicle returns, may be commanded to, or (in OBSERVE) may return by a failsafe of its autopilot.
MAY_GO_HOME = RULES[CommandName.RETURN].allowed | {FlightPhase.RETURN, FlightPhase.OBSERVE}

ROUNDING_M = 0.001  # more than that of any distance computed here

Path = tuple[tuple[float, float], tuple[float, float]]
"""A straight path from one position to another, metres east and north."""


def refusal_of_return(
    own_id: int,
    separation_m: float,
    vehicle: VehicleState,
    peers: Iterable[PeerPacket],
    ground_position_enu_m: Mapping[int, Vector3],
) -> Notice | None:
    """The reason why this vehicle must not return home now; None where it may.

    `peers` are all fresh peers. `ground_position_enu_m` is where each was last on the ground, which is where its autopilot
    returns to.
    """
    if vehicle.ground_position_enu_m is None:
        text = "its home is unknown, as this agent has not seen it on the ground; land instead"
        return Notice(Code.HOME_UNKNOWN, text)
    own = _path(vehicle.position_enu_m, vehicle.ground_position_enu_m)
    near = _paths_near(own, separation_m, peers, ground_position_enu_m)
    apart_m = {vehicle_id: apart(own, path) for vehicle_id, path in near}
    nearest = min(apart_m, key=apart_m.__getitem__, default=None)
    if nearest is None or apart_m[nearest] >= separation_m:
        return None
    return Notice(
        Code.RETURN_PATH_TOO_CLOSE,
        f"separation: on its straight path home vehicle {own_id} comes within {apart_m[nearest]:.2f} m of vehicle {nearest}"
        f" or of its path home; expected at least separation_m, {separation_m:g} m; land instead",
    )


def _paths_near(
    own: Path, separation_m: float, peers: Iterable[PeerPacket], ground_position_enu_m: Mapping[int, Vector3]
) -> Iterator[tuple[int, Path]]:
    """(vehicle id, path) of the peers, without paths that one comparison of coordinates shows to be farther away."""
    (x0, y0), (x1, y1) = own
    around_m = separation_m + ROUNDING_M
    west, east = min(x0, x1) - around_m, max(x0, x1) + around_m
    south, north = min(y0, y1) - around_m, max(y0, y1) + around_m
    for peer in peers:
        path = _path_of(peer, ground_position_enu_m)
        (x0, y0), (x1, y1) = path
        beside = (x0 > east and x1 > east) or (x0 < west and x1 < west)
        if not (beside or (y0 > north and y1 > north) or (y0 < south and y1 < south)):
            yield peer.vehicle_id, path


def _path_of(peer: PeerPacket, ground_position_enu_m: Mapping[int, Vector3]) -> Path:
    """The path home of a peer; its position alone where it does not return, or its home is unknown."""
    here = peer.position_enu_m
    return _path(here, ground_position_enu_m.get(peer.vehicle_id, here) if peer.phase in MAY_GO_HOME else here)


def apart(a: Path, b: Path) -> float:
    """Smallest distance of two straight paths in metres; 0 where they cross."""
    if _cross(a, b):
        return 0.0
    return min(_off(a[0], b), _off(a[1], b), _off(b[0], a), _off(b[1], a))


def _path(here_enu_m: Vector3, home_enu_m: Vector3) -> Path:
    return (here_enu_m[0], here_enu_m[1]), (home_enu_m[0], home_enu_m[1])


def _side(point: tuple[float, float], path: Path) -> float:
    """Positive to the left of the line through the path, negative to its right."""
    (x0, y0), (x1, y1) = path
    return (x1 - x0) * (point[1] - y0) - (y1 - y0) * (point[0] - x0)


def _cross(a: Path, b: Path) -> bool:
    """Whether the paths cross inside both; an end that only touches has distance 0 in `_off`."""
    return _side(a[0], b) * _side(a[1], b) < 0.0 and _side(b[0], a) * _side(b[1], a) < 0.0


def _off(point: tuple[float, float], path: Path) -> float:
    """Distance of a point from the nearest point of a path."""
    (x, y), ((x0, y0), (x1, y1)) = point, path
    east, north = x1 - x0, y1 - y0
    squared = east * east + north * north
    share = ((x - x0) * east + (y - y0) * north) / squared if squared > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return hypot(x - x0 - share * east, y - y0 - share * north)
