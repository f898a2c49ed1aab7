"""Paths into a slot, of one vehicle and of vehicles that form together: delta(t), relative to the slot, decays to zero.

A vehicle on a path flies slot + delta. The law then finds it in its slot all along, and pulls neither it nor its neighbours.
Peers know such a path as well: the quintic that begins with the published motion of the slot and ends after `moves_for_s`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import acos, acosh, dist, exp, hypot, sqrt

from msgspec import Struct

from companion.core.consensus.peers import PeerState
from companion.core.formation.limits import crossing_notice
from companion.core.reference.blend import LONGEST_S, SAMPLES, SHORTEST_S, within
from companion.geometry.curves import Curve, decay_to_rest, duration_s
from companion.geometry.formations import ROUNDING_M, SLOT_ACCELERATION_M_S2, in_formation_frame, to_separation_metric
from companion.types.autopilot import VehicleState
from companion.types.flight import ON_GROUND, STREAMING, FlightPhase
from companion.types.formation import FormationState, Gains, Heading
from companion.types.notices import Code, Notice, Refused
from companion.types.values import ZERO3, Vector3

LONGER = 1.1  # factor of the duration from one attempt to the next

Path = tuple[Curve, float]
"""delta, and its duration in seconds."""


class Offset(Struct, frozen=True, gc=False):
    """A vehicle's motion relative to its slot, in the frame of the formation."""

    position_m: Vector3
    velocity_m_s: Vector3 = ZERO3

    @property
    def distance_m(self) -> float:
        return hypot(*self.position_m)

    @property
    def speed_m_s(self) -> float:
        return hypot(*self.velocity_m_s)


def offset_from(
    position_enu_m: Vector3, velocity_enu_m_s: Vector3, fleet: FormationState, slot_m: Vector3, heading: Heading
) -> Offset:
    """Offset from `slot_m`, which is in the formation's frame. `fleet` is the state of the RFT as the fleet flies it."""
    (x, y, z), (vx, vy, vz) = fleet.position_enu_m, fleet.velocity_enu_m_s
    relative = (position_enu_m[0] - x, position_enu_m[1] - y, position_enu_m[2] - z)
    here = in_formation_frame(relative, heading)
    rate = heading.rate_rad_s  # relative to a turning formation, a vehicle at rest circles the other way
    drift_enu = (
        velocity_enu_m_s[0] - vx + rate * relative[1],
        velocity_enu_m_s[1] - vy - rate * relative[0],
        velocity_enu_m_s[2] - vz,
    )
    error = (here[0] - slot_m[0], here[1] - slot_m[1], here[2] - slot_m[2])
    return Offset(error, in_formation_frame(drift_enu, heading))


def path_from(offset: Offset, lasts_s: float) -> Path:
    """The path that begins with this offset and ends after this time."""
    return decay_to_rest((offset.position_m, offset.velocity_m_s, ZERO3), lasts_s), lasts_s


def gentle_path(offset: Offset, speed_m_s: float, at_least_s: float = 0.0) -> Path:
    """The shortest path that adds no more than `speed_m_s` to the present speed, and SLOT_ACCELERATION_M_S2.

    Raises Refused where it would last longer than LONGEST_S.
    """
    most_m_s = speed_m_s + offset.speed_m_s
    lasts_s = max(SHORTEST_S, at_least_s, duration_s(offset.distance_m, most_m_s, SLOT_ACCELERATION_M_S2))
    while lasts_s <= LONGEST_S:
        delta, _ = path = path_from(offset, lasts_s)
        times_s = [lasts_s * k / SAMPLES for k in range(SAMPLES + 1)]
        if within(delta, times_s, most_m_s, SLOT_ACCELERATION_M_S2):
            return path
        lasts_s *= LONGER
    text = f"it is {offset.distance_m:.0f} m from its slot, too far to fly there within {LONGEST_S:g} s"
    raise Refused(Code.SLOT_TOO_FAR, text)


def law_within_m(gains: Gains, speed_m_s: float) -> float:
    """Distance from which the law alone brings a vehicle from rest into its slot below `speed_m_s`, m.

    The largest speed of x'' = -k1 x - k2 x' from rest at distance e is e w exp(-zeta/b acos zeta), with w^2 = k1,
    2 zeta w = k2 and b^2 = 1 - zeta^2; with acosh and b^2 = zeta^2 - 1 where it is overdamped.
    """
    frequency_1_s = sqrt(gains.position_1_s2)
    damping = gains.velocity_1_s / (2.0 * frequency_1_s)
    b = sqrt(abs(1.0 - damping * damping))
    angle = acos(damping) if damping < 1.0 else acosh(damping)
    share = damping * angle / b if b > 1e-6 else 1.0  # the limit of both
    return speed_m_s / (frequency_1_s * exp(-share))


SPREAD = 1.0 / 3.0  # offsets may differ by this share of the distance that the law settles, as its paths bend
SLACK = 1.15  # factor on the duration, so that a vehicle that enters later still ends with the leader


