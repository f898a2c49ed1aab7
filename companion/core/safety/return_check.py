"""Whether a vehicle may return: its autopilot flies straight home, and autopilots do not avoid each other.

A vehicle in motion stops first, and its path home begins there. The present place and that of the stop count, as autopilots
brake harder than agents. Of two vehicles the same of both counts: where two brake side by side, they stop side by side.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import dist, hypot, sqrt

from companion.core.consensus.peers import PeerState
from companion.types.autopilot import PositionError, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import RULES, STREAMING, FlightPhase
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import Place, Vector3

# Phases in which a vehicle returns, may be commanded to, or (in OBSERVE) may return by a failsafe of its autopilot.
MAY_GO_HOME = RULES[CommandName.RETURN].allowed | {FlightPhase.RETURN, FlightPhase.OBSERVE}

ON_THE_WAY_SIGMAS = 3.0  # of both position errors: the distance to a vehicle that already returns, as of slots
ROUNDING_M = 0.001  # more than that of any distance computed here
LAND_INSTEAD = "land instead"

Path = tuple[Place, Place]
"""A straight path from one place to another, metres east and north."""


@dataclass(frozen=True, slots=True)
class ReturnCheck:
    """Settings of the check. Agents brake by `braking_m_s2` before a hand-over, which begins and ends within `responds_s`.

    A follower flies on for `goes_on_s` without a leader.
    """

    own_id: int
    separation_m: float
    braking_m_s2: float
    responds_s: float
    goes_on_s: float

    def refusal(self, vehicle: VehicleState, peers: Iterable[PeerState], leads_alone: bool) -> Notice | None:
        """The reason why this vehicle must not return home now; None where it may.

        `peers` are all fresh peers, in whatever phase. `leads_alone`: those in formation stop when this vehicle leaves it.
        The autopilot returns to its home, which any ground station may have set.
        """
        if vehicle.returns_elsewhere:
            return Notice(Code.RETURNS_ELSEWHERE, f"{vehicle.returns_elsewhere}; {LAND_INSTEAD}")
        home = vehicle.home_enu_m
        if home is None:
            return Notice(
                Code.HOME_UNKNOWN, f"its home is unknown: no HOME_POSITION from the autopilot; {LAND_INSTEAD}"
            )
        peers = tuple(peers)
        if shared := home_shared(self.own_id, self.separation_m, home, [peer.packet for peer in peers]):
            return Notice(shared.code, f"{shared.text}; {LAND_INSTEAD}")
        lacking_m, apart_m, peer_id = min(self._lacking(vehicle, home, peers, leads_alone), default=(0.0, 0.0, 0))
        if lacking_m >= 0.0:
            return None
        by_noise, expected_m = f"{ON_THE_WAY_SIGMAS:g} sigma of both positions", apart_m - lacking_m
        name = by_noise if expected_m > self.separation_m + ROUNDING_M else "separation_m"
        return Notice(
            Code.RETURN_PATH_TOO_CLOSE,
            f"separation: on its straight path home vehicle {self.own_id} comes within {apart_m:.2f} m of vehicle {peer_id}"
            f" or of its path home; expected at least {name}, {expected_m:.3g} m; {LAND_INSTEAD}",
        )

    def _lacking(
        self, vehicle: VehicleState, home: Place, peers: Iterable[PeerState], leads_alone: bool
    ) -> Iterator[tuple[float, float, int]]:
        """(distance without the one to keep, distance, vehicle id) of the peers that may be near."""
        here = _level(vehicle.position_enu_m)
        stop = self._stop(here, vehicle.velocity_enu_m_s)
        own = ((here, home), (stop, home))
        for peer in peers:
            packet = peer.packet
            required_m = self._required_m(vehicle.position_error, packet)
            there = _level(peer.position_at(max(vehicle.position_time_s, peer.measured_s)))
            its_home = packet.home_enu_m if packet.phase in MAY_GO_HOME else None
            returns_to = its_home if packet.phase is FlightPhase.RETURN else None
            its_stop = self._stop(there, packet.motion.velocity_enu_m_s, returns_to)
            pairs = [(own[0], (there, its_home or there)), (own[1], (its_stop, its_home or its_stop))]
            if leads_alone and packet.phase in STREAMING:
                pairs.append((own[1], (its_stop, self._later(its_stop, packet.motion.velocity_enu_m_s))))
            for path, other in pairs:
                if _may_be_near(path, other, required_m):
                    apart_m = apart(path, other)
                    yield apart_m - required_m, apart_m, packet.sender.vehicle_id

    def _required_m(self, error: PositionError | None, peer: PeerPacket) -> float:
        """`separation_m`; to a vehicle that already returns also ON_THE_WAY_SIGMAS, as no agent keeps that distance."""
        if peer.phase is not FlightPhase.RETURN or error is None or peer.position_error is None:
            return self.separation_m
        sigma_m = hypot(error.horizontal_m, peer.position_error.horizontal_m) / sqrt(2.0)  # along one axis of two
        return max(self.separation_m, ON_THE_WAY_SIGMAS * sigma_m)

    def _stop(self, here: Place, velocity_enu_m_s: Vector3, home: Place | None = None) -> Place:
        """Where it stops; at its home at the latest, where it returns to one already."""
        (x, y), (vx, vy, _) = here, velocity_enu_m_s
        speed_m_s = hypot(vx, vy)
        lasts_s = self.responds_s + speed_m_s / (2.0 * self.braking_m_s2)
        if home is not None:
            east_m, north_m = home[0] - x, home[1] - y
            if lasts_s * (vx * east_m + vy * north_m) > east_m * east_m + north_m * north_m:
                return home
        return (x + lasts_s * vx, y + lasts_s * vy)

    def _later(self, stop: Place, velocity_enu_m_s: Vector3) -> Place:
        """The place of a stop that begins `goes_on_s` later."""
        return (stop[0] + self.goes_on_s * velocity_enu_m_s[0], stop[1] + self.goes_on_s * velocity_enu_m_s[1])


def home_shared(own_id: int, separation_m: float, home: Place, peers: Iterable[PeerPacket]) -> Notice | None:
    """The home of a peer nearer than separation_m to this one's, in whatever phase that peer is: it may return later."""
    homes = {peer.sender.vehicle_id: peer.home_enu_m for peer in peers if peer.home_enu_m is not None}
    apart_m = {vehicle_id: dist(home, other) for vehicle_id, other in homes.items()}
    nearest = min(apart_m, key=apart_m.__getitem__, default=None)
    if nearest is None or apart_m[nearest] >= separation_m:
        return None
    return Notice(
        Code.HOME_SHARED,
        f"home: the autopilots of vehicles {own_id} and {nearest} have homes {apart_m[nearest]:.2f} m apart; expected at"
        f" least separation_m, {separation_m:g} m",
    )


