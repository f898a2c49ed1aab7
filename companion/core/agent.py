"""Agent.step: one tick, as a chain of stages that exchange frozen values. `companion/assembly.py` builds the stages.

A tick has two parts. `prepare` runs shortly before the next position is due, and takes what needs none: the packets of the
peers are checked and folded, commands are admitted. `decide` follows with the position, and with the packets that came
meanwhile. It alone judges, answers and commands, all on the newest state and at its own time. `prepare` looks at no state of
the vehicle and evaluates nothing, so a decision does not depend on when its parts ran.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from companion.core.command.arbitration import CommandArbitration, CommandDispatcher, Intake
from companion.core.command.phase import PhaseCommand, PhaseMachine
from companion.core.consensus.neighbours import NONE, DistantPeers
from companion.core.consensus.stage import ConsensusStage
from companion.core.control.setpoint import SetpointStage
from companion.core.estimation.vehicle import VehicleTracker
from companion.core.formation.guidance import Guidance, GuidanceStage
from companion.core.preflight import Preflight
from companion.core.report import Decision, ReportStage
from companion.core.safety.safeguard import SafeguardStage, Safety
from companion.types.commands import Command
from companion.types.flight import FailsafeAction, Flight, FlightPhase
from companion.types.peers import ReceivedPeerPacket
from companion.types.status import SeparationReport
from companion.types.tick import Inbox, Outbox
from companion.types.values import Vector3

FORMATION, WARN = FlightPhase.FORMATION, FailsafeAction.WARN  # member lookup of an enum is slow


class Agent:
    """One vehicle's decisions. Pure: the outputs depend only on the calls made so far."""

    def __init__(
        self,
        *,
        vehicle_id: int,
        perception: VehicleTracker,
        preflight: Preflight,
        phases: PhaseMachine,
        arbitration: CommandArbitration,
        consensus: ConsensusStage,
        guidance: GuidanceStage,
        safeguard: SafeguardStage,
        dispatcher: CommandDispatcher,
        setpoint: SetpointStage,
        distant_peers: DistantPeers | None,
        reporter: ReportStage,
    ) -> None:
        self._vehicle_id = vehicle_id
        self.perception = perception
        self.preflight = preflight
        self.phases = phases
        self.arbitration = arbitration
        self.consensus = consensus
        self.guidance = guidance
        self.safeguard = safeguard
        self.dispatcher = dispatcher
        self.setpoint = setpoint
        self.distant_peers = distant_peers
        self.reporter = reporter
        # Results of the last tick that stages of this one need
        self._flight = Flight()
        self._last_guidance = Guidance()
        self._last_safety = Safety()
        self._last_setpoint_s = 0.0
        self._last_separation = SeparationReport()
        self._distant = NONE
        self._intake: Intake | None = None  # of a tick that is prepared and not decided

    @property
    def phase(self) -> FlightPhase:
        return self._flight.phase

    @property
    def has_handed_over(self) -> bool:
        """No setpoint stream is left that the autopilot would miss."""
        return self._flight.has_handed_over

    @property
    def others_enu_m(self) -> Mapping[int, Vector3]:
        """Where the other vehicles were when they were heard last."""
        return {i: peer.packet.motion.position_enu_m for i, peer in self.consensus.peers.known.items()}

    def reject(self, reason: str) -> None:
        """Count a message that was refused before it came here."""
        self.reporter.refuse(reason)

    def step(self, now_s: float, inbox: Inbox) -> Outbox:
        """One tick: both parts of the decision, then the reports."""
        prepared_s = now_s if inbox.prepared_s is None else inbox.prepared_s
        self.prepare(prepared_s, inbox.peers[: inbox.early], inbox.commands, inbox.checks)
        return self.report(self.decide(now_s, inbox))

    def prepare(
        self,
        now_s: float,
        peers: Collection[ReceivedPeerPacket],
        commands: tuple[Command, ...],
        checks: tuple[Command, ...] = (),
    ) -> None:
        """The part of the next tick that needs no new position. `decide` must follow. `checks` are only answered."""
        assert self._intake is None, "a tick is prepared once"
        self._intake = self.arbitration.step(commands, checks) if commands or checks else self.arbitration.idle
        self.consensus.receive(now_s, peers, self._distant)

    def decide(self, now_s: float, inbox: Inbox) -> Decision:
        """Telemetry -> state -> peers, PrC and weights -> acceleration -> attitude -> output limits. `prepare` ran before."""
        intake, self._intake = self._intake, None
        assert intake is not None, "a tick is prepared before it is decided"
        last, last_guidance = self._flight, self._last_guidance
        perception = self.perception.step(now_s, inbox.telemetry, last, self.preflight.returns_elsewhere)
        vehicle = perception.vehicle
        fitness = self.preflight.step(now_s, inbox.telemetry, vehicle.autopilot, vehicle.home_enu_m)
        before = self.phases.observe(now_s, vehicle)
        refusal = last_guidance.refusal_to_lead
        fit_to_lead = last.phase is FORMATION and self._last_safety.action <= WARN and refusal is None
        consensus = self.consensus.step(
            now_s, vehicle, before, inbox.peers[inbox.early :], intake.admitted, refusal, fit_to_lead, intake.checks
        )
        guidance = self.guidance.step(now_s, vehicle, before, consensus, intake.admitted, inbox.targets, intake.checks)
        safety = self.safeguard.step(
            now_s, vehicle, before, consensus, self._last_separation, self._last_setpoint_s, last.commanded, inbox
        )
        commands: tuple[PhaseCommand, ...] = ()
        if intake.admitted or intake.checks:
            commands = self.dispatcher.step(intake, vehicle, fitness, consensus, guidance, safety)
        flight = self.phases.step(
            now_s,
            vehicle,
            before,
            inbox.telemetry,
            guidance.requests,
            commands,
            safety.requests,
            self._last_separation.changed_m_s2,
        )
        parameter_requests = self.preflight.ask(now_s, flight.streams)
        setpoint = self.setpoint.step(now_s, vehicle, before, flight, consensus, guidance, safety, inbox.traffic)
        self._flight, self._last_guidance, self._last_safety = flight, guidance, safety
        self._last_setpoint_s, self._last_separation = setpoint.sent_s, setpoint.separation
        if self.distant_peers is not None:
            hears_leader, ids = consensus.lead.beacon is not None, consensus.neighbours.ids
            self._distant = self.distant_peers.step(
                now_s, vehicle, flight, guidance.slot, hears_leader, ids, consensus.peers.known
            )
        return Decision(
            now_s=now_s,
            intake=intake,
            perception=perception,
            fitness=fitness,
            consensus=consensus,
            guidance=guidance,
            safety=safety,
            flight=flight,
            setpoint=setpoint,
            requests=perception.requests + flight.requests + parameter_requests,
            distant=self._distant,
        )

    def report(self, decided: Decision) -> Outbox:
        """Peer packet, status, replies and events of the decision, with its setpoint and requests."""
        intake, consensus, guidance, flight = decided.intake, decided.consensus, decided.guidance, decided.flight
        report = self.reporter.step(decided)
        answers = consensus.answers + guidance.answers + flight.answers
        is_asked = intake.received or intake.refused_checks
        return Outbox(
            attitude_target=decided.setpoint.target,
            requests=decided.requests,
            peer_packet=report.peer_packet,
            status=report.status,
            replies=self.arbitration.replies(self._vehicle_id, intake, answers) if is_asked or answers else (),
            events=report.events,
            distant_ids=tuple(sorted(decided.distant)) if decided.distant else (),
        )
