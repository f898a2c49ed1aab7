"""Newest believable state of every peer. Nothing from outside reaches the law but through here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from math import dist, hypot, isfinite, pi

from msgspec import Struct
from msgspec.structs import replace

from companion.core.phase import ON_GROUND
from companion.types import (
    MAX_EPOCH,
    MAX_EPOCHS_AHEAD,
    ZERO3,
    FlownSlot,
    FormationChange,
    LeaderWord,
    PeerPacket,
    ReceivedPeerPacket,
    Role,
    Vector3,
)

LEADER = Role.LEADER  # a member of an Enum is slow to find, and this is asked of every packet
MAX_COORDINATE_M = 20_000.0
MAX_ACCELERATION_M_S2 = 100.0
MAX_ERROR_M = 10_000.0
MAX_REFERENCE_S = 1e6
MAX_TURN_RAD_S, MAX_TURN_RAD_S2 = 5.0, 20.0  # several times what any formation turns with
MAX_SENT_S = 1e9  # thirty years since that computer was started
CREEP = 2e-4  # seconds a second: two computers' clocks drift apart by less
JUMP_MARGIN_M = 1.0  # what an estimator's correction may add to the way flown between two packets


class PeerState(Struct, frozen=True, gc=False):
    """A peer's newest packet, when it came, and how much later than packets of its session can come.

    No clock is common to both, so `least_apart_s` is of their clocks as well as of the way: received less sent, of the packet
    with the shortest way. `measured_s` is when the position was, on this vehicle's clock: what it had of age when it was sent
    and what held it up before it was received.
    """

    packet: PeerPacket
    received_s: float
    least_apart_s: float
    measured_s: float

    @property
    def late_s(self) -> float:
        """How much later it came than it could."""
        return self.received_s - self.packet.sent_s - self.least_apart_s

    def position_at(self, now_s: float) -> Vector3:
        """The position carried on with its velocity over its age, so that both sides of x_i - x_j mean the same time."""
        age_s = now_s - self.measured_s
        (x, y, z), (vx, vy, vz) = self.packet.position_enu_m, self.packet.velocity_enu_m_s
        return (x + vx * age_s, y + vy * age_s, z + vz * age_s)

    def slot_at(self, now_s: float) -> FlownSlot:
        """The slot that it flies, carried on likewise."""
        slot, age_s = self.packet.slot, now_s - self.measured_s
        if slot.velocity_enu_m_s == ZERO3:
            return slot
        (x, y, z), (vx, vy, vz) = slot.position_enu_m, slot.velocity_enu_m_s
        return replace(slot, position_enu_m=(x + vx * age_s, y + vy * age_s, z + vz * age_s))


class PeerTable:
    """Checks every packet: identity, formation, order, finite, plausible. `rejected` counts what was refused, by reason."""

    def __init__(
        self,
        own_id: int,
        may_lead: Mapping[int, bool],
        formation_hash: int,
        max_age_s: float,
        max_speed_m_s: float,
        successors: Sequence[int],
    ) -> None:
        self._own_id = own_id
        self._claims = {(vehicle_id, rank) for rank, vehicle_id in enumerate(successors, start=1)}
        self._may_lead = may_lead  # by the id of every vehicle of the fleet
        self._formation_hash = formation_hash
        self._max_age_s = max_age_s
        self._max_speed_m_s = max_speed_m_s
        self._newest: dict[int, PeerState] = {}
        self.stood_enu_m: dict[int, Vector3] = {}  # each where it was last heard of on the ground
        self.rejected: Counter[str] = Counter()

    def fold(self, packets: Iterable[ReceivedPeerPacket], epoch: int) -> None:
        """`epoch` is the one of the lead that this vehicle is in."""
        for received in packets:
            vehicle_id = received.packet.vehicle_id
            reason = self._refusal(received, epoch)
            if reason is None:
                peer = _timed(received, self._newest.get(vehicle_id))
                if peer.late_s <= self._max_age_s:
                    self._newest[vehicle_id] = peer
                    if received.packet.phase in ON_GROUND:
                        self.stood_enu_m[vehicle_id] = received.packet.position_enu_m
                    continue
                reason = "comes too late"
            self.rejected[f"peer {vehicle_id}: {reason}"[:80]] += 1

    @property
    def newest(self) -> Mapping[int, PeerState]:
        """What each peer said last, however long ago."""
        return self._newest

    def fresh(self, now_s: float) -> dict[int, PeerState]:
        """Peers whose state is not older than the configured age."""
        return {i: peer for i, peer in self._newest.items() if now_s - peer.measured_s <= self._max_age_s}

    def heard(self, now_s: float) -> list[PeerPacket]:
        """What all those said last that are heard of just now, whatever they do."""
        return [peer.packet for peer in self.fresh(now_s).values()]

    def _refusal(self, received: ReceivedPeerPacket, epoch: int) -> str | None:
        packet = received.packet
        if packet.vehicle_id == self._own_id:
            return "uses this vehicle's own id"
        may_lead = self._may_lead.get(packet.vehicle_id)
        if may_lead is None:
            return "not in the fleet file"
        if packet.formation_hash != self._formation_hash:
            return "has another fleet file (formation hash differs)"
        if packet.role is LEADER and not may_lead:
            return "claims to be leader, by the fleet file it may not"
        if packet.leader_word is not None and packet.leader_word.epoch > epoch + MAX_EPOCHS_AHEAD:
            return "its leader's epoch is too far ahead"
        newest = self._newest.get(packet.vehicle_id)
        return self._implausible(packet) or (self._unlikely_after(newest, received) if newest else None)

    def _implausible(self, packet: PeerPacket) -> str | None:
        x, y, z = packet.position_enu_m
        vx, vy, vz = packet.velocity_enu_m_s
        ax, ay, az = packet.acceleration_enu_m_s2
        numbers = x + y + z + vx + vy + vz + ax + ay + az + packet.state_age_s + packet.sent_s
        if not isfinite(numbers):  # one that is not spoils the sum
            return "numbers not finite"
        if max(x, y, z) > MAX_COORDINATE_M or min(x, y, z) < -MAX_COORDINATE_M:
            return "position not plausible"
        if hypot(vx, vy, vz) > self._max_speed_m_s:
            return "speed not plausible"
        if hypot(ax, ay, az) > MAX_ACCELERATION_M_S2:
            return "acceleration not plausible"
        if packet.state_age_s < 0.0:
            return "state from the future"
        if not 0.0 <= packet.sent_s <= MAX_SENT_S:
            return "time of sending not plausible"
        if not self._is_plausible_slot(packet.slot):
            return "slot not plausible"
        error = packet.position_error
        if error and not (0.0 <= error.horizontal_m <= MAX_ERROR_M and 0.0 <= error.vertical_m <= MAX_ERROR_M):
            return "position error not plausible"
        leads = packet.role is LEADER
        if not 1 <= packet.prc <= len(self._may_lead) or (packet.prc == 1) is not leads:
            return "PrC not plausible"
        held = packet.reference
        if held and not (0 <= held.flown <= held.waiting and 0.0 <= held.begun_s <= MAX_REFERENCE_S):
            return "reference not plausible"
        if packet.change is not None and not (leads and self._is_plausible_change(packet.change)):
            return "formation passed on not plausible"
        word = packet.leader_word
        if leads and (word is None or word.leader_id != packet.vehicle_id):
            return "a leader without a word of its own"
        if word is not None and not self._is_plausible(word):
            return "leader's word not plausible"
        return None

    def _is_plausible_slot(self, slot: FlownSlot) -> bool:
        x, y, z = slot.position_enu_m
        inside = abs(x) <= MAX_COORDINATE_M and abs(y) <= MAX_COORDINATE_M and abs(z) <= MAX_COORDINATE_M
        slow = hypot(*slot.velocity_enu_m_s) <= self._max_speed_m_s
        gentle = hypot(*slot.acceleration_enu_m_s2) <= MAX_ACCELERATION_M_S2
        return inside and slow and gentle and 0 <= slot.formation <= slot.waiting

    def _is_plausible_change(self, change: FormationChange) -> bool:
        """One slot for each vehicle of the fleet, nothing out of this world; the rest is `core/slot_plan.py`'s to judge."""
        of_each = sorted(vehicle_id for vehicle_id, _ in change.slots_enu_m) == sorted(self._may_lead)
        near = all(abs(d) <= MAX_COORDINATE_M for _, slot_enu_m in change.slots_enu_m for d in slot_enu_m)
        in_time = 0.0 <= change.begins_s <= MAX_REFERENCE_S and 0.0 <= change.lasts_s <= MAX_REFERENCE_S
        return of_each and near and in_time and change.number >= 0 and set(change.absent) <= self._may_lead.keys()

    def _is_plausible(self, word: LeaderWord) -> bool:
        may_lead = self._may_lead.get(word.leader_id, False)
        told_so = word.claim == 0 or (word.leader_id, word.claim) in self._claims
        heading = word.heading
        turns = abs(heading.rate_rad_s) <= MAX_TURN_RAD_S and abs(heading.acceleration_rad_s2) <= MAX_TURN_RAD_S2
        if not (turns and abs(heading.angle_rad) <= pi):
            return False
        return may_lead and told_so and 0 <= word.epoch <= MAX_EPOCH and 0.0 <= word.reference_s <= MAX_REFERENCE_S

    def _unlikely_after(self, newest: PeerState, received: ReceivedPeerPacket) -> str | None:
        """In the light of the newest packet from the same vehicle."""
        packet, before = received.packet, newest.packet
        newest_is_old = received.received_s - newest.measured_s > self._max_age_s
        if before.session != packet.session:
            # A vehicle that restarted has been silent for a while; another session at once is a second one with the same id.
            if not newest_is_old:
                return "two vehicles with one id"
        elif packet.sequence <= before.sequence:
            return "out of order or replayed"
        if newest_is_old:
            return None
        elapsed_s = max(0.0, received.received_s - newest.received_s) + self._max_age_s
        way_m = dist(packet.position_enu_m, before.position_enu_m)
        return "position jumped" if way_m > self._max_speed_m_s * elapsed_s + JUMP_MARGIN_M else None


def _timed(received: ReceivedPeerPacket, newest: PeerState | None) -> PeerState:
    """What a packet was held up by counts from the shortest way of its session, slowly forgotten: clocks drift apart."""
    packet, received_s = received.packet, received.received_s
    apart_s = least_apart_s = received_s - packet.sent_s
    if newest is not None and newest.packet.session == packet.session:
        least_known_s = newest.least_apart_s + CREEP * (received_s - newest.received_s)
        if least_known_s < apart_s:
            least_apart_s = least_known_s
    late_s = apart_s - least_apart_s
    return PeerState(packet, received_s, least_apart_s, received_s - late_s - packet.state_age_s)
