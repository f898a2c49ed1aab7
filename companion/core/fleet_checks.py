"""What is asked of the fleet as a whole: of its places before it leaves the ground, of its spacing before it forms.

Each vehicle judges for itself by what it hears. An estimator's error counts as one sigma, in the plane as that of both axes
together, and as independent of the others'. Receivers side by side share what the atmosphere does to them, but not
reflections and not always the satellites, and none of them tells how much of its error it shares.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import dist, hypot, inf, sqrt

from companion.core.phase import ON_GROUND
from companion.geometry.transition import ROUNDING_M, closest
from companion.types import CommandName, FlightPhase, FlownSlot, PeerPacket, PositionError, Role, Vector3, VehicleState

FORMED = frozenset({FlightPhase.ENGAGE, FlightPhase.FORMATION})
MAY_FORM = FORMED | {FlightPhase.HOLD}
ON_THE_WAY_M = 0.05  # nearer than that than at both ends: slots that are too near are another matter
REFUSED_BELOW_SIGMAS = 3.0
WARNED_BELOW_SIGMAS = 6.0  # at 5.2 four vehicles once came within 0.12 m of each other


@dataclass(frozen=True, slots=True)
class Spacing:
    """Of two slots, and one sigma of what both errors make of it along the line between them."""

    distance_m: float
    sigma_m: float

    @property
    def sigmas(self) -> float:
        if self.distance_m == 0.0:
            return 0.0
        return self.distance_m / self.sigma_m if self.sigma_m > 0.0 else inf


@dataclass(frozen=True, slots=True)
class FleetChecks:
    """Where not `slots_have_height`, every vehicle flies at an altitude of its own and slots are apart in the plane alone."""

    own_id: int
    slots_have_height: bool
    ground_spread_m: float
    separation_m: float  # in the plane, of any two on the ground

    def judge(
        self, name: CommandName, vehicle: VehicleState, slot: FlownSlot, peers: Collection[PeerPacket], role: Role
    ) -> tuple[str, str]:
        """(why this command is refused, what is to be said if it is not); "" where nothing is.

        `peers` are the fresh ones, `role` is this vehicle's own.
        """
        match name:
            case CommandName.ARM | CommandName.TAKEOFF:
                return "; ".join(self.lacks(vehicle, peers)), ""
            case CommandName.LAND:
                return "", self._too_near(vehicle, peers)
            case CommandName.FORM:
                if refusal := self._other_formation(slot.formation, peers, role):
                    return refusal, ""
                return self._too_close(vehicle.position_error, slot, peers)
        return "", ""

    def refusal_to_form_together(self, vehicle: VehicleState, slot: FlownSlot, peers: Collection[PeerPacket]) -> str:
        """From hold all go to their slots at once, about straight: why not, where two would come too near on the way.

        Where the RFT is does not matter to that, for all go there alike. Peers that hold count as if told to form as well.
        """
        own_place, own_slot = self._flat(vehicle.position_enu_m), self._flat(slot.position_enu_m)
        for peer in sorted(peers, key=lambda p: p.vehicle_id):
            if peer.phase not in MAY_FORM:
                continue
            place, peer_slot = self._flat(peer.position_enu_m), self._flat(peer.slot.position_enu_m)
            apart_m, _, _ = closest({0: own_place, 1: place}, {0: own_slot, 1: peer_slot})
            ends_m = min(dist(own_place, place), dist(own_slot, peer_slot))
            if apart_m < self.separation_m - ROUNDING_M and apart_m < ends_m - ON_THE_WAY_M:
                return (
                    f"on straight ways into their slots vehicles {self.own_id} and {peer.vehicle_id} come within"
                    f" {apart_m:.2f} m of each other; expected at least separation_m, {self.separation_m:g} m; land, and"
                    " give a formation command there: it assigns slots to where the vehicles stand"
                )
        return ""

    def lacks(self, vehicle: VehicleState, peers: Collection[PeerPacket]) -> tuple[str, ...]:
        """Why the vehicle must not leave the ground, each with its subject first."""
        words = (self._altitudes_differ(vehicle.position_enu_m[2], peers), self._too_near(vehicle, peers))
        return tuple(filter(None, words))

    def _too_near(self, vehicle: VehicleState, peers: Collection[PeerPacket]) -> str:
        """To one that stands, climbs or flies there: all come up and down vertically."""
        x, y, _ = vehicle.position_enu_m
        apart_m = {p.vehicle_id: hypot(p.position_enu_m[0] - x, p.position_enu_m[1] - y) for p in peers}
        nearest = min(apart_m, key=apart_m.__getitem__, default=None)
        if nearest is None or apart_m[nearest] >= self.separation_m:
            return ""
        return (
            f"separation: in the plane vehicle {nearest} is {apart_m[nearest]:.2f} m from vehicle {self.own_id};"
            f" expected at least separation_m, {self.separation_m:g} m"
        )

    def _flat(self, position_enu_m: Vector3) -> Vector3:
        """As the distance of two counts."""
        x, y, z = position_enu_m
        return (x, y, z if self.slots_have_height else 0.0)

    def _altitudes_differ(self, own_z_m: float, peers: Collection[PeerPacket]) -> str:
        z_m = {peer.vehicle_id: peer.position_enu_m[2] for peer in peers if peer.phase in ON_GROUND}
        z_m[self.own_id] = own_z_m
        low, high = min(z_m, key=z_m.__getitem__), max(z_m, key=z_m.__getitem__)
        spread_m = z_m[high] - z_m[low]
        if spread_m <= self.ground_spread_m:
            return ""
        return (
            f"altitude: on the ground vehicle {high} is {spread_m:.1f} m above vehicle {low}, more than ground_spread_m"
            f" {self.ground_spread_m:g}"
        )

    def _other_formation(self, own: int, peers: Collection[PeerPacket], role: Role) -> str:
        """Not the one that others fly; where nobody flies one yet, that of who is to lead: all may be told to form at once."""
        formed = [peer for peer in peers if peer.phase in FORMED]
        if flies := next((peer for peer in formed if peer.slot.formation != own), None):
            return (
                f"this vehicle flies formation {own}, vehicle {flies.vehicle_id} flies {flies.slot.formation}; give this"
                " one that formation first"
            )
        holding = [p for p in peers if p.role is Role.LEADER and p.phase is FlightPhase.HOLD]
        before = [p for p in holding if role is not Role.LEADER or p.vehicle_id < self.own_id]
        first = min(before, key=lambda p: p.vehicle_id, default=None)
        if formed or first is None or first.slot.formation == own:
            return ""
        return (
            f"this vehicle flies formation {own}, vehicle {first.vehicle_id}, which leads, {first.slot.formation}; form"
            " that one alone first, and this one takes over its formation"
        )

    def _too_close(self, own: PositionError | None, slot: FlownSlot, peers: Collection[PeerPacket]) -> tuple[str, str]:
        told_by = {self.own_id: own} | {peer.vehicle_id: peer.position_error for peer in peers}
        silent = sorted(vehicle_id for vehicle_id, error in told_by.items() if error is None)
        told = f"no error reported by the estimator of vehicle {', '.join(map(str, silent))}" if silent else ""
        if own is None:
            return "", told
        spacings = {p.vehicle_id: self._spacing(own, slot, p.position_error, p.slot) for p in peers if p.position_error}
        nearest = min(spacings, key=lambda i: spacings[i].sigmas, default=None)
        if nearest is None or (spacing := spacings[nearest]).sigmas >= WARNED_BELOW_SIGMAS:
            return "", told
        words = (
            f"the slots of vehicles {self.own_id} and {nearest} are {spacing.distance_m:.1f} m apart,"
            f" {spacing.sigmas:.1f} sigma of their estimators' errors"
        )
        if spacing.sigmas < REFUSED_BELOW_SIGMAS:
            return f"{words}; expected at least {_sigmas_in_words(REFUSED_BELOW_SIGMAS, spacing)}", ""
        warning = f"{words}; better {_sigmas_in_words(WARNED_BELOW_SIGMAS, spacing)}"
        return "", "; ".join([warning, *([told] if told else [])])

    def _spacing(self, own: PositionError, own_slot: FlownSlot, other: PositionError, other_slot: FlownSlot) -> Spacing:
        (x, y, z), (x0, y0, z0) = other_slot.position_enu_m, own_slot.position_enu_m
        level_m, up_m = hypot(x - x0, y - y0), z - z0 if self.slots_have_height else 0.0
        distance_m = hypot(level_m, up_m)
        level, up = (level_m / distance_m, up_m / distance_m) if distance_m > 0.0 else (1.0, 0.0)
        level_sigma_m = hypot(own.horizontal_m, other.horizontal_m) / sqrt(2.0)  # one axis of two
        return Spacing(distance_m, hypot(level * level_sigma_m, up * hypot(own.vertical_m, other.vertical_m)))


def _sigmas_in_words(sigmas: float, spacing: Spacing) -> str:
    return f"{sigmas:g} sigma, {sigmas * spacing.sigma_m:.1f} m"
