"""Ways home: who may return by its autopilot's own mode without coming near another.

On the way home autopilots know nothing of each other, and climb to one altitude. So ways are judged in the plane alone and as
a whole: vehicles whose straight ways home nowhere come near each other do not either, however fast or late each one flies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import hypot

from companion.core.phase import RULES
from companion.types import CommandName, FlightPhase, PeerPacket, Vector3, VehicleState

# Those that return, or may be told to at any time; and one that is not flown by its agent may be on its way home unasked.
MAY_GO_HOME = RULES[CommandName.RETURN].allowed | {FlightPhase.RETURN, FlightPhase.OBSERVE}

Way = tuple[tuple[float, float], tuple[float, float]]
"""From where to where, straight: metres east and north."""


def refusal_of_return(
    own_id: int,
    separation_m: float,
    vehicle: VehicleState,
    peers: Iterable[PeerPacket],
    stood_enu_m: Mapping[int, Vector3],
) -> str:
    """Why this vehicle must not go home just now; "" where it may.

    `peers` are all that are heard of. `stood_enu_m` is where each was last heard of on the ground, which is where its autopilot
    would bring it.
    """
    if vehicle.stood_enu_m is None:
        return "its way home is unknown, as this agent has not seen it stand on the ground; land instead"
    own = _way(vehicle.position_enu_m, vehicle.stood_enu_m)
    apart_m = {peer.vehicle_id: apart(own, _way_of(peer, stood_enu_m)) for peer in peers}
    nearest = min(apart_m, key=apart_m.__getitem__, default=None)
    if nearest is None or apart_m[nearest] >= separation_m:
        return ""
    return (
        f"separation: on its straight way home vehicle {own_id} comes within {apart_m[nearest]:.2f} m of vehicle {nearest}"
        f" or of its way home; expected at least separation_m, {separation_m:g} m; land instead"
    )


def _way_of(peer: PeerPacket, stood_enu_m: Mapping[int, Vector3]) -> Way:
    """A place alone where it stays there, or where its home is unknown."""
    here = peer.position_enu_m
    return _way(here, stood_enu_m.get(peer.vehicle_id, here) if peer.phase in MAY_GO_HOME else here)


def apart(a: Way, b: Way) -> float:
    """The smallest distance of two straight ways, metres; 0 where they cross."""
    if _cross(a, b):
        return 0.0
    return min(_off(a[0], b), _off(a[1], b), _off(b[0], a), _off(b[1], a))


def _way(here_enu_m: Vector3, home_enu_m: Vector3) -> Way:
    return (here_enu_m[0], here_enu_m[1]), (home_enu_m[0], home_enu_m[1])


def _side(point: tuple[float, float], way: Way) -> float:
    """Above 0 to the left of the line through it, below 0 to its right."""
    (x0, y0), (x1, y1) = way
    return (x1 - x0) * (point[1] - y0) - (y1 - y0) * (point[0] - x0)


def _cross(a: Way, b: Way) -> bool:
    """Inside both; where only an end touches, its distance says so."""
    return _side(a[0], b) * _side(a[1], b) < 0.0 and _side(b[0], a) * _side(b[1], a) < 0.0


def _off(point: tuple[float, float], way: Way) -> float:
    """A point's distance from the nearest place on a way."""
    (x, y), ((x0, y0), (x1, y1)) = point, way
    east, north = x1 - x0, y1 - y0
    squared = east * east + north * north
    share = ((x - x0) * east + (y - y0) * north) / squared if squared > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return hypot(x - x0 - share * east, y - y0 - share * north)
