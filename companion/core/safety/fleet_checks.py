"""Checks of the fleet as a whole: positions on the ground before take-off, and spacing before formation.

Each vehicle checks by itself, from its fresh peers. A reported estimator error counts as one sigma, horizontally of both axes
together, and as independent of the errors of other vehicles. GNSS receivers side by side share atmospheric errors, but not
multipath and not always the satellites, and none reports how much of its error is shared.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import dist, hypot, inf, sqrt

from companion.core.consensus.peers import PeerState
from companion.core.safety.return_check import ReturnCheck, home_elsewhere, home_shared
from companion.types.autopilot import AutopilotKind, PositionError, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import ON_GROUND, FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import Vector3

NO_ALTITUDE = "the autopilot has no origin, and takes off to an altitude above sea level"
SET_ORIGIN = (
    "wait for the position fix; indoors set the origin once after its start (SET_GPS_GLOBAL_ORIGIN, altitude 0)"
)
TWO_STREAMS = (
    "two streams with this system id arrive in turn: from two addresses, or sequence numbers or clocks go to and fro"
)
ONE_ID_EACH = "give each autopilot an id of its own (MAV_SYS_ID, SYSID_THISMAV), or let one arrive over one way only"
FORMED = frozenset({FlightPhase.ENGAGE, FlightPhase.FORMATION})
REFUSED_BELOW_SIGMAS = 3.0
WARNED_BELOW_SIGMAS = 6.0  # at 5.2 four vehicles once came within 0.12 m of each other
SLOW_M_S = 1.0  # a vehicle under a pilot, or on its way to another slot, comes with so much


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
    returns: ReturnCheck
    successors: frozenset[int] = frozenset()
    take_off_by_altitude: frozenset[AutopilotKind] = frozenset()  # these need to know it
    slow_to_brake: Notice | None = None  # `slow_to_brake` of the fleet file

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
                return None, _joined(self._warnings_before_landing(vehicle, peers, role))
            case CommandName.RETURN:
                return None, self._stranded(peers, role)
            case CommandName.FORM:
                if refusal := self._other_formation(slot.formation, peers, role):
                    return refusal, None
                return self._too_close(vehicle.position_error, slot, peers)
        return None, None

    def refusal_of_return(self, vehicle: VehicleState, peers: Collection[PeerState], role: Role) -> Notice | None:
        """`peers` are the fresh ones. Followers without another leader stop where they are."""
        return self.returns.refusal(vehicle, peers, bool(self._followers([peer.packet for peer in peers], role)))

    def _followers(self, peers: Collection[PeerPacket], role: Role) -> list[int]:
        """The vehicles in formation that have no leader where this vehicle leaves it."""
        formed = [peer for peer in peers if peer.phase in FORMED]
        others_lead = any(p.role is Role.LEADER or p.sender.vehicle_id in self.successors for p in formed)
        return [] if others_lead or role is not Role.LEADER else sorted(peer.sender.vehicle_id for peer in formed)

    def _stranded(self, peers: Collection[PeerPacket], role: Role) -> Notice | None:
        """Not where all are commanded at once, which no vehicle knows: so this is no refusal."""
        if not (followers := self._followers(peers, role)):
            return None
        left = f"their own, vehicles {', '.join(map(str, followers))} hold where they stop"
        if len(followers) == 1:
            left = f"its own, vehicle {followers[0]} holds where it stops"
        return Notice(Code.NO_SUCCESSOR, f"no successor is in formation: without a command of {left}")

    def _warnings_before_landing(
        self, vehicle: VehicleState, peers: Collection[PeerPacket], role: Role
    ) -> tuple[Notice, ...]:
        return tuple(filter(None, (self._too_near(vehicle, peers), self._stranded(peers, role))))

    def lacks(self, vehicle: VehicleState, peers: Collection[PeerPacket]) -> tuple[Notice, ...]:
        """The reasons why the vehicle must not leave the ground, each with its subject first."""
        found = (
            id_shared(vehicle),
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
        return tuple(filter(None, (home_elsewhere(self.separation_m, vehicle), shared, self.slow_to_brake)))

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


def brakes_from_m_s(braking_m_s2: float, margin_m: float) -> float:
    """The speed that a vehicle reaches or brakes from within the margin: it keeps off one that comes with no more."""
    return sqrt(2.0 * braking_m_s2 * margin_m)


def slow_to_brake(
    own_id: int, slots: Mapping[int, Vector3], separation_m: float, braking_m_s2: float, max_tilt_deg: float
) -> Notice | None:
    """The vehicle brakes too little to keep off a neighbour that leaves its slot towards it at SLOW_M_S.

    `slots` in the metric of separation_m, of the fleet file. `braking_m_s2`: with which it plans to brake alone.
    """
    apart_m = {other: dist(slots[own_id], slot) for other, slot in slots.items() if other != own_id}
    nearest = min(apart_m, key=apart_m.__getitem__, default=None)
    if nearest is None:
        return None
    margin_m = max(apart_m[nearest] - separation_m, 0.0)
    speed_m_s = brakes_from_m_s(braking_m_s2, margin_m)
    if speed_m_s >= SLOW_M_S:
        return None
    wanted_m = separation_m + (SLOW_M_S * SLOW_M_S / (2.0 * braking_m_s2) if braking_m_s2 > 0.0 else inf)
    return Notice(
        Code.BRAKES_SLOWLY,
        f"braking: with max_tilt_deg {max_tilt_deg:g} vehicle {own_id} brakes by {braking_m_s2:.2f} m/s^2, and within the"
        f" {margin_m:.2f} m that its slot and that of vehicle {nearest} are farther apart than separation_m from"
        f" {speed_m_s:.2f} m/s; one that comes faster, as under a pilot, comes nearer; for {SLOW_M_S:g} m/s slots"
        f" {wanted_m:.3g} m apart, or more tilt",
    )


def id_shared(vehicle: VehicleState) -> Notice | None:
    """Two autopilots would obey each command."""
    if not vehicle.interleaves:
        return None
    return Notice(Code.AUTOPILOT_ID_SHARED, f"autopilot: {TWO_STREAMS}; {ONE_ID_EACH}")
