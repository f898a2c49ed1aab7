"""What a vehicle tells of itself: a packet to its peers at every tick, events and a status to the ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from msgspec.structs import replace

from companion.core.changes import Changes
from companion.core.command_desk import CommandDesk
from companion.core.cooperation import Neighbourhood
from companion.core.fleet_checks import FleetChecks
from companion.core.flown_formation import FlownFormation
from companion.core.health import NOT_TO_BE_HEEDED
from companion.core.peers import PeerTable
from companion.core.phase import PhaseMachine
from companion.core.senses import Senses
from companion.core.setpoint_stream import SetpointStream
from companion.types import ZERO3, HealthFlag, PeerPacket, Status, VehicleState

STATUS_PERIOD_S = 0.099  # every fifth tick of 50 Hz, also where a tick comes a little early


@dataclass(frozen=True, slots=True)
class Identity:
    """Who tells, and by which files it flies. `session` differs from one start of this vehicle's agent to the next."""

    vehicle_id: int
    session: int
    fleet: str
    formation_hash: int
    law_name: str


class ToPeers:
    """One vehicle's packets."""

    def __init__(
        self,
        identity: Identity,
        machine: PhaseMachine,
        formation: FlownFormation,
        changes: Changes,
        setpoints: SetpointStream,
        flown_for_s: float,
    ) -> None:
        """`flown_for_s`: for so long the last setpoint is believed to be flown."""
        self._identity = identity
        self._machine = machine
        self._formation = formation
        self._changes = changes
        self._setpoints = setpoints
        self._flown_for_s = flown_for_s
        self._sequence = 0

    def packet(
        self,
        now_s: float,
        vehicle: VehicleState,
        around: Neighbourhood,
        flags: frozenset[HealthFlag],
        streams: bool,
    ) -> PeerPacket | None:
        """Nothing is told before there is a position, and while it must not be heeded. `streams`: setpoints go out."""
        if flags & NOT_TO_BE_HEEDED or vehicle.position_time_s == -inf:
            return None
        self._sequence += 1
        identity, formation, word = self._identity, self._formation, around.leader_word
        return PeerPacket(
            vehicle_id=identity.vehicle_id,
            session=identity.session,
            sequence=self._sequence,
            formation_hash=identity.formation_hash,
            phase=self._machine.phase,
            role=around.role,
            position_enu_m=vehicle.position_enu_m,
            velocity_enu_m_s=vehicle.velocity_enu_m_s,
            acceleration_enu_m_s2=(
                self._setpoints.flown_acceleration_enu_m_s2(now_s, self._flown_for_s) if streams else ZERO3
            ),
            state_age_s=max(0.0, now_s - vehicle.position_time_s),
            sent_s=now_s,
            prc=around.prc,
            leader_word=word and replace(word, heading=formation.heading.told),
            slot=formation.slot,
            position_error=vehicle.position_error,
            reference=formation.references.held if formation.references else None,
            change=self._changes.to_pass_on(now_s, around),
            armed=vehicle.armed,
        )


class ToGround:
    """One vehicle's events and status. `refused` counts messages that were refused before they came to the agent, by reason."""

    def __init__(
        self,
        identity: Identity,
        machine: PhaseMachine,
        senses: Senses,
        peers: PeerTable,
        formation: FlownFormation,
        setpoints: SetpointStream,
        desk: CommandDesk,
        checks: FleetChecks,
        events_of: Sequence[list[str]],
    ) -> None:
        """`events_of` are taken from in this order, and emptied."""
        self._identity = identity
        self._machine = machine
        self._senses = senses
        self._peers = peers
        self._formation = formation
        self._setpoints = setpoints
        self._desk = desk
        self._checks = checks
        self._events_of = events_of
        self._last_event = ""
        self._status_s = -inf
        self.refused: Counter[str] = Counter()

    def drain_events(self) -> tuple[str, ...]:
        """All since the last call."""
        events: tuple[str, ...] = ()
        for source in self._events_of:
            if source:
                events += tuple(source)
                source.clear()
        if events:
            self._last_event = events[-1]
        return events

    def status(
        self,
        now_s: float,
        vehicle: VehicleState,
        around: Neighbourhood,
        flags: frozenset[HealthFlag],
        events: tuple[str, ...],
    ) -> Status | None:
        """Ten times a second, and at once when something happened: `events` are this tick's."""
        if not events and now_s - self._status_s < STATUS_PERIOD_S:
            return None
        self._status_s = now_s
        return self._status(now_s, vehicle, around, flags)

    def _status(
        self, now_s: float, vehicle: VehicleState, around: Neighbourhood, flags: frozenset[HealthFlag]
    ) -> Status:
        identity, formation, preflight = self._identity, self._formation, self._senses.preflight
        reference, references, observer = formation.reference, formation.references, self._setpoints.observer
        peers = self._peers.heard(now_s)
        return Status(
            vehicle_id=identity.vehicle_id,
            session=identity.session,
            fleet=identity.fleet,
            formation_hash=identity.formation_hash,
            law=identity.law_name,
            phase=self._machine.phase,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            landed=vehicle.landed,
            position_enu_m=vehicle.position_enu_m,
            velocity_enu_m_s=vehicle.velocity_enu_m_s,
            state_age_s=min(1e6, now_s - vehicle.position_time_s),
            hover_thrust_norm=observer.hover_thrust_norm,
            disturbance_enu_m_s2=observer.disturbance_enu_m_s2,
            role=around.role,
            epoch=around.epoch,
            prc=around.prc,
            leader_word=around.leader_word,
            leader_word_age_s=around.leader_word_age_s if around.leader_word else None,
            neighbours=around.neighbour_ids,
            slot=formation.slots.flown,
            reference_enu_m=reference.position_enu_m if reference else None,
            flags=tuple(sorted(flags)),
            rejected=self._rejected(),
            last_event=self._last_event,
            reference_s=around.reference_s,
            reference=references.held if references else None,
            target_age_s=references.target_age_s if references else None,
            lacks=() if vehicle.armed else preflight.lacks() + self._checks.lacks(vehicle, peers),
            holder=self._desk.holder,
            command_number=self._desk.number,
            peers=tuple(sorted(peer.vehicle_id for peer in peers)),
            battery_percent=preflight.battery_percent,
            position_error=vehicle.position_error,
            heading=formation.heading.flown,
            largest_step_deg=self._setpoints.largest_step_deg,
        )

    def _rejected(self) -> dict[str, int]:
        """By reason, wherever it was."""
        references = self._formation.references
        return dict(
            self.refused
            + self._setpoints.rejected
            + self._senses.tracker.rejected
            + self._peers.rejected
            + Counter(references.rejected if references else ())
        )
