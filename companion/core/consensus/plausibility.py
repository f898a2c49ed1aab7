"""Checks of one peer packet alone: what it claims in the fleet, and its numbers. `peers.py` compares it with the last one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isfinite, pi

from companion.types.bounds import MAX_CHANGE_S, MAX_COORDINATE_M, MAX_MISSION_S
from companion.types.commands import MAX_EPOCH
from companion.types.flight import Role
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Code
from companion.types.peers import PeerPacket
from companion.types.vectors import Vector3

LEADER = Role.LEADER  # enum member lookup is slow, and every packet needs it
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
    """What vehicles of this fleet can fly at most: no received value is used beyond it."""

    speed_m_s: float
    acceleration_m_s2: float
    fence_size_m: Vector3


def refusal_of_claims(packet: PeerPacket, fleet: KnownFleet) -> Code | None:
    """Checks sender, formation hash, role, PrC, leader beacon, reference and change."""
    if packet.vehicle_id == fleet.own_id:
        return Code.PEER_OWN_ID
    may_lead = fleet.may_lead.get(packet.vehicle_id)
    if may_lead is None:
        return Code.PEER_NOT_IN_FLEET
    if packet.formation_hash != fleet.formation_hash:
        return Code.PEER_OTHER_FLEET_FILE
    is_leader, beacon = packet.role is LEADER, packet.leader_beacon
    if is_leader and not may_lead:
        return Code.PEER_NOT_A_LEADER
    if not 1 <= packet.prc <= len(fleet.may_lead) or (packet.prc == 1) is not is_leader:
        return Code.PEER_PRC_IMPLAUSIBLE
    held = packet.reference
    if held and not (held.flown >= 0 and held.waiting >= 0 and 0.0 <= held.begun_s <= MAX_MISSION_S):
        return Code.PEER_REFERENCE_IMPLAUSIBLE
    if packet.change is not None and not (is_leader and _is_plausible_change(packet.change, fleet)):
        return Code.PEER_CHANGE_IMPLAUSIBLE
    if is_leader and (beacon is None or beacon.leader_id != packet.vehicle_id):
        return Code.PEER_BEACON_MISSING
    if beacon is not None:
        may_claim = beacon.claim == 0 or (beacon.leader_id, beacon.claim) in fleet.claims
        in_range = 0 <= beacon.epoch <= MAX_EPOCH and 0.0 <= beacon.reference_s <= MAX_MISSION_S
        heading = beacon.heading
        turns = abs(heading.rate_rad_s) <= MAX_TURN_RAD_S and abs(heading.acceleration_rad_s2) <= MAX_TURN_RAD_S2
        heading_in_range = turns and abs(heading.angle_rad) <= pi
        if not (fleet.may_lead.get(beacon.leader_id, False) and may_claim and in_range and heading_in_range):
            return Code.PEER_BEACON_IMPLAUSIBLE
    return None


def refusal_of_motion(packet: PeerPacket, limits: FleetLimits, known: FlownSlot | None) -> Code | None:
    """Checks position, velocity, acceleration, times, slot and position error. `known` is a slot that has passed before."""
    x, y, z = packet.position_enu_m
    vx, vy, vz = packet.velocity_enu_m_s
    ax, ay, az = packet.acceleration_enu_m_s2
    numbers = x + y + z + vx + vy + vz + ax + ay + az + packet.state_age_s + packet.sent_s
    if not isfinite(numbers):  # one number that is not finite makes the sum so
        return Code.PEER_NOT_FINITE
    most = MAX_COORDINATE_M
    if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
        return Code.PEER_POSITION_IMPLAUSIBLE
    if hypot(vx, vy, vz) > limits.speed_m_s:
        return Code.PEER_SPEED_IMPLAUSIBLE
    if hypot(ax, ay, az) > MAX_ACCELERATION_M_S2:
        return Code.PEER_ACCELERATION_IMPLAUSIBLE
    if not 0.0 <= packet.state_age_s <= MAX_STATE_AGE_S or not 0.0 <= packet.sent_s <= MAX_SENT_S:
        return Code.PEER_TIME_IMPLAUSIBLE
    slot = packet.slot
    if slot != known and not _is_plausible_slot(slot, limits):
        return Code.PEER_SLOT_IMPLAUSIBLE
    sx, sy, sz = slot.velocity_enu_m_s
    if not hypot(vx - sx, vy - sy, vz - sz) <= limits.speed_m_s:  # of the RFT that it flies by; also for NaN
        return Code.PEER_SLOT_IMPLAUSIBLE
    if packet.rft is not None and not _is_plausible_rft(packet.rft, limits):
        return Code.PEER_SLOT_IMPLAUSIBLE
    error = packet.position_error
    if error and not (0.0 <= error.horizontal_m <= MAX_ERROR_M and 0.0 <= error.vertical_m <= MAX_ERROR_M):
        return Code.PEER_POSITION_ERROR_IMPLAUSIBLE
    return None


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
