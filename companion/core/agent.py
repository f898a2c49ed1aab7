"""Agent.step: one tick from all that came in to all that goes out. The whole flow, top to bottom.

What each line of it does is a file of its own beside this one; `companion/assembly.py` puts them together.
"""

from __future__ import annotations

from companion.core.changes import Changes
from companion.core.cooperation import COOPERATING, Cooperation
from companion.core.flown_formation import FlownFormation
from companion.core.obedience import Obedience
from companion.core.phase import PhaseMachine
from companion.core.safeguard import Safeguard
from companion.core.senses import Senses
from companion.core.steering import Steering
from companion.core.telling import ToGround, ToPeers
from companion.types import FlightPhase, Inbox, Outbox


class Agent:
    """One vehicle's decisions. Pure: what comes out depends on the calls made so far and on nothing else."""

    def __init__(
        self,
        machine: PhaseMachine,
        senses: Senses,
        obedience: Obedience,
        cooperation: Cooperation,
        changes: Changes,
        formation: FlownFormation,
        safeguard: Safeguard,
        steering: Steering,
        to_peers: ToPeers,
        to_ground: ToGround,
    ) -> None:
        self._machine = machine
        self._senses = senses
        self._obedience = obedience
        self._cooperation = cooperation
        self._changes = changes
        self._formation = formation
        self._safeguard = safeguard
        self._steering = steering
        self._to_peers = to_peers
        self._to_ground = to_ground

    @property
    def phase(self) -> FlightPhase:
        return self._machine.phase

    @property
    def has_handed_over(self) -> bool:
        """No setpoint stream is left that the autopilot would miss."""
        return self._machine.has_handed_over(self._senses.tracker.state)

    def reject(self, reason: str) -> None:
        """Count a message that was refused before it came here."""
        self._to_ground.refused[reason] += 1

    def step(self, now_s: float, inbox: Inbox) -> Outbox:
        """One tick: telemetry -> state -> peers -> PrC and weights -> acceleration -> attitude -> the last gate."""
        machine = self._machine
        vehicle = self._senses.hear(now_s, inbox.telemetry, is_heeded=machine.phase in COOPERATING)
        machine.follow_truth(vehicle)
        orders = self._obedience.take_in(inbox.commands)
        # A new role comes before all that it decides: one tick, its packet included, is of one role.
        self._obedience.change_lead(now_s, orders, vehicle)
        if not vehicle.armed:
            self._cooperation.landed()
            self._formation.landed()
        around = self._cooperation.update(
            now_s, vehicle.position_enu_m, inbox.peers, machine.in_formation, self._safeguard.fit_to_lead
        )
        self._changes.update(now_s, orders, vehicle, around)
        self._formation.update(now_s, vehicle, around, inbox.targets)
        flags, action = self._safeguard.judge(now_s, inbox.telemetry, vehicle, around)
        self._steering.observe_disturbance(now_s, vehicle, action)

        streamed = machine.streams(vehicle)
        self._obedience.obey(now_s, orders, vehicle, flags)
        if machine.streams(vehicle) and not streamed:
            self._steering.setpoints.open(now_s, vehicle)
        if inbox.stopping:
            self._safeguard.stop(now_s, vehicle)
        self._safeguard.act(now_s, vehicle, around, flags, action)
        requests = self._senses.ask_origin(now_s, vehicle) + machine.advance(now_s, vehicle, inbox.telemetry)
        streams = machine.streams(vehicle)
        if not streams:  # what was found before goes for the whole formation
            requests += self._senses.preflight.ask(now_s)
        target = self._steering.setpoint(now_s, vehicle, around, action, streamed)

        events = self._to_ground.drain_events()
        return Outbox(
            attitude_target=target,
            requests=requests,
            peer_packet=self._to_peers.packet(now_s, vehicle, around, flags, streams),
            status=self._to_ground.status(now_s, vehicle, around, flags, events),
            replies=self._obedience.replies(orders),
            events=events,
        )
