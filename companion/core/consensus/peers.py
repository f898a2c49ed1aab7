"""Newest plausible state of every peer. Every peer packet passes the checks of this module before the law uses it.

`refusal_of_claims` and `refusal_of_motion` look at one packet alone; `PeerTable` compares it with the last one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import dist, hypot, inf, isfinite, pi
from operator import attrgetter

from msgspec import Struct
from msgspec.structs import replace

from companion.core.consensus.coherence import Coherence, Disbelief, coherent
from companion.core.message_order import Disorder, Stream, following
from companion.geometry.vectors import extrapolated, shortened
from companion.laws import Neighbour
from companion.types.commands import MAX_EPOCH
from companion.types.flight import STREAMING, FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, Term
from companion.types.notices import Code
from companion.types.peers import (
    FORGOTTEN_S,
    MOST_LOST,
    LeaderReport,
    LostVehicle,
    Motion,
    PeerPacket,
    ReceivedPeerPacket,
    Sender,
)
from companion.types.rejections import count_rejection, rejection_key
from companion.types.values import MAX_CHANGE_S, MAX_COORDINATE_M, MAX_MISSION_S, ZERO3, Vector3

LEADER, FORMATION = Role.LEADER, FlightPhase.FORMATION  # enum member lookup is slow, and every packet needs it
MAX_ACCELERATION_M_S2 = 100.0
MAX_ERROR_M = 10_000.0
MAX_TURN_RAD_S, MAX_TURN_RAD_S2 = 5.0, 20.0  # several times the limits of any formation
MAX_SENT_S = 1e9  # thirty years since the sender's computer was started
MAX_STATE_AGE_S = 10.0
# Size of a slot in fences, from the RFT: a vehicle that joins flies one far off.
MOST_FENCES = 2.0


@dataclass(frozen=True, slots=True)
class KnownFleet:
    """What packets are checked against. `may_lead` has every vehicle id; `claims` are (vehicle id, rank) of successors."""

    own_id: int
    formation_hash: int
    may_lead: Mapping[int, bool]
    claims: frozenset[tuple[int, int]]


@dataclass(frozen=True, slots=True)
class FleetLimits:
    """What vehicles of this fleet can fly at most: no received value is used beyond it.

    `wind_is_observed`: by an observer that is fast enough, so that a vehicle flies the acceleration that it commands.
    """

    speed_m_s: float
    acceleration_m_s2: float
    fence_size_m: Vector3
    wind_is_observed: bool = True


def refusal_of_claims(packet: PeerPacket, fleet: KnownFleet) -> Code | None:
    """Checks sender, formation hash, role, PrC, leader beacon, reference and change."""
    sender, leader, known = packet.sender, packet.leader, fleet.may_lead
    if sender.vehicle_id == fleet.own_id:
        return Code.PEER_OWN_ID
    may_lead = known.get(sender.vehicle_id)
    if may_lead is None:
        return Code.PEER_NOT_IN_FLEET
    if sender.formation_hash != fleet.formation_hash:
        return Code.PEER_OTHER_FLEET_FILE
    is_leader, beacon = packet.role is LEADER, leader.beacon
    if is_leader and not may_lead:
        return Code.PEER_NOT_A_LEADER
    if not 1 <= leader.prc <= len(known) or (leader.prc == 1) is not is_leader:
        return Code.PEER_PRC_IMPLAUSIBLE
    held = packet.reference
    if held and not (held.flown >= 0 and held.waiting >= 0 and 0.0 <= held.begun_s <= MAX_MISSION_S):
        return Code.PEER_REFERENCE_IMPLAUSIBLE
    if packet.change is not None and not (is_leader and _is_plausible_change(packet.change, fleet)):
        return Code.PEER_CHANGE_IMPLAUSIBLE
    if is_leader and (beacon is None or beacon.leader_id != sender.vehicle_id):
        return Code.PEER_BEACON_MISSING
    if beacon is not None:
        heading = beacon.heading
        if not (
            known.get(beacon.leader_id)
            and (beacon.claim == 0 or (beacon.leader_id, beacon.claim) in fleet.claims)
            and 0 <= beacon.epoch <= MAX_EPOCH
            and 0.0 <= beacon.reference_s <= MAX_MISSION_S
            and abs(heading.rate_rad_s) <= MAX_TURN_RAD_S
            and abs(heading.acceleration_rad_s2) <= MAX_TURN_RAD_S2
            and abs(heading.angle_rad) <= pi
        ):
            return Code.PEER_BEACON_IMPLAUSIBLE
    return None


def refusal_of_motion(packet: PeerPacket, limits: FleetLimits, known: FlownSlot | None) -> Code | None:
    """Checks position, velocity, acceleration, times, slot and position error. `known` is a slot that has passed before."""
    motion, slot, error = packet.motion, packet.slot, packet.position_error
    least, most = -MAX_COORDINATE_M, MAX_COORDINATE_M
    (x, y, z), (vx, vy, vz), (ax, ay, az) = motion.position_enu_m, motion.velocity_enu_m_s, motion.acceleration_enu_m_s2
    if not (least <= x <= most and least <= y <= most and least <= z <= most):
        return _not_finite(motion) or Code.PEER_POSITION_IMPLAUSIBLE
    if not hypot(vx, vy, vz) <= limits.speed_m_s:  # or not a number, here and below
        return _not_finite(motion) or Code.PEER_SPEED_IMPLAUSIBLE
    if not hypot(ax, ay, az) <= MAX_ACCELERATION_M_S2:
        return _not_finite(motion) or Code.PEER_ACCELERATION_IMPLAUSIBLE
    if not (0.0 <= motion.state_age_s <= MAX_STATE_AGE_S and 0.0 <= motion.sent_s <= MAX_SENT_S):
        return _not_finite(motion) or Code.PEER_TIME_IMPLAUSIBLE
    if slot != known and not _is_plausible_slot(slot, limits):
        return Code.PEER_SLOT_IMPLAUSIBLE
    if slot.velocity_enu_m_s != ZERO3:
        sx, sy, sz = slot.velocity_enu_m_s
        if not hypot(vx - sx, vy - sy, vz - sz) <= limits.speed_m_s:  # too fast relative to the RFT
            return Code.PEER_SLOT_IMPLAUSIBLE
    if packet.rft is not None and not _is_plausible_rft(packet.rft, limits):
        return Code.PEER_SLOT_IMPLAUSIBLE
    for x, y, z in packet.law_values:
        if not (least <= x <= most and least <= y <= most and least <= z <= most):
            return Code.PEER_LAW_VALUES_IMPLAUSIBLE
    if error and not (0.0 <= error.horizontal_m <= MAX_ERROR_M and 0.0 <= error.vertical_m <= MAX_ERROR_M):
        return Code.PEER_POSITION_ERROR_IMPLAUSIBLE
    return None


def _is_older(packet: PeerPacket, before: PeerState | None) -> bool:
    """Whether it was sent before the last one that was used: the network has held it back, or sent it twice."""
    return before is not None and packet.motion.sent_s <= before.packet.motion.sent_s


def _squared(vector: Vector3) -> float:
    x, y, z = vector
    return x * x + y * y + z * z


def _not_finite(motion: Motion) -> Code | None:
    """The refusal of a motion that was found implausible, if one of its numbers is not finite."""
    vectors = (motion.position_enu_m, motion.velocity_enu_m_s, motion.acceleration_enu_m_s2)
    numbers = (*chain(*vectors), motion.state_age_s, motion.sent_s)
    return None if all(map(isfinite, numbers)) else Code.PEER_NOT_FINITE


def _is_plausible_slot(slot: FlownSlot, limits: FleetLimits) -> bool:
    """False for numbers that are not finite, other than those of its velocity."""
    (x, y, z), (far_x, far_y, far_z) = slot.position_enu_m, limits.fence_size_m
    far_x, far_y, far_z = MOST_FENCES * far_x, MOST_FENCES * far_y, MOST_FENCES * far_z
    near = -far_x <= x <= far_x and -far_y <= y <= far_y and -far_z <= z <= far_z
    gentle = hypot(*slot.acceleration_enu_m_s2) <= MAX_ACCELERATION_M_S2
    in_time = 0.0 <= slot.moves_for_s <= MAX_CHANGE_S
    return near and gentle and in_time and slot.formation >= 0 and slot.waiting >= 0


def _is_plausible_rft(rft: tuple[Vector3, Vector3, Vector3], limits: FleetLimits) -> bool:
    """False for numbers that are not finite."""
    position_enu_m, velocity_enu_m_s, acceleration_enu_m_s2 = rft
    near = all(abs(p) <= MAX_COORDINATE_M for p in position_enu_m)
    slow = hypot(*velocity_enu_m_s) <= limits.speed_m_s
    return near and slow and hypot(*acceleration_enu_m_s2) <= MAX_ACCELERATION_M_S2


def _is_plausible_change(change: FormationChange, fleet: KnownFleet) -> bool:
    """Whether there is one slot for each vehicle of the fleet, and one present. `core/formation/slots.py` checks the rest."""
    of_each = sorted(vehicle_id for vehicle_id, _ in change.slots_enu_m) == sorted(fleet.may_lead)
    return of_each and set(change.absent) < fleet.may_lead.keys()


DUPLICATES = (Code.PEER_OWN_ID, Code.PEER_ID_TWICE)
# Refused by what a configuration, a second agent or the network does; all else is what an agent says of itself.
OF_OTHER_CAUSE = (*DUPLICATES, Code.PEER_NOT_IN_FLEET, Code.PEER_OTHER_FLEET_FILE, Code.PEER_LATE)
CODES = {
    Disorder.TWO_SENDERS: Code.PEER_ID_TWICE,
    Disorder.OUT_OF_ORDER: Code.PEER_OUT_OF_ORDER,
    Disorder.LATE: Code.PEER_LATE,
    Disorder.TIME: Code.PEER_TIME_IMPLAUSIBLE,
}
# Two ticks: a lost packet, or usual jitter. What is older remains late. A vehicle that extrapolates its neighbour answers a
# wave by a larger one, and along a hundred hops that grows without bound: docs/law.md. Near the leader nothing has grown
# yet: by longer extrapolation a small fleet lags less.
EXTRAPOLATED_MOST_S = 0.04
EXTRAPOLATED_NEAR_LEADER_S, NEAR_LEADER_PRC = 0.08, 3
DISTANT_MAX_AGE_S = 1.0  # for a peer received at 5 Hz: four lost packets and the usual delay
FULL_RATE_WITHIN_S = 0.5  # after such a peer is to be received at 50 Hz, its first packets have arrived
LOST_AFTER_S = 2.0  # silent for longer than a distant peer may be
HEARSAY_S = 10.0  # a hundred hops of 0.1 s
ROUNDING_S = 1e-6  # of sums of times
JUMP_MARGIN_M = 1.0  # an estimator correction may add this to the distance flown between two packets


MEASUREMENT_TIME = attrgetter("measured_s")  # for map(), as in stage.py


class PeerState(Struct, frozen=True, gc=False):
    """A peer's newest packet with its times on this vehicle's clock.

    The vehicles share no clock. `least_apart_s` is received minus sent time of the least delayed packet of the session: the
    offset of the clocks plus the smallest transport delay. `measured_s` is the time of the position: the time of receipt
    minus the additional transport delay and minus the age of the position when it was sent.
    """

    packet: PeerPacket
    received_s: float
    least_apart_s: float
    measured_s: float
    term: Term = (0, 0)  # term in the packet's leader beacon, (0, 0) without a beacon
    proven: bool = True  # False: no more than hearsay of this term
    contradicts: bool = False  # positions and velocities do not agree; the velocity is that by the positions

    def position_at(self, now_s: float) -> Vector3:
        """Position extrapolated over its age, so that both sides of x_i - x_j refer to the same time."""
        return extrapolated(
            self.packet.motion.position_enu_m, self.packet.motion.velocity_enu_m_s, now_s - self.measured_s
        )

    def slot_at(self, now_s: float) -> FlownSlot:
        """Slot of the peer, extrapolated likewise."""
        slot = self.packet.slot
        if slot.velocity_enu_m_s == ZERO3:
            return slot
        position_enu_m = extrapolated(slot.position_enu_m, slot.velocity_enu_m_s, now_s - self.measured_s)
        return replace(slot, position_enu_m=position_enu_m)


def neighbour_at(peer: PeerState, now_s: float, prc: int) -> Neighbour:
    """The peer as the law sees it: its state minus that of its slot, extrapolated over a bounded age.

    x + v a + u a^2 / 2 and v + u a with the acceleration command u. Where a vehicle is kept off its slot, the RFT it flies
    by counts instead.
    """
    packet, aged_s = peer.packet, now_s - peer.measured_s
    most_s = EXTRAPOLATED_MOST_S if packet.leader.prc > NEAR_LEADER_PRC else EXTRAPOLATED_NEAR_LEADER_S
    age_s = most_s if aged_s > most_s else aged_s
    slot = packet.slot
    if packet.rft is not None:
        (x, y, z), (vx, vy, vz), (ax, ay, az) = packet.rft
    else:
        (x, y, z), (dx, dy, dz) = packet.motion.position_enu_m, slot.position_enu_m
        (vx, vy, vz), (dvx, dvy, dvz) = packet.motion.velocity_enu_m_s, slot.velocity_enu_m_s
        (ax, ay, az), (dax, day, daz) = packet.motion.acceleration_enu_m_s2, slot.acceleration_enu_m_s2
        x, y, z = x - dx, y - dy, z - dz
        vx, vy, vz = vx - dvx, vy - dvy, vz - dvz
        ax, ay, az = ax - dax, ay - day, az - daz
    half_s = 0.5 * age_s
    return Neighbour(
        (x + age_s * (vx + half_s * ax), y + age_s * (vy + half_s * ay), z + age_s * (vz + half_s * az)),
        (vx + age_s * ax, vy + age_s * ay, vz + age_s * az),
        (ax, ay, az),
        prc,
        slot.position_enu_m,
        aged_s,
        packet.law_values,
    )


class PeerTable:
    """Newest state of each peer. Every packet is checked for identity, formation hash, order and plausible numbers.

    `rejected` counts refused packets by code and peer id.
    """

    def __init__(
        self,
        own_id: int,
        may_lead: Mapping[int, bool],
        formation_hash: int,
        max_age_s: float,
        limits: FleetLimits,
        successors: Sequence[int],
    ) -> None:
        claims = frozenset((vehicle_id, rank) for rank, vehicle_id in enumerate(successors, start=1))
        self._fleet = KnownFleet(own_id, formation_hash, may_lead, claims)
        self._max_age_s = max_age_s
        self._limits = limits
        self._streams: dict[int, Stream] = {}
        self._distant: frozenset[int] = frozenset()
        self.low_rate_s: dict[int, float] = {}  # when each of those was last distant
        self._coherence: dict[int, Coherence] = {}
        self.known: dict[int, PeerState] = {}  # the newest state of each peer, of any age
        self.disbelief = Disbelief()
        self.rejected: Counter[str] = Counter()
        self.duplicate_id_s = -inf  # when a packet of a second agent with a known id last came

    def set_low_rate_peers(self, now_s: float, distant: frozenset[int]) -> None:
        """From now on these peers are received at 5 Hz, and their states may be older. Called while there are any."""
        self._distant = distant
        within = {i: s for i, s in self.low_rate_s.items() if now_s - s <= FULL_RATE_WITHIN_S}
        self.low_rate_s = within | dict.fromkeys(distant, now_s)

    def fold(self, packets: Iterable[ReceivedPeerPacket], epochs_up_to: int) -> None:
        """Check and take these packets; of one with a beacon of a larger epoch only the motion."""
        fleet, limits, known = self._fleet, self._limits, self.known
        for received in packets:
            packet = received.packet
            before = known.get(packet.sender.vehicle_id)
            code = (
                refusal_of_claims(packet, fleet)
                or refusal_of_motion(packet, limits, None if before is None else before.packet.slot)
                or self._take(received, before, epochs_up_to)
            )
            if code is not None:
                if code in DUPLICATES:
                    self.duplicate_id_s = received.received_s
                self._count(code, packet.sender.vehicle_id)
                if code not in OF_OTHER_CAUSE and not (code is Code.PEER_OUT_OF_ORDER and _is_older(packet, before)):
                    self._disbelieve(packet, received.received_s)
                continue
            beacon = packet.leader.beacon
            if not received.proven or (beacon is not None and beacon.epoch > epochs_up_to):
                self._disbelieve(packet, received.received_s)
            elif self.disbelief.sums:
                self.disbelief.less(packet.sender.vehicle_id, received.received_s)
            if packet.lost:
                self._hear_of(packet.lost, received.received_s)

    def _disbelieve(self, packet: PeerPacket, received_s: float) -> None:
        if packet.armed or packet.phase in STREAMING:
            self.disbelief.more(packet.sender.vehicle_id, received_s)

    def _take(self, received: ReceivedPeerPacket, before: PeerState | None, epochs_up_to: int) -> Code | None:
        """The packet as the newest state of its vehicle, or the refusal by the packets before: `before` has the last one.

        Checked are session, sequence, delay and distance.
        """
        packet, received_s, limits = received.packet, received.received_s, self._limits
        sender, motion, beacon = packet.sender, packet.motion, packet.leader.beacon
        vehicle_id = sender.vehicle_id
        max_age_s = self._age_limit_s(vehicle_id) if self.low_rate_s else self._max_age_s
        stream, disorder = following(
            self._streams.get(vehicle_id), sender.session, sender.sequence, motion.sent_s, received_s, max_age_s
        )
        if disorder is not None:
            self._streams[vehicle_id] = stream
            return CODES[disorder]
        if before is not None and received_s - before.measured_s <= max_age_s:
            since_s = received_s - before.received_s
            elapsed_s = (since_s if since_s > 0.0 else 0.0) + max_age_s
            distance_m = dist(motion.position_enu_m, before.packet.motion.position_enu_m)
            if distance_m > limits.speed_m_s * elapsed_s + JUMP_MARGIN_M:
                return Code.PEER_POSITION_JUMPED
        self._streams[vehicle_id] = stream
        if beacon is not None and beacon.epoch > epochs_up_to:
            packet, beacon = self._without_leader(packet), None
        (ax, ay, az), of_slot, rft = motion.acceleration_enu_m_s2, packet.slot.acceleration_enu_m_s2, packet.rft
        most_m_s2 = limits.acceleration_m_s2
        most_squared = most_m_s2 * most_m_s2
        if (
            ax * ax + ay * ay + az * az > most_squared
            or (of_slot != ZERO3 and _squared(of_slot) > most_squared)
            or (rft is not None and _squared(rft[2]) > most_squared)
        ):
            packet = self._within_limits(packet, most_m_s2)
        measured_s = received_s - stream.late_s - motion.state_age_s
        term = (beacon.epoch, -beacon.claim) if beacon is not None else (0, 0)
        contradicts = False
        if packet.armed or packet.phase in STREAMING:
            found = self._coherence[vehicle_id] = coherent(
                self._coherence.get(vehicle_id),
                measured_s,
                motion.position_enu_m,
                motion.velocity_enu_m_s,
                motion.acceleration_enu_m_s2 if limits.wind_is_observed and packet.phase is FORMATION else None,
                most_m_s2,
            )
            contradicts = found.contradicts
            if contradicts:
                packet = self._in_doubt(packet, found)
        self.known[vehicle_id] = PeerState(
            packet, received_s, stream.clock.least_apart_s, measured_s, term, received.proven, contradicts
        )
        return None

    def _hear_of(self, lost: Iterable[LostVehicle], received_s: float) -> None:
        """Take the silent vehicles that this one never heard itself: its agent may have started after they fell silent.

        They are kept off. Their own first packet replaces what others said of them, and so does a word that is younger by
        HEARSAY_S: who lost contact earlier knows less. By less it is the same news over another way, and a few that tell each
        other would keep it young for ever.
        """
        fleet, limits = self._fleet, self._limits
        for one in lost:
            i, speed_m_s = one.vehicle_id, hypot(*one.velocity_enu_m_s)
            if i in self._streams or i == fleet.own_id or i not in fleet.may_lead:
                continue
            before = self.known.get(i)
            if before is not None and received_s - one.age_s < before.measured_s + HEARSAY_S:
                continue
            if one.age_s < LOST_AFTER_S or not speed_m_s <= limits.speed_m_s:  # or not finite
                continue
            packet = PeerPacket(
                sender=Sender(i, 0, 0, fleet.formation_hash),
                phase=FlightPhase.OBSERVE,
                role=Role.FOLLOWER,
                motion=Motion(one.position_enu_m, one.velocity_enu_m_s, ZERO3, one.age_s, 0.0),
                leader=LeaderReport(len(fleet.may_lead), None),
                slot=FlownSlot(ZERO3),
            )
            self.known[i] = PeerState(packet, received_s, 0.0, received_s - one.age_s)

    def lost(self, now_s: float) -> tuple[LostVehicle, ...]:
        """The vehicles that were armed when they fell silent, those of the last FORGOTTEN_S; first those heard itself."""
        ages_s = {i: now_s - p.measured_s for i, p in self.known.items() if p.packet.armed}
        heard = self._streams
        silent = sorted((i not in heard, age_s, i) for i, age_s in ages_s.items() if LOST_AFTER_S < age_s < FORGOTTEN_S)
        motions = [(i, age_s, self.known[i].packet.motion) for _, age_s, i in silent[:MOST_LOST]]
        return tuple([LostVehicle(i, m.position_enu_m, m.velocity_enu_m_s, age_s) for i, age_s, m in motions])

    def in_time(self, now_s: float) -> tuple[dict[int, PeerState], dict[int, PeerState]]:
        """(fresh, present) peers: those not older than `peers.max_age_s`, without the distant ones; and these as well.

        The state of a distant peer may be as old as it is at 5 Hz. One that contradicts itself counts as silent.
        """
        fresh, max_age_s = {}, self._max_age_s
        for i, peer in self.known.items():
            if now_s - peer.measured_s <= max_age_s and not peer.contradicts:
                fresh[i] = peer
        if not self.low_rate_s:
            return fresh, fresh
        for i in self._distant & fresh.keys():
            del fresh[i]
        return fresh, {
            i: peer
            for i, peer in self.known.items()
            if i in fresh or (now_s - peer.measured_s <= self._age_limit_s(i) and not peer.contradicts)
        }

    def until_s(self, fresh: Mapping[int, PeerState], present: Mapping[int, PeerState]) -> float:
        """How long all of this is found again without a further packet; -inf where a vehicle is silent, whose age counts."""
        if len(present) < len(self.known):
            return -inf
        until_s: float = self._max_age_s - ROUNDING_S + min(map(MEASUREMENT_TIME, fresh.values()), default=inf)
        if present is fresh:
            return until_s
        at_5_hz = [peer.measured_s + self._age_limit_s(i) - ROUNDING_S for i, peer in present.items() if i not in fresh]
        return min([until_s, *at_5_hz])

    def in_doubt(self, now_s: float) -> tuple[int, ...]:
        """The peers that contradict themselves, while they send."""
        return tuple([i for i, p in self.known.items() if p.contradicts and now_s - p.measured_s <= self._max_age_s])

    def refused(self, now_s: float) -> tuple[int, ...]:
        """The peers that have sent for a while what is refused, or not believed."""
        return self.disbelief.lasting(now_s, self._max_age_s)

    def _age_limit_s(self, vehicle_id: int) -> float:
        return max(self._max_age_s, DISTANT_MAX_AGE_S) if vehicle_id in self.low_rate_s else self._max_age_s

    def _without_leader(self, packet: PeerPacket) -> PeerPacket:
        """The packet as of a follower that knows no leader. Its position is needed for separation."""
        self._count(Code.PEER_EPOCH_TOO_HIGH, packet.sender.vehicle_id)
        return replace(packet, role=Role.FOLLOWER, leader=LeaderReport(len(self._fleet.may_lead), None), change=None)

    def _in_doubt(self, packet: PeerPacket, found: Coherence) -> PeerPacket:
        """The packet with the velocity by its positions and no acceleration: it is kept off, not followed."""
        self._count(Code.PEER_IN_DOUBT, packet.sender.vehicle_id)
        moves_enu_m_s = shortened(found.moves_enu_m_s, self._limits.speed_m_s)
        motion = replace(packet.motion, velocity_enu_m_s=moves_enu_m_s, acceleration_enu_m_s2=ZERO3)
        return replace(packet, motion=motion)

    def _within_limits(self, packet: PeerPacket, most_m_s2: float) -> PeerPacket:
        """The packet with accelerations that this fleet can fly: the law feeds them forward. Its position remains usable."""
        motion, slot, rft = packet.motion, packet.slot, packet.rft
        self._count(Code.PEER_ACCELERATION_LIMITED, packet.sender.vehicle_id)
        return replace(
            packet,
            motion=replace(motion, acceleration_enu_m_s2=shortened(motion.acceleration_enu_m_s2, most_m_s2)),
            slot=replace(slot, acceleration_enu_m_s2=shortened(slot.acceleration_enu_m_s2, most_m_s2)),
            rft=rft and (*rft[:2], shortened(rft[2], most_m_s2)),
        )

    def _count(self, code: Code, vehicle_id: int) -> None:
        self.rejected = count_rejection(self.rejected, rejection_key(code, vehicle_id))
