"""Reports: a packet to the peers every tick, events and a status to the ground."""

from __future__ import annotations

from collections import Counter
from math import inf

from msgspec import Struct
from msgspec.structs import replace

from companion.core.command.arbitration import Intake
from companion.core.consensus.stage import Consensus, LeadView
from companion.core.control.setpoint import Setpoint
from companion.core.estimation.vehicle import Perception
from companion.core.filter.filter import Interventions
from companion.core.formation.guidance import Guidance
from companion.core.preflight import Fitness
from companion.core.safety.failsafe import POSITION_WRONG
from companion.core.safety.fleet_checks import FleetChecks
from companion.core.safety.safeguard import Safety
from companion.laws import Law
from companion.types.autopilot import AutopilotRequest, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import RULES, Flight, FlightPhase, Role
from companion.types.notices import Notice
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.rejections import count_rejection, sum_counts
from companion.types.status import (
    NO_STATE_AGE_S,
    AgentIdentity,
    AutopilotReport,
    CommandReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NeighbourReport,
    SafetyReport,
    Status,
)

LEADER, FORMATION = Role.LEADER, FlightPhase.FORMATION  # member lookup of an enum is slow
STATUS_PERIOD_S = 0.099  # every fifth tick of 50 Hz, also where a tick comes a little early
DESCRIBED_EVERY = 20  # statuses: a reference may have 200 points, and is the same for minutes


class Decision(Struct, frozen=True, gc=False):
    """Results of the stages of one tick. The setpoint and the requests leave the process before the reports are built."""

    now_s: float
    intake: Intake
    perception: Perception
    fitness: Fitness
    consensus: Consensus
    guidance: Guidance
    safety: Safety
    flight: Flight
    setpoint: Setpoint
    requests: tuple[AutopilotRequest, ...]
    distant: frozenset[int] = frozenset()


class Report(Struct, frozen=True, gc=False):
    """What leaves the vehicle besides requests and replies: its peer packet, status and events."""

    peer_packet: PeerPacket | None
    status: Status | None
    events: tuple[Notice, ...]


