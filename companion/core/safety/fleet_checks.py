"""Checks of the fleet as a whole: positions on the ground before take-off, and spacing before formation.

Each vehicle checks by itself, from its fresh peers. A reported estimator error counts as one sigma, horizontally of both axes
together, and as independent of the errors of other vehicles. GNSS receivers side by side share atmospheric errors, but not
multipath and not always the satellites, and none reports how much of its error is shared.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from math import dist, hypot, inf, sqrt

from companion.types.autopilot import AutopilotKind, PositionError, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import ON_GROUND, RULES, FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import Place, Vector3

NO_ALTITUDE = "the autopilot has no origin, and takes off to an altitude above sea level"
SET_ORIGIN = (
    "wait for the position fix; indoors set the origin once after its start (SET_GPS_GLOBAL_ORIGIN, altitude 0)"
)
TWO_STREAMS = (
    "the sequence numbers or clocks of its packets go to and fro: two streams with this system id arrive in turn"
)
ONE_ID_EACH = "give each autopilot an id of its own (MAV_SYS_ID, SYSID_THISMAV), or let one arrive over one way only"
FORMED = frozenset({FlightPhase.ENGAGE, FlightPhase.FORMATION})
REFUSED_BELOW_SIGMAS = 3.0
WARNED_BELOW_SIGMAS = 6.0  # at 5.2 four vehicles once came within 0.12 m of each other


@dataclass(frozen=True, slots=True)
class Spacing:
    """Distance of two slots, and one sigma of both position errors along the line between them."""

    distance_m: float
    sigma_m: float

    @property
    def sigmas(self) -> float:
        if self.distance_m == 0.0:
            return 0.0
        return self.distance_m / self.sigma_m if self.sigma_m > 0.0 else inf


@dataclass(frozen=True, slots=True)
class FleetChecks:
    """`slots_have_height` is False where every vehicle keeps its own altitude: then only horizontal distance counts."""

    own_id: int
    slots_have_height: bool
    ground_spread_m: float
    separation_m: float  # horizontal, of any two vehicles on the ground
    take_off_by_altitude: frozenset[AutopilotKind] = frozenset()  # these need to know it

    def judge(
        self, name: CommandName, vehicle: VehicleState, slot: FlownSlot, peers: Collection[PeerPacket], role: Role
    ) -> tuple[Notice | None, Notice | None]:
        """(refusal, warning) for this command; None where there is none.

        `peers` are the fresh ones, `role` is this vehicle's own.
        """
        match name:
            case CommandName.ARM | CommandName.TAKEOFF:
                return _joined(self.lacks(vehicle, peers)), None
            case CommandName.LAND:
                return None, self._too_near(vehicle, peers)
            case CommandName.FORM:
                if refusal := self._other_formation(slot.formation, peers, role):
                    return refusal, None
                return self._too_close(vehicle.position_error, slot, peers)
        return None, None

    def lacks(self, vehicle: VehicleState, peers: Collection[PeerPacket]) -> tuple[Notice, ...]:
        """The reasons why the vehicle must not leave the ground, each with its subject first."""
        found = (
            Notice(Code.AUTOPILOT_ID_SHARED, f"autopilot: {TWO_STREAMS}; {ONE_ID_EACH}")
            if vehicle.interleaves
            else None,
            self._altitude_missing(vehicle),
            self._altitudes_differ(vehicle.position_enu_m[2], peers),
            self._too_near(vehicle, peers),
        )
        return tuple(filter(None, found))

    def _altitude_missing(self, vehicle: VehicleState) -> Notice | None:
        """A position, but no origin: motion capture alone gives none. The take-off would be refused with the motors on."""
        known = vehicle.altitude_amsl_m is not None or not vehicle.frame_known
        if known or vehicle.autopilot not in self.take_off_by_altitude:
            return None
        return Notice(Code.ALTITUDE_UNKNOWN, f"altitude: {NO_ALTITUDE}; {SET_ORIGIN}")

    def warnings(self, vehicle: VehicleState, peers: Collection[PeerPacket]) -> tuple[Notice, ...]:
        """What a vehicle on the ground may take off with, though it will not return."""
        shared = None
        if vehicle.home_enu_m is not None:
            shared = home_shared(self.own_id, self.separation_m, vehicle.home_enu_m, peers)
        return tuple(filter(None, (home_elsewhere(self.separation_m, vehicle), shared)))

    def _too_near(self, vehicle: VehicleState, peers: Collection[PeerPacket]) -> Notice | None:
        """The nearest peer below separation_m in the plane, on the ground or in flight: all climb and land vertically."""
        x, y, _ = vehicle.position_enu_m
        apart_m = {
            p.sender.vehicle_id: hypot(p.motion.position_enu_m[0] - x, p.motion.position_enu_m[1] - y) for p in peers
        }
        nearest = min(apart_m, key=apart_m.__getitem__, default=None)
        if nearest is None or apart_m[nearest] >= self.separation_m:
            return None
        return Notice(
            Code.VEHICLE_TOO_CLOSE,
            f"separation: in the plane vehicle {nearest} is {apart_m[nearest]:.2f} m from vehicle {self.own_id};"
            f" expected at least separation_m, {self.separation_m:g} m",
        )

    def _altitudes_differ(self, own_z_m: float, peers: Collection[PeerPacket]) -> Notice | None:
        z_m = {peer.sender.vehicle_id: peer.motion.position_enu_m[2] for peer in peers if peer.phase in ON_GROUND}
        z_m[self.own_id] = own_z_m
        low, high = min(z_m, key=z_m.__getitem__), max(z_m, key=z_m.__getitem__)
        spread_m = z_m[high] - z_m[low]
        if spread_m <= self.ground_spread_m:
            return None
        return Notice(
            Code.ALTITUDES_DIFFER,
            f"altitude: on the ground vehicle {high} is {spread_m:.1f} m above vehicle {low}, more than ground_spread_m"
            f" {self.ground_spread_m:g}",
        )

    def _other_formation(self, own: int, peers: Collection[PeerPacket], role: Role) -> Notice | None:
        """The refusal of a formation other than the one flown; before any is flown, other than the first leader's."""
        formed = [peer for peer in peers if peer.phase in FORMED]
        if flies := next((peer for peer in formed if peer.slot.formation != own), None):
            return Notice(
                Code.FORMATION_DIFFERS,
                f"this vehicle has formation {own}, vehicle {flies.sender.vehicle_id} flies {flies.slot.formation}; give this"
                " vehicle that formation first",
            )
        holding = [p for p in peers if p.role is Role.LEADER and p.phase is FlightPhase.HOLD]
        before = [p for p in holding if role is not Role.LEADER or p.sender.vehicle_id < self.own_id]
        first = min(before, key=lambda p: p.sender.vehicle_id, default=None)
        if formed or first is None or first.slot.formation == own:
            return None
        return Notice(
            Code.FORMATION_DIFFERS,
            f"this vehicle has formation {own}, leader {first.sender.vehicle_id} has {first.slot.formation}; command form to"
            " the leader alone first, then this vehicle adopts its formation",
        )

    def _too_close(
        self, own: PositionError | None, slot: FlownSlot, peers: Collection[PeerPacket]
    ) -> tuple[Notice | None, Notice | None]:
        reported = {self.own_id: own} | {peer.sender.vehicle_id: peer.position_error for peer in peers}
        silent = sorted(vehicle_id for vehicle_id, error in reported.items() if error is None)
        missing = f"no error reported by the estimator of vehicle {', '.join(map(str, silent))}"
        unknown = Notice(Code.POSITION_ERROR_UNKNOWN, missing) if silent else None
        if own is None:
            return None, unknown
        spacings = {
            p.sender.vehicle_id: self._spacing(own, slot, p.position_error, p.slot) for p in peers if p.position_error
        }
        nearest = min(spacings, key=lambda i: spacings[i].sigmas, default=None)
        if nearest is None or (spacing := spacings[nearest]).sigmas >= WARNED_BELOW_SIGMAS:
            return None, unknown
        text = (
            f"the slots of vehicles {self.own_id} and {nearest} are {spacing.distance_m:.1f} m apart,"
            f" {spacing.sigmas:.1f} sigma of their estimators' errors"
        )
        if spacing.sigmas < REFUSED_BELOW_SIGMAS:
            refusal = f"{text}; expected at least {_sigmas_and_metres(REFUSED_BELOW_SIGMAS, spacing)}"
            return Notice(Code.POSITION_ERROR_LARGE, refusal), None
        warning = f"{text}; better {_sigmas_and_metres(WARNED_BELOW_SIGMAS, spacing)}"
        return None, Notice(Code.POSITION_ERROR_LARGE, f"{warning}; {missing}" if silent else warning)

    def _spacing(self, own: PositionError, own_slot: FlownSlot, other: PositionError, other_slot: FlownSlot) -> Spacing:
        (x, y, z), (x0, y0, z0) = other_slot.position_enu_m, own_slot.position_enu_m
        level_m, up_m = hypot(x - x0, y - y0), z - z0 if self.slots_have_height else 0.0
        distance_m = hypot(level_m, up_m)
        level, up = (level_m / distance_m, up_m / distance_m) if distance_m > 0.0 else (1.0, 0.0)
        level_sigma_m = hypot(own.horizontal_m, other.horizontal_m) / sqrt(2.0)  # one axis of two
        return Spacing(distance_m, hypot(level * level_sigma_m, up * hypot(own.vertical_m, other.vertical_m)))


