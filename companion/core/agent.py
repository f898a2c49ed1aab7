"""Agent.step: one tick from all that came in to all that goes out. The whole flow, top to bottom."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import inf

from msgspec.structs import replace

from companion.core.battery import BatteryWatch
from companion.core.closing_up import ClosingUp
from companion.core.command_desk import CommandDesk, Order
from companion.core.control import FormationControl
from companion.core.cooperation import COOPERATING, Cooperation, Neighbourhood
from companion.core.envelope import EnvelopeLimits
from companion.core.failsafe import failsafe_action
from companion.core.fleet_checks import FleetChecks
from companion.core.flight_manners import manners_of
from companion.core.formation import place
from companion.core.heading import FormationHeading
from companion.core.health import AgeLimits, health_flags
from companion.core.homeward import refusal_of_return
from companion.core.joining import Joining, Way
from companion.core.passed_on import first_leader, passed_on
from companion.core.phase import RULES, STREAMING, PhaseMachine
from companion.core.preflight import Preflight
from companion.core.setpoint_stream import SetpointStream
from companion.core.slot_plan import SlotPlan
from companion.core.succession import HeldForWantOfALeader
from companion.core.vehicle_state import VehicleTracker
from companion.geometry.turning import turned_slot
from companion.types import (
    WITHOUT_LEADER,
    ZERO3,
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    CommandName,
    CommandReply,
    FailsafeAction,
    FlightPhase,
    FormationChange,
    HealthFlag,
    Inbox,
    LandedState,
    Lead,
    Outbox,
    PeerPacket,
    ReferenceChange,
    RequestOrigin,
    Role,
    Status,
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
PLACE_IN_DOUBT = NOT_TO_BE_HEEDED | {HealthFlag.STATE_STALE, HealthFlag.FRAME_UNKNOWN}
CLIMBS_M_S = 0.3  # faster than that it does not stand on the ground any more
STATUS_PERIOD_S = 0.099  # every fifth tick of 50 Hz, also where a tick comes a little early


@dataclass(frozen=True, slots=True)
class AgentSetup:
    """What does not change in flight."""

    vehicle_id: int
    session: int
    fleet: str
    formation_hash: int
    law_name: str
    takeoff_height_m: float
    envelope: EnvelopeLimits
    ages: AgeLimits
    checks: FleetChecks


class Agent:
    """One vehicle's decisions. Pure: what comes out depends on the calls made so far and on nothing else."""

    def __init__(
        self,
        setup: AgentSetup,
        tracker: VehicleTracker,
        cooperation: Cooperation,
        control: FormationControl,
        setpoints: SetpointStream,
        slots: SlotPlan,
        heading: FormationHeading,
        held: HeldForWantOfALeader,
        joining: Joining,
        battery: BatteryWatch,
        closing_up: ClosingUp | None,
    ) -> None:
        self._setup = setup
        self._tracker = tracker
        self._cooperation = cooperation
        self._control = control
        self._setpoints = setpoints
        self._slots = slots
        self._heading = heading
        self._slot = slots.flown  # as it is flown, turned to the heading
        self._references = control.references
        self._held = held
        self._joining = joining
        self._battery = battery
        self._closing_up = closing_up  # None: whoever leaves, its gap is kept
        self._joins = False  # others were in formation already when this vehicle was told to form
        self._observer = setpoints.observer
        self._machine = PhaseMachine(setup.takeoff_height_m)
        self._preflight = Preflight(self._observer)
        self._desk = CommandDesk(setup.session)
        self._refused: Counter[str] = Counter()
        self._sequence = 0
        self._origin_asked_s = -inf
        self._stopping_s: float | None = None  # since when this agent is to stop
        self._fit_to_lead = False  # as of the last tick
        self._missed_leader = False  # likewise
        self._not_taken: int | None = None  # the formation passed on that was refused last, and told of
        self._status_s = -inf
        self._last_event = ""
        self._warnings: list[str] = []
        self._events_of = (
            self._desk.events,
            self._preflight.events,
            self._tracker.events,
            self._cooperation.leadership.events,
            self._machine.events,
            self._slots.events,
            self._references.events if self._references else [],
            self._closing_up.events if self._closing_up else [],
            self._warnings,
        )

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
        self._battery.hear(inbox.telemetry)
        orders = [self._desk.take_in(command) for command in inbox.commands]
        # A new role comes before all that it decides: one tick, its packet included, is of one role.
        for order in orders:
            if order.answer is None and isinstance(order.command.content, Lead):
                order.answer = self._change_lead(now_s, order.command.content, vehicle)
        if not vehicle.armed:
            self._cooperation.landed()
            self._slots.begin_anew()
            self._heading.begin_anew()
        around = self._cooperation.update(
            now_s, vehicle.position_enu_m, inbox.peers, self._machine.in_formation, self._fit_to_lead
        )
        for order in orders:
            if order.answer is None and isinstance(order.command.content, FormationChange):
                order.answer = self._change_formation(order.command.content, vehicle, around)
            elif order.answer is None and isinstance(order.command.content, ReferenceChange):
                order.answer = self._change_reference(order.command.content, vehicle, around)
        self._hear_of_formations(vehicle, around)
        self._close_up(now_s, vehicle, around)
        self._join(now_s, vehicle, around)
        self._slots.update(around.reference_s, around.flying, self.phase in STREAMING)
        if self._references:
            self._references.update(now_s, around.reference_s, self._slots.slots_enu_m, around.flying, inbox.targets)
        self._turn_slot(now_s, around)
        flags = health_flags(now_s, vehicle, around.leaderless, self._setup.ages, self._setup.envelope)
        action = failsafe_action(flags)
        self._tell_of_missing_leader(flags)
        self._observe_disturbance(now_s, vehicle, action)

        streamed = self._machine.streams(vehicle)
        for order in orders:
            if order.answer is None:
                order.answer = self._obey(order.command.name, now_s, vehicle, flags)
        if self._machine.streams(vehicle) and not streamed:
            self._setpoints.open(now_s, vehicle)
        if inbox.stopping:
            self._stop(now_s, vehicle)
        self._act_on(flags, action, now_s, vehicle)
        if self._held.must_land(now_s, self.phase, led=around.leader_word is not None):
            self._machine.land(now_s, vehicle, "in hold for want of a leader, and none came")
        if self._battery.must_land(self.phase):
            self._machine.land(now_s, vehicle, "in hold for want of battery")
        self._fit_to_lead = (
            self.phase is FlightPhase.FORMATION
            and action is FailsafeAction.NONE
            and not (self._references and self._references.missing(now_s))
        )
        requests = self._ask_origin(now_s, vehicle) + self._machine.advance(now_s, vehicle, inbox.telemetry)
        streams = self._machine.streams(vehicle)
        if not streams:  # what was found before goes for the whole formation
            requests += self._preflight.ask(now_s)

        target = None
        if streams and action is not FailsafeAction.SILENT:
            if self._setpoints.may_follow(vehicle):
                target = self._decide(now_s, vehicle, around)
        elif streamed and self._is_listened_to_in_silence(vehicle):
            target = self._setpoints.last_word(now_s)

        events = self._drain_events()
        return Outbox(
            attitude_target=target,
            requests=requests,
            peer_packet=None if flags & NOT_TO_BE_HEEDED else self._peer_packet(now_s, vehicle, around, streams),
            status=self._status(now_s, vehicle, around, flags) if self._status_due(now_s, events) else None,
            replies=tuple([self._reply(order) for order in orders]),
            events=events,
        )

    def _turn_slot(self, now_s: float, around: Neighbourhood) -> None:
        led_by = self._control.reference(around) if self._machine.in_formation else None
        if around.heading is not None and not self._machine.streams(self._tracker.state):
            self._heading.begin_anew()  # nobody flies by it here: it need not turn to what is heard as vehicles must
        self._heading.update(now_s, around, led_by, self._slots.reach_m)
        self._slot = turned_slot(self._slots.flown, self._heading.flown)

    def _decide(self, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> AttitudeTarget | None:
        """What this phase wants, as a setpoint; None where nothing passes the last gate."""
        match self._machine.phase:
            case FlightPhase.ENGAGE:  # the autopilot has not taken the stream yet
                self._control.stand_by(vehicle)
                return self._setpoints.carry_on(now_s, vehicle)
            case FlightPhase.FORMATION:
                wanted_enu_m_s2 = self._control.in_formation(vehicle, around, self._slot)
            case _ if self._machine.hands_over_level(now_s):
                wanted_enu_m_s2 = self._control.level(vehicle)
            case _:  # nobody takes over
                wanted_enu_m_s2 = self._control.braking(vehicle)
        return self._setpoints.follow(now_s, vehicle, wanted_enu_m_s2)

    def _observe_disturbance(self, now_s: float, vehicle: VehicleState, action: FailsafeAction) -> None:
        """Only flight under a thrust that is known tells of hover thrust and wind."""
        if not vehicle.armed:
            self._observer.landed()
        if action is FailsafeAction.SILENT or not self._flies_freely(vehicle):
            self._observer.pause()
        elif vehicle.mode is AutopilotMode.OFFBOARD and self._machine.streams(vehicle):
            self._setpoints.observe_own(now_s, vehicle)
        else:
            self._setpoints.observe_told(now_s, vehicle)

    def _flies_freely(self, vehicle: VehicleState) -> bool:
        """Off the ground, and flown by the agent or as the agent asked for."""
        if vehicle.landed not in (LandedState.IN_AIR, LandedState.TAKEOFF):
            return False
        if self.phase is FlightPhase.TAKEOFF:  # it may not have left the ground yet, whatever is said of it
            return vehicle.velocity_enu_m_s[2] > CLIMBS_M_S
        return self.phase in COOPERATING

    def _reply(self, order: Order) -> CommandReply:
        assert order.answer is not None  # whatever the desk lets through was obeyed or refused in this tick
        return CommandReply(self._setup.vehicle_id, order.command.number, *order.answer)

    def _change_lead(self, now_s: float, lead: Lead, vehicle: VehicleState) -> tuple[bool, str]:
        refusal = self._machine.refusal_of_lead(vehicle)
        if not refusal and self._references and self._setup.vehicle_id in lead.leaders:
            missing = self._references.missing(now_s)
            refusal = f"lead: {missing}" if missing else ""
        return (False, refusal) if refusal else self._cooperation.leadership.obey(lead)

    def _change_formation(
        self, change: FormationChange, vehicle: VehicleState, around: Neighbourhood
    ) -> tuple[bool, str]:
        rft_enu_m = self._rft_enu_m(vehicle, around)
        if self._machine.stands(vehicle):
            return self._slots.obey_on_ground(change, around.flying, rft_enu_m)
        in_formation = [other for other in around.flying if other.phase is FlightPhase.FORMATION]
        alone = self._machine.phase is not FlightPhase.FORMATION
        return self._slots.obey(change, around.reference_s, in_formation if alone else (), rft_enu_m)

    def _hear_of_formations(self, vehicle: VehicleState, around: Neighbourhood) -> None:
        """What leaders pass on is taken like a command; of two that have different ones, the smallest id's."""
        first_id = self._first_leader(around)
        term, stands = self._cooperation.leadership.term, self._machine.stands(vehicle)
        for vehicle_id, change in passed_on(around.flying, term, stands):
            if not self._slots.lacks(change, over_own=vehicle_id == first_id):
                continue
            accepted, reason = self._change_formation(change, vehicle, around)
            if accepted or change.number != self._not_taken:
                self._warnings.append(f"passed on by vehicle {vehicle_id}: {reason}")
            self._not_taken = None if accepted else change.number

    def _first_leader(self, around: Neighbourhood) -> int | None:
        return first_leader(around.flying, self._setup.vehicle_id if self._leads_formation(around) else None)

    def _close_up(self, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> None:
        """Where one left, and the fleet file wants it: the first of those that lead proposes it, and all judge it."""
        if self._closing_up is None:
            return
        if not vehicle.armed:
            self._closing_up.landed()
        self._closing_up.hear(now_s, around.flying)
        references, leads = self._references, self._first_leader(around) == self._setup.vehicle_id
        if references is None or not leads or not self._slots.is_settled(around.reference_s):
            return
        proposed = self._closing_up.proposal(
            now_s,
            self._slots.slots_enu_m,
            self._slots.flown.waiting,
            self._cooperation.peers.newest,
            around.reference_s,
            lambda reference_s: references.at(reference_s).position_enu_m,
        )
        if proposed is None:
            return
        gone_id, change = proposed
        accepted, reason = self._change_formation(change, vehicle, around)
        if accepted:
            self._warnings.append(f"closes up where vehicle {gone_id} left: {reason}")
        else:
            self._closing_up.keep_gap(gone_id, reason)

    def _leads_formation(self, around: Neighbourhood) -> bool:
        return around.role is Role.LEADER and self._machine.phase is FlightPhase.FORMATION

    def _join(self, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> None:
        """Until the autopilot takes the stream, from wherever this vehicle is."""
        self._joining.hear(now_s, around.flying)
        if self.phase not in STREAMING:
            self._joins = False
            self._slots.end_coming()
        elif self._joins and self.phase is FlightPhase.ENGAGE:
            try:
                self._slots.come(self._way_in(now_s, vehicle), around.reference_s)
            except ValueError as error:
                self._machine.hand_over(now_s, vehicle, f"does not join: {error}")

    def _way_in(self, now_s: float, vehicle: VehicleState) -> Way:
        """Raises ValueError where there is none."""
        fresh = self._cooperation.peers.fresh(now_s).values()
        flying = [peer for peer in fresh if peer.packet.phase in COOPERATING]
        slot_enu_m = self._slots.slots_enu_m[self._setup.vehicle_id]
        heading = self._heading.flown
        return self._joining.way(now_s, vehicle.position_enu_m, vehicle.velocity_enu_m_s, slot_enu_m, heading, flying)

    def _refusal_to_join(self, now_s: float, vehicle: VehicleState) -> str:
        try:
            self._way_in(now_s, vehicle)
        except ValueError as error:
            return str(error)
        return ""

    def _rft_enu_m(self, vehicle: VehicleState, around: Neighbourhood) -> list[Vector3]:
        """Places of the RFT, as far as they are known here: who may lead knows it, who flies in formation where it is now."""
        if self._references:
            return self._references.places_enu_m(around.reference_s)
        return [self._here_enu_m(vehicle)] if self._machine.phase is FlightPhase.FORMATION else []

    def _here_enu_m(self, vehicle: VehicleState) -> Vector3:
        """Where this vehicle has the fleet, by its own place."""
        return place(vehicle.position_enu_m, vehicle.velocity_enu_m_s, self._slot).position_enu_m

    def _change_reference(
        self, change: ReferenceChange, vehicle: VehicleState, around: Neighbourhood
    ) -> tuple[bool, str]:
        if self._references is None:
            return False, "reference: this vehicle may not lead, and knows of none"
        here_enu_m = self._here_enu_m(vehicle)
        return self._references.obey(change, around.reference_s, self._slots.slots_enu_m, around.flying, here_enu_m)

    def _obey(
        self, name: CommandName, now_s: float, vehicle: VehicleState, flags: frozenset[HealthFlag]
    ) -> tuple[bool, str]:
        if name is CommandName.ABORT:
            self._end_own_ways()
            return self._machine.abort(now_s, vehicle)
        if missing := self._missing_for(name, flags):
            return False, f"{name}: {', '.join(missing)}"
        refusal, warning = self._judge(name, now_s, vehicle)
        if refusal:
            return False, f"{name}: {refusal}"
        accepted, reason = self._machine.command(name, now_s, vehicle)
        if accepted:
            self._end_own_ways()
        if accepted and warning:
            self._warnings.append(warning)
            reason += f"; {warning}"
        return accepted, reason

    def _end_own_ways(self) -> None:
        """Whatever the vehicle was about to do by itself, it was told something."""
        self._held.end()
        self._battery.end()

    def _missing_for(self, name: CommandName, flags: frozenset[HealthFlag]) -> list[str]:
        """Landing, holding and disarming need nothing; the rest needs a vehicle that knows where and how it is.

        Of a return the agent need only know where it begins.
        """
        if name in (CommandName.LAND, CommandName.HOLD, CommandName.DISARM):
            return []
        if name is CommandName.RETURN:
            return sorted(flags & PLACE_IN_DOUBT)
        unneeded = set() if name is CommandName.FORM else WITHOUT_LEADER
        return sorted(flags - unneeded)

    def _tell_of_missing_leader(self, flags: frozenset[HealthFlag]) -> None:
        """At once, for the log and the ground: what follows is due in fractions of a second."""
        misses = HealthFlag.LEADER_AWAITED in flags and self.phase is FlightPhase.FORMATION
        if misses and not self._missed_leader:
            self._warnings.append("no leader's word: formation is held without")
        self._missed_leader = misses

    def _judge(self, name: CommandName, now_s: float, vehicle: VehicleState) -> tuple[str, str]:
        """Why a command is refused that is otherwise possible, and what is to be said of it where it is not."""
        if self.phase not in RULES[name].allowed:
            return "", ""
        if name is CommandName.FORM and (refusal := self._refusal_to_form(now_s)):
            return refusal, ""
        if name is CommandName.RETURN:
            stood_enu_m = self._cooperation.peers.stood_enu_m
            own_id, separation_m = self._setup.vehicle_id, self._setup.checks.separation_m
            return refusal_of_return(own_id, separation_m, vehicle, self._heard(now_s), stood_enu_m), ""
        role = self._cooperation.leadership.role
        refusal, warning = self._setup.checks.judge(name, vehicle, self._slot, self._heard(now_s), role)
        if name is CommandName.FORM and not refusal:
            self._joins = self._joining.is_due(now_s)
            refusal = self._refusal_to_join(now_s, vehicle) if self._joins else ""
        return refusal, warning

    def _refusal_to_form(self, now_s: float) -> str:
        """For what this vehicle is or has itself; one that leads beside others must lead where they do."""
        refusal = self._preflight.refusal() or self._battery.too_low
        if not refusal and self._references and self._cooperation.leadership.role is Role.LEADER:
            refusal = self._references.missing(now_s)
        return refusal

    def _heard(self, now_s: float) -> list[PeerPacket]:
        """All others that are heard of just now."""
        return [peer.packet for peer in self._cooperation.peers.fresh(now_s).values()]

    def _act_on(
        self, flags: frozenset[HealthFlag], action: FailsafeAction, now_s: float, vehicle: VehicleState
    ) -> None:
        if not self._machine.streams(vehicle):
            return
        if self._setpoints.silent_s(now_s) > SILENT_TOO_LONG_S:
            self._end_formation_in_silence(flags, now_s, vehicle)
        elif action is FailsafeAction.HOLD:
            if HealthFlag.LEADER_LOST in flags and self.phase in STREAMING:
                self._held.begin(now_s)
            self._machine.hand_over(now_s, vehicle, _reason(flags))
        elif self.phase in STREAMING and (too_low := self._battery.too_low):
            self._machine.hand_over(now_s, vehicle, too_low)
            self._battery.begin()

    def _end_formation_in_silence(self, flags: frozenset[HealthFlag], now_s: float, vehicle: VehicleState) -> None:
        """Who would drift on by itself is asked to hold, unless a pilot may have taken over unseen."""
        if self._machine.phase in (FlightPhase.ENGAGE, FlightPhase.FORMATION):
            reason = f"silent for {SILENT_TOO_LONG_S} s: {_reason(flags)}"
            if manners_of(vehicle).flies_on_in_silence and now_s - vehicle.mode_time_s < MODE_SURE_S:
                self._machine.hand_over_silently(now_s, vehicle, reason)
            else:
                self._machine.give_up(reason)
        self._machine.end_stream()

    def _stop(self, now_s: float, vehicle: VehicleState) -> None:
        if self._stopping_s is None:
            self._stopping_s = now_s
        self._machine.hand_over(now_s, vehicle, "this agent is to stop")
        if now_s - self._stopping_s > HAND_OVER_S and not self.has_handed_over:
            self._machine.give_up("this agent is to stop, and the autopilot does not take over")

    def _is_listened_to_in_silence(self, vehicle: VehicleState) -> bool:
        """By an autopilot that still takes setpoints, and would go on with the last one."""
        return vehicle.mode is AutopilotMode.OFFBOARD and manners_of(vehicle).flies_on_in_silence

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

    def _drain_events(self) -> tuple[str, ...]:
        events: tuple[str, ...] = ()
        for source in self._events_of:
            if source:
                events += tuple(source)
                source.clear()
        if events:
            self._last_event = events[-1]
        return events

    def _peer_packet(
        self, now_s: float, vehicle: VehicleState, around: Neighbourhood, streams: bool
    ) -> PeerPacket | None:
        """Nothing is told before there is a position."""
        if vehicle.position_time_s == -inf:
            return None
        self._sequence += 1
        word = around.leader_word
        flown = self._setpoints.flown_acceleration_enu_m_s2(now_s, self._setup.ages.state_s) if streams else ZERO3
        return PeerPacket(
            vehicle_id=self._setup.vehicle_id,
            session=self._setup.session,
            sequence=self._sequence,
            formation_hash=self._setup.formation_hash,
            phase=self._machine.phase,
            role=around.role,
            position_enu_m=vehicle.position_enu_m,
            velocity_enu_m_s=vehicle.velocity_enu_m_s,
            acceleration_enu_m_s2=flown,
            state_age_s=max(0.0, now_s - vehicle.position_time_s),
            sent_s=now_s,
            prc=around.prc,
            leader_word=word and replace(word, heading=self._heading.told),
            slot=self._slot,
            position_error=vehicle.position_error,
            reference=self._references.held if self._references else None,
            change=self._slots.to_pass_on(self._heard(now_s)) if self._leads_formation(around) else None,
            armed=vehicle.armed,
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
        reference, peers = self._control.reference(around), self._heard(now_s)
        lacks = () if vehicle.armed else self._preflight.lacks() + self._setup.checks.lacks(vehicle, peers)
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
            slot=self._slots.flown,
            reference_enu_m=reference.position_enu_m if reference else None,
            flags=tuple(sorted(flags)),
            rejected=dict(
                self._refused
                + self._setpoints.rejected
                + self._tracker.rejected
                + self._cooperation.peers.rejected
                + Counter(self._references.rejected if self._references else ())
            ),
            last_event=self._last_event,
            reference_s=around.reference_s,
            reference=self._references.held if self._references else None,
            target_age_s=self._references.target_age_s if self._references else None,
            lacks=lacks,
            holder=self._desk.holder,
            command_number=self._desk.number,
            peers=tuple(sorted(peer.vehicle_id for peer in peers)),
            battery_percent=self._preflight.battery_percent,
            position_error=vehicle.position_error,
            heading=self._heading.flown,
            largest_step_deg=self._setpoints.largest_step_deg,
        )


def _reason(flags: frozenset[HealthFlag]) -> str:
    return ", ".join(sorted(flags)) or "nothing to decide on"