def law_settles(farthest_m: float, differ_m: float, within_m: float) -> bool:
    """Whether the law alone settles offsets up to `farthest_m` that differ by `differ_m`. `within_m`: see `law_within_m`."""
    return farthest_m <= within_m and differ_m <= SPREAD * within_m


def needed_s(distance_m: float, speed_m_s: float) -> float:
    """The shortest duration of a path of this length."""
    return max(SHORTEST_S, duration_s(distance_m, speed_m_s, SLOT_ACCELERATION_M_S2))


def together_s(farthest_m: float, speed_m_s: float) -> float:
    """The duration of all paths where the farthest vehicle has this way."""
    return min(SLACK * needed_s(farthest_m, speed_m_s), LONGEST_S)


def followers_path(own: Offset, speed_m_s: float, within_m: float, ends_in_s: float) -> Path | None:
    """The path that ends in `ends_in_s` with that of the leader; None where that flies none and this vehicle is near.

    Raises Refused for a slot that is too far away.
    """
    near = own.distance_m <= SPREAD * within_m and own.speed_m_s <= speed_m_s
    return None if near and ends_in_s == 0.0 else gentle_path(own, speed_m_s, ends_in_s)


BELIEVED = 2.0  # times what the farthest vehicle needs: a peer that publishes a longer duration is wrong
PATH_MARGIN_M = 0.05  # a path counts where it is nearer than both its ends by this; slots too close are another check
PATH_SAMPLES = 40
FORM_OR_HOLD = STREAMING | {FlightPhase.HOLD}  # where all that hold were commanded to form as well
VERTICAL = frozenset({FlightPhase.TAKEOFF, FlightPhase.LAND, FlightPhase.RETURN})  # any height may be flown through


class Entering(Struct, frozen=True, gc=False):
    """This vehicle and the armed peers as it enters formation; heading and slots of the formation, in its own frame."""

    now_s: float
    vehicle: VehicleState
    peers: Sequence[PeerState]
    heading: Heading
    slots_m: Mapping[int, Vector3]