def _sigmas_and_metres(sigmas: float, spacing: Spacing) -> str:
    return f"{sigmas:g} sigma, {sigmas * spacing.sigma_m:.1f} m"


def _joined(notices: Collection[Notice]) -> Notice | None:
    """One notice with the code of the first and all texts."""
    if not notices:
        return None
    return Notice(next(iter(notices)).code, "; ".join(notice.text for notice in notices))


# Phases in which a vehicle returns, may be commanded to, or (in OBSERVE) may return by a failsafe of its autopilot.
MAY_GO_HOME = RULES[CommandName.RETURN].allowed | {FlightPhase.RETURN, FlightPhase.OBSERVE}

ROUNDING_M = 0.001  # more than that of any distance computed here

Path = tuple[Place, Place]
"""A straight path from one place to another, metres east and north."""


def refusal_of_return(
    own_id: int, separation_m: float, vehicle: VehicleState, peers: Collection[PeerPacket]
) -> Notice | None:
    """The reason why this vehicle must not return home now; None where it may.

    `peers` are all fresh peers. The autopilot returns to its home, which any ground station may have set.
    """
    if vehicle.returns_elsewhere:
        return Notice(Code.RETURNS_ELSEWHERE, f"{vehicle.returns_elsewhere}; land instead")
    home = vehicle.home_enu_m
    if home is None:
        return Notice(Code.HOME_UNKNOWN, "its home is unknown: no HOME_POSITION from the autopilot; land instead")
    if shared := home_shared(own_id, separation_m, home, peers):
        return Notice(shared.code, f"{shared.text}; land instead")
    own = (_level(vehicle.position_enu_m), home)
    apart_m = {vehicle_id: apart(own, path) for vehicle_id, path in _paths_near(own, separation_m, peers)}
    nearest = min(apart_m, key=apart_m.__getitem__, default=None)
    if nearest is None or apart_m[nearest] >= separation_m:
        return None
    return Notice(
        Code.RETURN_PATH_TOO_CLOSE,
        f"separation: on its straight path home vehicle {own_id} comes within {apart_m[nearest]:.2f} m of vehicle {nearest}"
        f" or of its path home; expected at least separation_m, {separation_m:g} m; land instead",
    )


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