def home_elsewhere(separation_m: float, vehicle: VehicleState) -> Notice | None:
    """The home of a vehicle on the ground that is not where it stands, as after a ground station has set it."""
    if vehicle.home_enu_m is None:
        return None
    apart_m = dist(vehicle.home_enu_m, _level(vehicle.position_enu_m))
    if apart_m < separation_m:
        return None
    east_m, north_m = vehicle.home_enu_m
    return Notice(
        Code.HOME_ELSEWHERE,
        f"home: the autopilot's is {apart_m:.1f} m from the vehicle, at {east_m:.1f}, {north_m:.1f} m; `return` ends there",
    )


def _may_be_near(a: Path, b: Path, within_m: float) -> bool:
    """False where one comparison of coordinates shows that the paths are farther apart."""
    around_m = within_m + ROUNDING_M
    for a0, a1, b0, b1 in zip(*a, *b, strict=True):  # east, then north
        low, high = (a0, a1) if a0 < a1 else (a1, a0)
        low, high = low - around_m, high + around_m
        if (b0 < low and b1 < low) or (b0 > high and b1 > high):
            return False
    return True


def apart(a: Path, b: Path) -> float:
    """Smallest distance of two straight paths in metres; 0 where they cross."""
    if _cross(a, b):
        return 0.0
    return min(_off(a[0], b), _off(a[1], b), _off(b[0], a), _off(b[1], a))


def _level(position_enu_m: Vector3) -> Place:
    return position_enu_m[0], position_enu_m[1]


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
    if share < 0.0:
        share = 0.0
    elif share > 1.0:
        share = 1.0
    return hypot(x - x0 - share * east, y - y0 - share * north)