class FormingTogether:
    """Paths of vehicles that form together, and whether they keep `separation_m`.

    Vehicles that form make way for each other, so their paths may cross. Others must not be in the way.

    Relative to the RFT the offset of every vehicle from its slot decays by one law of time. So each distance of two vehicles
    changes along a straight line, wherever the RFT is and however it moves. The leader sets the duration, which its slot
    publishes; the others end with it. Near their slots the law alone settles the vehicles, as in the paper.
    """

    def __init__(
        self, own_id: int, separation_m: float, speed_m_s: float, law_within_m: float, slots_have_height: bool
    ) -> None:
        """Up to `law_within_m` the law alone settles an offset. Without `slots_have_height` each vehicle keeps its altitude."""
        self._own_id = own_id
        self._separation_m = separation_m
        self._speed_m_s = speed_m_s
        self._law_within_m = law_within_m
        self._slots_have_height = slots_have_height

    def leaders_path(self, now: Entering, fleet: FormationState, forming: Collection[FlightPhase]) -> Path | None:
        """The path of the first leader, long enough for all peers in these phases; None where the law alone flies.

        `fleet` is the state of the RFT as the fleet flies it. Raises Refused for a slot that is too far away.
        """
        own = self._own_offset(now, fleet)
        offsets = [own, *(self._peer_offset(now, fleet, peer) for peer in now.peers if peer.packet.phase in forming)]
        differ_m = max(dist(own.position_m, offset.position_m) for offset in offsets)
        farthest_m = max(offset.distance_m for offset in offsets)
        if law_settles(farthest_m, differ_m, self._law_within_m) and own.speed_m_s <= self._speed_m_s:
            return None
        return gentle_path(own, self._speed_m_s, together_s(farthest_m, self._speed_m_s))

    def longest_s(self, now: Entering, fleet: FormationState) -> float:
        """The longest duration that a path of these vehicles may have. One packet may report any."""
        in_air = [self._peer_offset(now, fleet, peer) for peer in now.peers if peer.packet.phase not in ON_GROUND]
        offsets = [self._own_offset(now, fleet), *in_air]
        return BELIEVED * self._needed_s(max(offset.distance_m for offset in offsets))

    def followers_path(self, now: Entering, fleet: FormationState, ends_in_s: float) -> Path | None:
        """See `followers_path`; `fleet` is the state of the RFT as the fleet flies it."""
        return followers_path(self._own_offset(now, fleet), self._speed_m_s, self._law_within_m, ends_in_s)

    def refusal(
        self, now: Entering, fleet: FormationState, path: Path | None, forming: Collection[FlightPhase]
    ) -> Notice | None:
        """Why this path must not be flown: it comes too near to a peer that is in none of the phases `forming`."""
        for peer_id, apart_m, forms in self._too_close(now, fleet, path, forming):
            if not forms:
                text = (
                    f"the path to its slot comes within {apart_m:.2f} m of vehicle {peer_id}, which does not form;"
                    f" expected at least separation_m, {self._separation_m:g} m"
                )
                return Notice(Code.PATH_TOO_CLOSE, text)
        return None

    def crossing(self, now: Entering, fleet: FormationState, path: Path | None) -> Notice | None:
        """The warning of the nearest peer whose path this one crosses, where all in hold form as well."""
        conflicts = self._too_close(now, fleet, path, FORM_OR_HOLD)
        nearest = min(((apart_m, i) for i, apart_m, forms in conflicts if forms), default=None)
        return nearest and crossing_notice(self._own_id, nearest[1], nearest[0], self._separation_m)

    def _too_close(
        self, now: Entering, fleet: FormationState, path: Path | None, forming: Collection[FlightPhase]
    ) -> Iterator[tuple[int, float, bool]]:
        """(peer, distance in m, whether it forms) of each peer that comes too near on the way."""
        own, slot_m = self._own_offset(now, fleet), now.slots_m[self._own_id]
        delta, lasts_s = path or path_from(own, self._needed_s(own.distance_m))
        for peer in sorted(now.peers, key=lambda p: p.packet.sender.vehicle_id):
            packet = peer.packet
            if packet.phase in ON_GROUND or not packet.armed:
                continue
            forms = packet.phase in forming
            motion = self.peers_path(now, fleet, peer, lasts_s) if forms else self._staying(now, fleet, peer)
            level = packet.phase in VERTICAL or not self._slots_have_height
            longest_s = max(lasts_s, packet.slot.moves_for_s)
            apart_m = _distances_m(slot_m, delta, now.slots_m[packet.sender.vehicle_id], motion, longest_s, level)
            ends_m = min(apart_m[0], apart_m[-1]) if forms else apart_m[0]
            if min(apart_m) < self._separation_m - ROUNDING_M and min(apart_m) < ends_m - PATH_MARGIN_M:
                yield packet.sender.vehicle_id, min(apart_m), forms

    def _own_offset(self, now: Entering, fleet: FormationState) -> Offset:
        vehicle, slot_m = now.vehicle, now.slots_m[self._own_id]
        return self._offset(offset_from(vehicle.position_enu_m, vehicle.velocity_enu_m_s, fleet, slot_m, now.heading))

    def _peer_offset(self, now: Entering, fleet: FormationState, peer: PeerState) -> Offset:
        motion, slot_m = peer.packet.motion, now.slots_m[peer.packet.sender.vehicle_id]
        return self._offset(
            offset_from(peer.position_at(now.now_s), motion.velocity_enu_m_s, fleet, slot_m, now.heading)
        )

    def _offset(self, offset: Offset) -> Offset:
        if self._slots_have_height:
            return offset
        (x, y, _), (vx, vy, _) = offset.position_m, offset.velocity_m_s
        return Offset((x, y, 0.0), (vx, vy, 0.0))

    def _needed_s(self, distance_m: float) -> float:
        return needed_s(distance_m, self._speed_m_s)

    def peers_path(self, now: Entering, fleet: FormationState, peer: PeerState, lasts_s: float) -> Curve:
        """Offset of a peer from its slot over time: the rest of its published path, or a path as long as the own one."""
        offset, slot = self._peer_offset(now, fleet, peer), peer.packet.slot
        if not slot.moves:
            return path_from(offset, lasts_s)[0]
        velocity = in_formation_frame(slot.velocity_enu_m_s, now.heading)
        acceleration = in_formation_frame(slot.acceleration_enu_m_s2, now.heading)
        return decay_to_rest((offset.position_m, velocity, acceleration), slot.moves_for_s)

    def _staying(self, now: Entering, fleet: FormationState, peer: PeerState) -> Curve:
        """Offset from its slot of a peer that stays where it is, while the formation moves on at its present velocity."""
        offset = self._peer_offset(now, fleet, peer)
        (x, y, z), (vx, vy, vz) = offset.position_m, offset.velocity_m_s
        return lambda t: ((x + vx * t, y + vy * t, z + vz * t), offset.velocity_m_s, (0.0, 0.0, 0.0))


def _distances_m(
    slot_m: Vector3, delta: Curve, other_slot_m: Vector3, other: Curve, lasts_s: float, level: bool
) -> list[float]:
    """Distances of two vehicles over this time; with `level` in the plane."""
    apart_m = []
    for k in range(PATH_SAMPLES + 1):
        t = lasts_s * k / PATH_SAMPLES
        (x, y, z), (ox, oy, oz) = delta(t)[0], other(t)[0]
        here = (slot_m[0] + x, slot_m[1] + y, slot_m[2] + z)
        there = (other_slot_m[0] + ox, other_slot_m[1] + oy, other_slot_m[2] + oz)
        apart_m.append(dist(to_separation_metric(here, not level), to_separation_metric(there, not level)))
    return apart_m