def id_shared(vehicle: VehicleState) -> Notice | None:
    """Two autopilots would obey each command."""
    if not vehicle.interleaves:
        return None
    return Notice(Code.AUTOPILOT_ID_SHARED, f"autopilot: {TWO_STREAMS}; {ONE_ID_EACH}")


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


def _paths_near(own: Path, separation_m: float, peers: Iterable[PeerPacket]) -> Iterator[tuple[int, Path]]:
    """(vehicle id, path) of the peers, without paths that one comparison of coordinates shows to be farther away."""
    (x0, y0), (x1, y1) = own
    around_m = separation_m + ROUNDING_M
    west, east = min(x0, x1) - around_m, max(x0, x1) + around_m
    south, north = min(y0, y1) - around_m, max(y0, y1) + around_m
    for peer in peers:
        path = _path_of(peer)
        (x0, y0), (x1, y1) = path
        beside = (x0 > east and x1 > east) or (x0 < west and x1 < west)
        if not (beside or (y0 > north and y1 > north) or (y0 < south and y1 < south)):
            yield peer.sender.vehicle_id, path


def _path_of(peer: PeerPacket) -> Path:
    """The path home of a peer; its position alone where it does not return, or its home is unknown."""
    here = _level(peer.motion.position_enu_m)
    return here, here if peer.home_enu_m is None or peer.phase not in MAY_GO_HOME else peer.home_enu_m


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
    share = min(max(share, 0.0), 1.0)
    return hypot(x - x0 - share * east, y - y0 - share * north)