class ReportStage:
    """Peer packet, status and events. `refused` counts messages rejected before they came to the agent, by reason."""

    def __init__(self, identity: AgentIdentity, law: Law, checks: FleetChecks) -> None:
        self._identity = identity
        self._law = law
        self._checks = checks
        self._interventions = Interventions()
        self._sequence = 0
        self._last_event: Notice | None = None
        self._status_s = -inf
        self._statuses = 0
        self.refused: Counter[str] = Counter()

    def refuse(self, key: str) -> None:
        """Count a message that was refused before it came to the agent."""
        self.refused = count_rejection(self.refused, key)

    def step(self, decided: Decision) -> Report:
        """A packet every tick, a status ten times a second and at once with an event."""
        now_s, separation = decided.now_s, decided.setpoint.separation
        events = decided.intake.events + decided.fitness.events + decided.consensus.events
        if separation.changed_m_s2 > 0.0:
            events += self._interventions.step(now_s, separation)
        events += decided.flight.events + decided.guidance.events + decided.safety.events
        # The last one stays in the status: why a phase ended, a flag, or the autopilot's words, which name the cause of a flag.
        events += decided.perception.events
        if events:
            self._last_event = events[-1]
        status = None
        if events or now_s - self._status_s >= STATUS_PERIOD_S:
            self._status_s = now_s
            self._statuses += 1
            status = self._status(decided)
        return Report(self._packet(decided), status, events)

    def _packet(self, decided: Decision) -> PeerPacket | None:
        """None before there is a position, and while peers must not use it."""
        now_s, vehicle, consensus = decided.now_s, decided.perception.vehicle, decided.consensus
        guidance, flight, setpoint = decided.guidance, decided.flight, decided.setpoint
        if decided.safety.flags & POSITION_WRONG or vehicle.position_time_s == -inf:
            return None
        self._sequence += 1
        identity, beacon = self._identity, consensus.lead.beacon
        leads = consensus.lead.role is LEADER and flight.phase is FORMATION
        rft, state_age_s = setpoint.rft, now_s - vehicle.position_time_s
        return PeerPacket(
            sender=Sender(identity.vehicle_id, identity.session, self._sequence, identity.formation_hash),
            phase=flight.phase,
            role=consensus.lead.role,
            motion=Motion(
                position_enu_m=vehicle.position_enu_m,
                velocity_enu_m_s=vehicle.velocity_enu_m_s,
                acceleration_enu_m_s2=setpoint.acceleration_enu_m_s2,
                state_age_s=state_age_s if state_age_s > 0.0 else 0.0,
                sent_s=now_s,
            ),
            leader=LeaderReport(consensus.prc, beacon and replace(beacon, heading=guidance.published_heading)),
            slot=guidance.slot,
            position_error=vehicle.position_error,
            reference=guidance.held_reference,
            change=guidance.offered if leads else None,
            armed=vehicle.armed,
            rft=(rft.position_enu_m, rft.velocity_enu_m_s, rft.acceleration_enu_m_s2) if rft else None,
            home_enu_m=None if vehicle.returns_elsewhere else vehicle.home_enu_m,
            lost=consensus.peers.lost,
            law_values=setpoint.law_values,
        )

    def _status(self, decided: Decision) -> Status:
        now_s, intake, perception, fitness = decided.now_s, decided.intake, decided.perception, decided.fitness
        consensus, guidance, flight, setpoint = decided.consensus, decided.guidance, decided.flight, decided.setpoint
        vehicle, lead = perception.vehicle, consensus.lead
        peers, neighbours = consensus.peers.packets, consensus.neighbours
        rejected = sum_counts(
            (self.refused, setpoint.rejected, perception.rejected, consensus.peers.rejected, guidance.rejected)
        )
        return Status(
            agent=self._identity,
            phase=flight.phase,
            autopilot=AutopilotReport(
                mode_name=vehicle.mode_name,
                armed=vehicle.armed,
                landed=vehicle.landed,
                battery_percent=fitness.battery_percent,
            ),
            motion=MotionReport(
                position_enu_m=vehicle.position_enu_m,
                velocity_enu_m_s=vehicle.velocity_enu_m_s,
                state_age_s=min(NO_STATE_AGE_S, now_s - vehicle.position_time_s),
                position_error=vehicle.position_error,
            ),
            control=ControlReport(
                hover_thrust_norm=setpoint.hover_thrust_norm,
                disturbance_enu_m_s2=setpoint.disturbance_enu_m_s2,
                largest_step_deg=setpoint.largest_step_deg,
            ),
            leadership=LeadershipReport(
                role=lead.role,
                epoch=lead.term[0],
                prc=consensus.prc,
                leader_beacon=lead.beacon,
                leader_beacon_age_s=lead.beacon_age_s if lead.beacon else None,
            ),
            neighbourhood=NeighbourReport(
                neighbours=neighbours.ids,
                peers=tuple(sorted(peer.sender.vehicle_id for peer in peers)),
                weights=self._law.weights(lead.role is LEADER, neighbours.prcs),
                neighbour_ages_s=tuple([now_s - consensus.peers.fresh[i].measured_s for i in neighbours.ids]),
            ),
            formation=self._formation(guidance, lead),
            safety=SafetyReport(
                flags=tuple(sorted(decided.safety.flags)),
                refuses_return=self._refusal_of_return(vehicle, flight, consensus),
                lacks=() if vehicle.armed else fitness.lacks + self._checks.lacks(vehicle, peers),
                separation=setpoint.separation,
                warnings=() if vehicle.armed else fitness.warnings + self._checks.warnings(vehicle, peers),
            ),
            rejected=rejected,
            last_event=self._last_event,
            command=CommandReport(holder=intake.holder, command_number=intake.number),
        )

    def _formation(self, guidance: Guidance, lead: LeadView) -> FormationReport:
        describes = lead.role is LEADER and self._statuses % DESCRIBED_EVERY == 1
        return FormationReport(
            slot=guidance.plan_slot,
            reference_enu_m=guidance.reference.position_enu_m if guidance.reference else None,
            reference_s=lead.reference_s,
            reference=guidance.held_reference,
            target_age_s=guidance.target_age_s,
            heading=guidance.heading,
            described=guidance.described if describes else None,
        )

    def _refusal_of_return(self, vehicle: VehicleState, flight: Flight, consensus: Consensus) -> Notice | None:
        """So that the ground can ask all vehicles before it commands one."""
        if flight.phase not in RULES[CommandName.RETURN].allowed:
            return None
        return self._checks.refusal_of_return(vehicle, consensus.peers.present.values(), consensus.lead.role)
