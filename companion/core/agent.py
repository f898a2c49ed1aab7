"""Agent.step: one tick from all that came in to all that goes out. The whole flow, top to bottom."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import cos

from companion.core.attitude import attitude_target, limit_acceleration
from companion.core.cooperation import COOPERATING, Cooperation, Neighbourhood
from companion.core.disturbance import HOVER_PARAMETERS, DisturbanceObserver, Motion
from companion.core.envelope import EnvelopeLimits, LastGate
from companion.core.failsafe import failsafe_action
from companion.core.fleet_checks import FleetChecks
from companion.core.flight_manners import manners_of
from companion.core.formation import (
    FormationLaw,
    Gains,
    Place,
    feedback,
    formation_acceleration,
    place,
)
from companion.core.health import AgeLimits, health_flags
from companion.core.phase import RULES, PhaseMachine
from companion.core.preflight import Preflight
from companion.core.reference import ReferenceTrajectory
from companion.core.vehicle_state import VehicleTracker
from companion.types import (
    ZERO3,
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    Command,
    CommandName,
    CommandReply,
    FailsafeAction,
    FlightPhase,
    HealthFlag,
    Inbox,
    LandedState,
    Lead,
    Outbox,
    ParameterSample,
    PeerPacket,
    RequestOrigin,
    Role,
    Status,
    Telemetry,
    Vector3,
    VehicleState,
)

HAND_OVER_S = 2.0  # at the end: how long the autopilot may take to go into its own hold
SILENT_TOO_LONG_S = 0.5  # less than COM_OF_LOSS_T: PX4 re-enters OFFBOARD by itself when a stream returns
MODE_SURE_S = 0.2  # so old may the mode be where the agent, seeing nothing else, still asks for another
ORIGIN_REPEAT_S = 1.0
ORIGIN_REFRESH_S = 5.0  # PX4 tells a changed origin once, and that one datagram may be lost
ORIGIN_SOON_S = 0.1  # when the position jumped: a new origin may be why
NOT_TO_BE_HEEDED = frozenset({HealthFlag.FRAME_CONTRADICTED, HealthFlag.POSITION_JUMPED})
THRUST_FRESH_S = 0.3  # PX4 tells its thrust 10 times a second where nothing else was asked
CLIMBS_M_S = 0.3  # faster than that it does not stand on the ground any more
STATUS_PERIOD_S = 0.099  # every fifth tick of 50 Hz, also where a tick comes a little early


@dataclass(frozen=True, slots=True)
class AgentSetup:
    """What does not change in flight. Where `law_flies_altitude` is False every vehicle holds its own altitude."""

    vehicle_id: int
    session: int
    fleet: str
    formation_hash: int
    law_name: str
    slot_enu_m: Vector3
    law: FormationLaw
    law_flies_altitude: bool
    altitude_hold_gains: Gains
    reference: ReferenceTrajectory | None  # of those that may lead, and of no other
    takeoff_height_m: float
    envelope: EnvelopeLimits
    ages: AgeLimits
    checks: FleetChecks


class Agent:
    """One vehicle's decisions. Pure: what comes out depends on the calls made so far and on nothing else."""

    def __init__(
        self, setup: AgentSetup, tracker: VehicleTracker, cooperation: Cooperation, observer: DisturbanceObserver
    ) -> None:
        self._setup = setup
        self._tracker = tracker
        self._cooperation = cooperation
        self._observer = observer
        self._gate = LastGate(setup.envelope)
        self._machine = PhaseMachine(setup.takeoff_height_m)
        self._preflight = Preflight(observer.hover_thrust_norm)
        self._refused: Counter[str] = Counter()
        self._sequence = 0
        self._position_used_s = float("-inf")
        self._origin_asked_s = float("-inf")
        self._spoke_s = 0.0
        self._last_word_spoken = False  # in this silence
        self._stopping_s: float | None = None  # since when this agent is to stop
        self._commanded_enu_m_s2 = ZERO3  # by the last setpoint, less what it did against the disturbance
        self._sent_thrust_norm = 0.0
        self._status_s = float("-inf")
        self._yaw_rad = 0.0
        self._hold_altitude_m = 0.0
        self._last_event = ""
        self._warnings: list[str] = []

    @property
    def phase(self) -> FlightPhase:
        return self._machine.phase

    @property
    def has_handed_over(self) -> bool:
        """No setpoint stream is left that the autopilot would miss."""
        return self.phase is not FlightPhase.RELEASE and not self._machine.streams(self._tracker.state)

    def reject(self, reason: str) -> None:
        """Count a message that was refused before it came here."""
        self._refused[reason] += 1

    def step(self, now_s: float, inbox: Inbox) -> Outbox:
        """One tick: telemetry -> state -> peers -> PrC and weights -> acceleration -> attitude -> the last gate."""
        if self.phase not in COOPERATING:
            self._tracker.take_as_told()
        vehicle = self._tracker.fold(inbox.telemetry)
        self._machine.follow_truth(vehicle)
        self._preflight.hear(now_s, inbox.telemetry, vehicle.autopilot)
        commands = [command for command in inbox.commands if command.lead is None]
        # A new role comes before all that it decides: one tick, its packet included, is of one role.
        replies = tuple([self._change_lead(c, c.lead, vehicle) for c in inbox.commands if c.lead is not None])
        if not vehicle.armed:
            self._cooperation.landed()
        around = self._cooperation.update(now_s, vehicle.position_enu_m, inbox.peers, self._machine.in_formation)
        flags = health_flags(now_s, vehicle, around.leader_word, self._setup.ages, self._setup.envelope)
        self._observe_disturbance(now_s, vehicle, flags, inbox.telemetry)

        streamed = self._machine.streams(vehicle)
        replies += tuple([self._obey(command, now_s, vehicle, flags) for command in commands])
        if self._machine.streams(vehicle) and not streamed:
            self._open_stream(now_s, vehicle)
        if inbox.stopping:
            self._stop(now_s, vehicle)
        self._act_on(flags, now_s, vehicle)
        requests = self._ask_origin(now_s, vehicle) + self._machine.advance(now_s, vehicle, inbox.telemetry)
        if not self._machine.streams(vehicle):  # what was found before goes for the whole formation
            requests += self._preflight.ask(now_s)

        target = None
        if self._machine.streams(vehicle) and self._may_decide(flags, vehicle):
            self._position_used_s = vehicle.position_time_s
            acceleration = self._acceleration(vehicle, around)
            target = self._target(now_s, vehicle, acceleration)
            if target is not None:
                self._spoke_s, self._commanded_enu_m_s2 = now_s, acceleration
                self._last_word_spoken = False
                self._sent_thrust_norm = target.thrust_norm
        elif streamed and self._falls_silent(flags, vehicle):
            target = self._last_word(now_s, vehicle)

        events = self._drain_events()
        return Outbox(
            attitude_target=target,
            requests=requests,
            peer_packet=None if flags & NOT_TO_BE_HEEDED else self._peer_packet(now_s, vehicle, around),
            status=self._status(now_s, vehicle, around, flags) if self._status_due(now_s, events) else None,
            replies=replies,
            events=events,
        )

    def _observe_disturbance(
        self, now_s: float, vehicle: VehicleState, flags: frozenset[HealthFlag], telemetry: tuple[Telemetry, ...]
    ) -> None:
        """Only flight under a thrust that is known tells of hover thrust and wind."""
        for sample in telemetry:
            if isinstance(sample, ParameterSample) and sample.name in HOVER_PARAMETERS:
                self._observer.start_from(sample.value)
        if not vehicle.armed:
            self._observer.landed()
        thrust_norm = self._flown_thrust_norm(now_s, vehicle)
        if thrust_norm is None or not self._flies_freely(vehicle) or failsafe_action(flags) is FailsafeAction.SILENT:
            self._observer.pause()
            return
        attitude_rad = (vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        self._observer.update(Motion(vehicle.position_time_s, vehicle.velocity_enu_m_s, attitude_rad, thrust_norm))

    def _flies_freely(self, vehicle: VehicleState) -> bool:
        """Off the ground, and flown by the agent or as the agent asked for."""
        if vehicle.landed not in (LandedState.IN_AIR, LandedState.TAKEOFF):
            return False
        if self.phase is FlightPhase.TAKEOFF:  # it may not have left the ground yet, whatever is said of it
            return vehicle.velocity_enu_m_s[2] > CLIMBS_M_S
        return self.phase in (FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE)

    def _flown_thrust_norm(self, now_s: float, vehicle: VehicleState) -> float | None:
        """The thrust that is in force: the own, while the autopilot takes it; None where it is not known."""
        own = self._machine.streams(vehicle) and vehicle.mode is AutopilotMode.OFFBOARD
        time_s = self._spoke_s if own else vehicle.thrust_time_s
        if now_s - time_s > THRUST_FRESH_S:
            return None
        return self._sent_thrust_norm if own else vehicle.thrust_norm

    def _change_lead(self, command: Command, lead: Lead, vehicle: VehicleState) -> CommandReply:
        refusal = self._machine.refusal_of_lead(vehicle)
        accepted, reason = (False, refusal) if refusal else self._cooperation.leadership.obey(lead)
        return CommandReply(self._setup.vehicle_id, command.number, accepted, reason)

    def _obey(
        self, command: Command, now_s: float, vehicle: VehicleState, flags: frozenset[HealthFlag]
    ) -> CommandReply:
        missing = self._missing_for(command.name, flags)
        if missing:
            return CommandReply(self._setup.vehicle_id, command.number, False, f"{command.name}: {', '.join(missing)}")
        refusal, warning = self._judge(command.name, now_s, vehicle)
        if refusal:
            return CommandReply(self._setup.vehicle_id, command.number, False, f"{command.name}: {refusal}")
        accepted, reason = self._machine.command(command.name, now_s, vehicle)
        if accepted and warning:
            self._warnings.append(warning)
            reason += f"; {warning}"
        return CommandReply(self._setup.vehicle_id, command.number, accepted, reason)

    def _missing_for(self, name: CommandName, flags: frozenset[HealthFlag]) -> list[str]:
        """Landing, holding and disarming need nothing; the rest needs a vehicle that knows where and how it is."""
        if name in (CommandName.LAND, CommandName.HOLD, CommandName.DISARM):
            return []
        unneeded = set() if name is CommandName.FORM else {HealthFlag.LEADER_LOST}
        return sorted(flags - unneeded)

    def _judge(self, name: CommandName, now_s: float, vehicle: VehicleState) -> tuple[str, str]:
        """Why a command is refused that is otherwise possible, and what is to be said of it where it is not."""
        if self.phase not in RULES[name].allowed:
            return "", ""
        if name is CommandName.FORM and (refusal := self._preflight.refusal()):
            return refusal, ""
        peers = [peer.packet for peer in self._cooperation.peers.fresh(now_s).values()]
        return self._setup.checks.judge(name, vehicle, peers)

    def _act_on(self, flags: frozenset[HealthFlag], now_s: float, vehicle: VehicleState) -> None:
        if not self._machine.streams(vehicle):
            return
        if now_s - self._spoke_s > SILENT_TOO_LONG_S:
            self._end_formation_in_silence(flags, now_s, vehicle)
        elif failsafe_action(flags) is FailsafeAction.HOLD:
            self._machine.hand_over(now_s, vehicle, _reason(flags))

    def _end_formation_in_silence(self, flags: frozenset[HealthFlag], now_s: float, vehicle: VehicleState) -> None:
        """Who would drift on by itself is asked to hold, unless a pilot may have taken over unseen."""
        if self._machine.phase in (FlightPhase.ENGAGE, FlightPhase.FORMATION):
            reason = f"silent for {SILENT_TOO_LONG_S} s: {_reason(flags)}"
            if manners_of(vehicle).flies_on_in_silence and now_s - vehicle.mode_time_s < MODE_SURE_S:
                self._machine.hand_over(now_s, vehicle, reason)
            else:
                self._machine.give_up(reason)
        self._machine.end_stream()

    def _stop(self, now_s: float, vehicle: VehicleState) -> None:
        if self._stopping_s is None:
            self._stopping_s = now_s
        self._machine.hand_over(now_s, vehicle, "this agent is to stop")
        if now_s - self._stopping_s > HAND_OVER_S and not self.has_handed_over:
            self._machine.give_up("this agent is to stop, and the autopilot does not take over")

    def _falls_silent(self, flags: frozenset[HealthFlag], vehicle: VehicleState) -> bool:
        """By its own decision, while the autopilot still listens."""
        if vehicle.mode is not AutopilotMode.OFFBOARD:
            return False
        return not self._machine.streams(vehicle) or failsafe_action(flags) is FailsafeAction.SILENT

    def _last_word(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget | None:
        """Level, once in each silence, to an autopilot that goes on with the last setpoint."""
        if self._last_word_spoken or not manners_of(vehicle).flies_on_in_silence:
            return None
        self._last_word_spoken = True
        self._commanded_enu_m_s2 = ZERO3
        hover_thrust_norm = self._observer.hover_thrust_norm
        level = AttitudeTarget(0.0, 0.0, self._yaw_rad, hover_thrust_norm)
        self._gate.open_at(now_s, level, hover_thrust_norm)  # no slew: no next setpoint will come closer
        return self._gate.admit(now_s, level, hover_thrust_norm)

    def _ask_origin(self, now_s: float, vehicle: VehicleState) -> tuple[AutopilotRequest, ...]:
        if vehicle.autopilot is None:
            return ()
        period_s = ORIGIN_REPEAT_S if vehicle.altitude_amsl_m is None else ORIGIN_REFRESH_S
        if now_s - vehicle.jump_time_s < ORIGIN_REPEAT_S:
            period_s = ORIGIN_SOON_S
        if now_s - self._origin_asked_s < period_s:
            return ()
        self._origin_asked_s = now_s
        return (RequestOrigin(),)

    def _open_stream(self, now_s: float, vehicle: VehicleState) -> None:
        self._yaw_rad = vehicle.yaw_rad
        self._spoke_s, self._commanded_enu_m_s2 = now_s, ZERO3
        current = self._as_it_flies(now_s, vehicle)
        self._sent_thrust_norm = current.thrust_norm
        self._gate.open_at(now_s, current, self._observer.hover_thrust_norm)

    def _may_decide(self, flags: frozenset[HealthFlag], vehicle: VehicleState) -> bool:
        """A decision needs a position that no decision was made from before."""
        new = vehicle.position_time_s > self._position_used_s
        return new and failsafe_action(flags) is not FailsafeAction.SILENT

    def _acceleration(self, vehicle: VehicleState, around: Neighbourhood) -> Vector3:
        """What the phase wants, within what the envelope's tilt and thrust can give."""
        match self._machine.phase:
            case FlightPhase.ENGAGE:  # the autopilot has not taken the stream yet
                self._hold_altitude_m = vehicle.position_enu_m[2]
                return ZERO3
            case FlightPhase.FORMATION:
                wanted = self._formation_acceleration(vehicle, around)
            case _:  # handing over: brake, and keep the altitude
                wanted = self._braking(vehicle)
        return self._within_reach(wanted)

    def _within_reach(self, wanted_enu_m_s2: Vector3) -> Vector3:
        """What tilt and thrust can give besides what they do against the disturbance."""
        (x, y, z), (dx, dy, dz) = wanted_enu_m_s2, self._observer.disturbance_enu_m_s2
        limits = self._setup.envelope
        x, y, z = limit_acceleration(
            (x - dx, y - dy, z - dz), limits.max_tilt_rad, limits.min_thrust_ratio, limits.max_thrust_ratio
        )
        return (x + dx, y + dy, z + dz)

    def _formation_acceleration(self, vehicle: VehicleState, around: Neighbourhood) -> Vector3:
        """Eq. 14, or on z the vehicle's own altitude hold."""
        own = place(vehicle.position_enu_m, vehicle.velocity_enu_m_s, self._setup.slot_enu_m)
        wanted = formation_acceleration(self._setup.law, own, around.neighbours, self._reference(around))
        if self._setup.law_flies_altitude:
            self._hold_altitude_m = vehicle.position_enu_m[2]  # where a hand-over begins
            return wanted
        return (wanted[0], wanted[1], self._braking(vehicle)[2])

    def _braking(self, vehicle: VehicleState) -> Vector3:
        """Against the velocity, and back to the altitude held."""
        climb_m = vehicle.position_enu_m[2] - self._hold_altitude_m
        return feedback(self._setup.altitude_hold_gains, (0.0, 0.0, climb_m), vehicle.velocity_enu_m_s)

    def _target(self, now_s: float, vehicle: VehicleState, acceleration: Vector3) -> AttitudeTarget | None:
        """What passes the last gate; None where nothing does, and the count of it is in the status."""
        try:
            wanted = self._attitude(now_s, vehicle, acceleration)
        except ValueError as error:
            self.reject(f"own command: {error}")
            return None
        admitted = self._gate.admit(now_s, wanted, self._observer.hover_thrust_norm)
        if admitted is None:
            self.reject("own command: not finite")
        return admitted

    def _attitude(self, now_s: float, vehicle: VehicleState, acceleration: Vector3) -> AttitudeTarget:
        """Against the disturbance, too. Raises ValueError where no attitude gives this acceleration (Remark 1)."""
        if self._machine.phase is FlightPhase.ENGAGE:
            return self._as_it_flies(now_s, vehicle)
        (x, y, z), (dx, dy, dz) = acceleration, self._observer.disturbance_enu_m_s2
        thrust_acceleration = (x - dx, y - dy, z - dz)
        hover_thrust_norm = self._observer.hover_thrust_norm
        return attitude_target(
            thrust_acceleration, self._yaw_rad, vehicle.roll_rad, vehicle.pitch_rad, hover_thrust_norm
        )

    def _as_it_flies(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget:
        """The attitude that the vehicle has, with the thrust that carries it: no step where the autopilot takes over."""
        if now_s - vehicle.thrust_time_s <= THRUST_FRESH_S:
            thrust = vehicle.thrust_norm
        else:
            share = max(0.5, cos(vehicle.roll_rad) * cos(vehicle.pitch_rad))
            thrust = self._observer.hover_thrust_norm / share
        return AttitudeTarget(vehicle.roll_rad, vehicle.pitch_rad, self._yaw_rad, thrust)

    def _reference(self, around: Neighbourhood) -> Place | None:
        """R for a leader alone, whoever else holds the RFT."""
        if self._setup.reference is None or around.role is not Role.LEADER:
            return None
        return self._setup.reference(around.reference_s)

    def _drain_events(self) -> tuple[str, ...]:
        leadership = self._cooperation.leadership
        sources = (
            self._preflight.events,
            self._tracker.events,
            leadership.events,
            self._machine.events,
            self._warnings,
        )
        events = tuple(event for source in sources for event in source)
        for source in sources:
            source.clear()
        if events:
            self._last_event = events[-1]
        return events

    def _flown_acceleration(self, now_s: float, vehicle: VehicleState) -> Vector3:
        """What the autopilot is believed to fly: the last setpoint goes on also over a tick that decides nothing."""
        if not self._machine.streams(vehicle) or now_s - self._spoke_s > self._setup.ages.state_s:
            return ZERO3
        return self._commanded_enu_m_s2

    def _peer_packet(self, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> PeerPacket | None:
        """Nothing is told before there is a position."""
        if vehicle.position_time_s == float("-inf"):
            return None
        self._sequence += 1
        return PeerPacket(
            vehicle_id=self._setup.vehicle_id,
            session=self._setup.session,
            sequence=self._sequence,
            formation_hash=self._setup.formation_hash,
            phase=self._machine.phase,
            role=around.role,
            position_enu_m=vehicle.position_enu_m,
            velocity_enu_m_s=vehicle.velocity_enu_m_s,
            acceleration_enu_m_s2=self._flown_acceleration(now_s, vehicle),
            state_age_s=max(0.0, now_s - vehicle.position_time_s),
            sent_s=now_s,
            prc=around.prc,
            leader_word=around.leader_word,
            position_error=vehicle.position_error,
        )

    def _status_due(self, now_s: float, events: tuple[str, ...]) -> bool:
        """Ten times a second, and at once when something happened."""
        if not events and now_s - self._status_s < STATUS_PERIOD_S:
            return False
        self._status_s = now_s
        return True

    def _status(
        self, now_s: float, vehicle: VehicleState, around: Neighbourhood, flags: frozenset[HealthFlag]
    ) -> Status:
        reference = self._reference(around)
        return Status(
            vehicle_id=self._setup.vehicle_id,
            session=self._setup.session,
            fleet=self._setup.fleet,
            formation_hash=self._setup.formation_hash,
            law=self._setup.law_name,
            phase=self._machine.phase,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            landed=vehicle.landed,
            position_enu_m=vehicle.position_enu_m,
            velocity_enu_m_s=vehicle.velocity_enu_m_s,
            state_age_s=min(1e6, now_s - vehicle.position_time_s),
            hover_thrust_norm=self._observer.hover_thrust_norm,
            disturbance_enu_m_s2=self._observer.disturbance_enu_m_s2,
            role=around.role,
            epoch=around.epoch,
            prc=around.prc,
            leader_word=around.leader_word,
            leader_word_age_s=around.leader_word_age_s if around.leader_word else None,
            neighbours=around.neighbour_ids,
            slot_enu_m=self._setup.slot_enu_m,
            reference_enu_m=reference.position_enu_m if reference else None,
            flags=tuple(sorted(flags)),
            rejected=dict(self._refused + self._tracker.rejected + self._cooperation.peers.rejected),
            last_event=self._last_event,
            lacks=() if vehicle.armed else self._preflight.lacks(),
        )


def _reason(flags: frozenset[HealthFlag]) -> str:
    return ", ".join(sorted(flags)) or "nothing to decide on"
