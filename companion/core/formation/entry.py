"""Entry into formation: where the fleet is, joining vehicles in formation, and the lead-in of a leader off the fleet.

Vehicles that form together use `paths.py`. A vehicle that forms later, among others in formation, joins them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import dist, hypot

from companion.core.consensus.law import formation_state
from companion.core.consensus.peers import PeerState, neighbour_at
from companion.core.consensus.stage import Consensus
from companion.core.formation.paths import (
    FORM_OR_HOLD,
    Entering,
    FormingTogether,
    Offset,
    Path,
    gentle_path,
    offset_from,
)
from companion.core.reference.blend import SAMPLES
from companion.geometry.formations import in_formation_frame
from companion.geometry.vectors import mean, minus, plus
from companion.types.autopilot import VehicleState
from companion.types.flight import COOPERATING, STREAMING, Flight, FlightPhase, Role
from companion.types.formation import FlownSlot, FormationState
from companion.types.notices import Code, Notice, Refused

LEADER, ENGAGE, FORMATION = Role.LEADER, FlightPhase.ENGAGE, FlightPhase.FORMATION  # member lookup of an enum is slow
COMMANDED_WITHIN_S = 0.25  # from the command to this vehicle to the packet of a peer that was commanded as well
CHECK_PERIOD_S = 0.2


class FormationEntry:
    """The entry of this vehicle: whether it joins others, the checks of its path, and R of a leader that leads in."""

    def __init__(self, own_id: int, together: FormingTogether, joining: Joining, lead_in: LeadIn) -> None:
        self._own_id = own_id
        self._together = together
        self._joining = joining
        self._lead_in = lead_in
        self._joins = False  # peers were in formation for a while when this vehicle was commanded to form
        self._commanded_s = 0.0
        self._check_s = 0.0
        self._led = False  # whether this vehicle was leader in formation in the last tick

    def update(self, now_s: float, formed: Iterable[int]) -> None:
        """When other peers than before are in formation: their ids."""
        self._joining.update(now_s, formed)

    def judge_command(self, now: Entering, reference: FormationState | None) -> tuple[Notice | None, Notice | None]:
        """(refusal, warning) of the command to form. `reference` is R of a leader."""
        self._joins, self._commanded_s, self._check_s = self._joining.is_due(now.now_s), now.now_s, now.now_s
        try:
            path = self.path(now, reference)
        except Refused as refusal:
            return refusal.notice, None
        if self._joins:
            return None, None
        fleet, _ = self._fleet(now, reference)
        return None, self._together.crossing(now, fleet, path)

    def judge_check(self, now: Entering, reference: FormationState | None) -> tuple[Notice | None, Notice | None]:
        """As `judge_command`, for a check of that command: nothing is begun."""
        before = self._joins, self._commanded_s, self._check_s
        try:
            return self.judge_command(now, reference)
        finally:
            self._joins, self._commanded_s, self._check_s = before

    def path(self, now: Entering, reference: FormationState | None) -> Path | None:
        """From here into the own slot; None where the law alone flies. Raises Refused where there is no path."""
        if self._joins:
            return self._joining.path(now)
        forming = FORM_OR_HOLD if now.now_s - self._commanded_s <= COMMANDED_WITHIN_S else STREAMING
        fleet, ends_in_s = self._fleet(now, reference)
        if reference is fleet:
            path = self._together.leaders_path(now, fleet, forming)
        else:
            if ends_in_s > 0.0:
                ends_in_s = min(ends_in_s, self._together.longest_s(now, fleet))
            path = self._together.followers_path(now, fleet, ends_in_s)
        if now.now_s >= self._check_s:
            self._check_s = now.now_s + CHECK_PERIOD_S
            if refusal := self._together.refusal(now, fleet, path, forming):
                raise Refused(refusal.code, refusal.text)
        return path

    def reference(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        held: FormationState,
        slot: FlownSlot,
    ) -> FormationState | None:
        """R that this vehicle flies as leader, None for a follower. `held` is R of its plan, `slot` the one flown last."""
        if consensus.lead.role is not LEADER:
            self._led = False
            return None
        begins = flight.phase is ENGAGE or not self._led
        self._led = flight.phase is FORMATION
        if flight.phase not in STREAMING:
            self._lead_in.end()
        elif begins:
            states: list[FormationState] = [
                neighbour_at(peer, now_s, peer.packet.leader.prc) for peer in _formed(consensus.peers.fresh.values())
            ]
            if self._led:
                states.append(formation_state(vehicle.position_enu_m, vehicle.velocity_enu_m_s, slot))
            self._lead_in.begin(now_s, mean_state(states) if states else held, held)
        return self._lead_in.added(now_s, held)

    def _fleet(self, now: Entering, reference: FormationState | None) -> tuple[FormationState, float]:
        """The RFT as the fleet flies it, and the time until the paths of the others end.

        A leader knows it, unless others already fly in formation. A follower takes it from a leader that forms, then from
        vehicles in formation, then from a leader in hold, which the fleet waits with, then from vehicles that form.
        Raises Refused.
        """
        now_s, peers, formed = now.now_s, now.peers, _formed(now.peers)
        leaders = [p for p in peers if p.packet.role is LEADER and p.packet.phase in COOPERATING]
        forming = [p for p in leaders if p.packet.phase in STREAMING]
        if reference is not None and not formed:
            if not (first := _first(forming)) or first.packet.sender.vehicle_id > self._own_id:
                return reference, 0.0
            return neighbour_at(first, now_s, first.packet.leader.prc), first.packet.slot.moves_for_s
        if reference is None and (first := _first(forming)):
            return neighbour_at(first, now_s, first.packet.leader.prc), first.packet.slot.moves_for_s
        if formed:
            ends_in_s = max(peer.packet.slot.moves_for_s for peer in formed)
            return mean_state([neighbour_at(peer, now_s, peer.packet.leader.prc) for peer in formed]), ends_in_s
        engaged = [peer for peer in peers if peer.packet.phase in STREAMING]
        if first := _first(leaders) or _first(engaged):
            return neighbour_at(first, now_s, first.packet.leader.prc), first.packet.slot.moves_for_s
        text = "no leader and no vehicle that forms is received; give form again when a neighbour is in formation"
        raise Refused(Code.NO_FORMATION_TO_JOIN, text)


def _formed(peers: Iterable[PeerState]) -> list[PeerState]:
    return [peer for peer in peers if peer.packet.phase is FORMATION]


def _first(peers: Collection[PeerState]) -> PeerState | None:
    return min(peers, key=lambda peer: peer.packet.sender.vehicle_id, default=None)


JOINS_AFTER_S = 2.0  # a peer in formation for longer did not form together with this vehicle


class Joining:
    """Since when each peer has been in formation, and the path to the own slot among them."""

    def __init__(self, own_id: int, separation_m: float, speed_m_s: float) -> None:
        self._own_id = own_id
        self._separation_m = separation_m
        self._speed_m_s = speed_m_s
        self._since_s: dict[int, float] = {}

    def update(self, now_s: float, formed: Iterable[int]) -> None:
        """When other peers than before are in formation: their ids."""
        since_s = self._since_s
        self._since_s = {vehicle_id: since_s.get(vehicle_id, now_s) for vehicle_id in formed}

    def is_due(self, now_s: float) -> bool:
        """Whether a peer has been in formation long enough for this vehicle to join it."""
        return any(now_s - since_s > JOINS_AFTER_S for since_s in self._since_s.values())

    def path(self, now: Entering) -> Path:
        """delta from here to the own slot. Raises Refused without a vehicle in formation, or within separation_m of one."""
        now_s, heading, peers, slot = now.now_s, now.heading, now.peers, now.slots_m[self._own_id]
        formed = _formed(peers)
        self._refuse_while_others_move(peers)
        if not formed:
            raise Refused(Code.NO_FORMATION_TO_JOIN, "no vehicle is in formation any more")
        fleet = mean_state([neighbour_at(peer, now_s, peer.packet.leader.prc) for peer in formed])
        for peer in formed:
            apart_m = dist(slot, in_formation_frame(peer.slot_at(now_s).position_enu_m, heading))
            if apart_m < self._separation_m:
                text = f"its slot is taken: vehicle {peer.packet.sender.vehicle_id} flies {apart_m:.2f} m from it"
                raise Refused(Code.SLOT_TAKEN, text)
        position_enu_m, velocity_enu_m_s = now.vehicle.position_enu_m, now.vehicle.velocity_enu_m_s
        offset = offset_from(position_enu_m, velocity_enu_m_s, fleet, slot, heading)
        delta, lasts_s = gentle_path(offset, self._speed_m_s)
        x, y, z = fleet.position_enu_m
        points = [delta(lasts_s * k / SAMPLES)[0] for k in range(SAMPLES + 1)]
        for peer in peers:
            px, py, pz = peer.position_at(now_s)
            dx, dy, dz = in_formation_frame((px - x, py - y, pz - z), heading)
            there = (dx - slot[0], dy - slot[1], dz - slot[2])
            apart_m = min(dist(point, there) for point in points)
            if apart_m < self._separation_m:
                raise Refused(
                    Code.PATH_TOO_CLOSE,
                    f"the path to its slot comes within {apart_m:.2f} m of vehicle {peer.packet.sender.vehicle_id};"
                    f" expected at least separation_m, {self._separation_m:g} m",
                )
        return delta, lasts_s

    def _refuse_while_others_move(self, peers: Iterable[PeerState]) -> None:
        """Raises Refused while another vehicle moves within the formation or joins: vehicles join one at a time."""
        for packet in (peer.packet for peer in peers):
            slot = packet.slot
            if packet.phase is FORMATION and (slot.moves or slot.waiting != slot.formation):
                text = f"vehicle {packet.sender.vehicle_id} is not in its slot yet; give form again then"
                raise Refused(Code.PEER_STILL_JOINING, text)
            if packet.phase is FlightPhase.ENGAGE and packet.sender.vehicle_id < self._own_id:
                text = f"vehicle {packet.sender.vehicle_id} is joining; give form again then"
                raise Refused(Code.PEER_STILL_JOINING, text)


def mean_state(states: Collection[FormationState]) -> FormationState:
    """Mean RFT state over one or more vehicles."""
    return FormationState(mean([s.position_enu_m for s in states]), mean([s.velocity_enu_m_s for s in states]))


class LeadIn:
    """rho of this vehicle while it is leader in formation. It depends on its own clock alone.

    A successor of a lost leader, a leader that comes back from hold, and a fleet that lags behind a fast RFT are not
    where the RFT of the leader is. Without rho the law would fly it at once, in a step as large as the difference.
    """

    def __init__(self, speed_m_s: float, law_within_m: float) -> None:
        """`speed_m_s` limits what rho adds; up to `law_within_m` the law alone settles the difference."""
        self._speed_m_s = speed_m_s
        self._law_within_m = law_within_m
        self._path: Path | None = None
        self._begun_s = 0.0

    def begin(self, now_s: float, fleet: FormationState, reference: FormationState) -> None:
        """Begin at `fleet`, the RFT as the fleet flies it now. `reference` is R of this vehicle."""
        offset = Offset(
            minus(fleet.position_enu_m, reference.position_enu_m),
            minus(fleet.velocity_enu_m_s, reference.velocity_enu_m_s),
        )
        self._path, self._begun_s = None, now_s
        if offset.distance_m > self._law_within_m or hypot(*offset.velocity_m_s) > self._speed_m_s:
            try:
                self._path = gentle_path(offset, self._speed_m_s)
            except Refused:  # the guidance stage lets no vehicle lead from so far away
                return

    def end(self) -> None:
        self._path = None

    def added(self, now_s: float, reference: FormationState) -> FormationState:
        """R + rho."""
        if self._path is None:
            return reference
        delta, lasts_s = self._path
        elapsed_s = now_s - self._begun_s
        if elapsed_s >= lasts_s:
            self._path = None
            return reference
        position, velocity, acceleration = delta(elapsed_s)
        return FormationState(
            plus(reference.position_enu_m, position),
            plus(reference.velocity_enu_m_s, velocity),
            plus(reference.acceleration_enu_m_s2, acceleration),
        )
