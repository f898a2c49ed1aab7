"""Failsafes without a command: leave formation when something is wrong, end the stream, land or return out of hold.

Here is also what is sent after a stage of the tick has failed.
"""

from __future__ import annotations

from collections.abc import Iterable, Set
from math import inf, isfinite

from msgspec import Struct
from msgspec.structs import replace

from companion.core.autopilot import Profiles, profile_of
from companion.core.consensus.stage import Consensus
from companion.core.safety.failsafe import (
    BY_CONDITION,
    MOTION_IN_DOUBT,
    NONE_ACTIVE,
    WARN_PERIOD_S,
    ActiveFailsafe,
    FailsafeSettings,
    FailsafeWatch,
    HealthLimits,
    doubted,
    flags_notice,
    fleet_flags,
    health_flags,
    leaves_after_s,
    limit_of,
    named_notice,
)
from companion.core.safety.fleet_checks import FleetChecks
from companion.types.autopilot import (
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    ModeSample,
    SetMode,
    Telemetry,
    VehicleState,
)
from companion.types.flight import STREAMING, FailsafeAction, Flight, FlightPhase, HealthFlag, PhaseChange, PhaseRequest
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.status import SeparationReport
from companion.types.tick import Inbox
from companion.types.values import ZERO3

HAND_OVER_S = leaves_after_s(Code.AGENT_STOPPING)  # so long the autopilot may take to go into its own hold at the end
SILENT_TOO_LONG_S = limit_of(Code.NO_SETPOINT)
SLOW_LAW_S, SLOW_FOR_S = limit_of(Code.LAW_SLOW), BY_CONDITION[Code.LAW_SLOW].stays_s
LATE_TICK_S, LATE_FOR_S = limit_of(Code.TICK_LATE), BY_CONDITION[Code.TICK_LATE].stays_s
MODE_SURE_S = 0.2  # so old may the mode be where the agent, without other telemetry, still requests another

STOPPING = Notice(Code.AGENT_STOPPING, "this agent is stopping")
AUTOPILOT_GONE_S = 1.5  # a link that fails for a moment is no autopilot that has ended
AUTOPILOT_GONE = Notice(Code.HAND_OVER_FAILED, "this agent is stopping, and its autopilot sends nothing any more")
NOT_TAKEN_OVER = Notice(Code.HAND_OVER_FAILED, "this agent is stopping, and the autopilot does not take over")


class Safety(Struct, frozen=True, gc=False):
    """The health flags of this tick, the failsafe action, and the phase changes that it requires."""

    flags: frozenset[HealthFlag] = frozenset()
    action: FailsafeAction = FailsafeAction.NONE
    requests: tuple[PhaseRequest, ...] = ()
    events: tuple[Notice, ...] = ()


SAFE = Safety()


class SafeguardStage:
    """Judges the health of vehicle, fleet and agent, and requests the phase changes of the failsafe matrix."""

    def __init__(
        self, checks: FleetChecks, limits: HealthLimits, settings: FailsafeSettings, profiles: Profiles
    ) -> None:
        self._checks = checks
        self._limits = limits
        self._profiles = profiles
        self._watch = FailsafeWatch(settings)
        self._stopping_s: float | None = None  # since when this agent is to stop
        self._late_s = -inf  # when a tick was last late
        self._slow_s = -inf  # when the law last took too long
        self._doubted_s: dict[int, float] = {}  # when each peer was last in doubt
        # When the flight ended with the mode unknown, or telemetry was last late after that.
        self._gave_up_s: float | None = None

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        separation: SeparationReport,
        last_setpoint_s: float,
        commanded: bool,
        inbox: Inbox,
    ) -> Safety:
        """`separation` is of the last setpoint. `commanded`: the last tick executed a command. It ends automatic landings."""
        if inbox.late_s > LATE_TICK_S:
            self._late_s = now_s
        if inbox.law_s > SLOW_LAW_S:
            self._slow_s = now_s
        flags = health_flags(now_s, vehicle, self._limits)
        flags |= fleet_flags(now_s, flight.phase, consensus, separation)
        if now_s - self._late_s < LATE_FOR_S:
            flags.add(HealthFlag.TICK_LATE)
        if now_s - self._slow_s < SLOW_FOR_S:
            flags.add(HealthFlag.LAW_SLOW)
        active = NONE_ACTIVE
        if flags or not self._watch.is_idle:
            active = self._watch.update(now_s, flight.phase, flags, commanded)
        requests: list[PhaseRequest] = []
        if inbox.stopping:
            requests += self._stop(now_s, vehicle, flight)
        if flight.streams and now_s - last_setpoint_s > SILENT_TOO_LONG_S:
            requests += self._end_silent_formation(now_s, vehicle, flight, active)
        elif active.action in PHASE_CHANGES:
            requests += self._carry_out(vehicle, flight, consensus, active)
        if self._gave_up_s is not None:
            requests += self._hold_after_all(now_s, vehicle, flight, flags)
        if not flags and not requests and active is NONE_ACTIVE:
            return SAFE
        events = [named_notice(flag, vehicle, consensus, separation) for flag in active.warnings]
        if HealthFlag.PEER_IN_DOUBT in flags and flight.phase in STREAMING:
            events += self._name_others(now_s, consensus, HealthFlag.PEER_IN_DOUBT in active.warnings)
        return Safety(frozenset(flags), active.action, tuple(requests), tuple(events))

    def _name_others(self, now_s: float, consensus: Consensus, named: bool) -> list[Notice]:
        """A second one has a name, too, although the flag was raised already. `named`: all of now have been."""
        new = [i for i in doubted(consensus) if now_s - self._doubted_s.get(i, -inf) > WARN_PERIOD_S]
        self._doubted_s |= dict.fromkeys(doubted(consensus), now_s)
        if named or not new:
            return []
        notice = flags_notice([HealthFlag.PEER_IN_DOUBT])
        return [Notice(notice.code, f"{notice.text}: {', '.join(map(str, new))}")]

    def _stop(self, now_s: float, vehicle: VehicleState, flight: Flight) -> list[PhaseRequest]:
        """Hand over, and give up where the autopilot does not take over in time, or sends nothing any more."""
        if self._stopping_s is None:
            self._stopping_s = now_s
        heard_s = max(vehicle.attitude_time_s, vehicle.mode_time_s, vehicle.heartbeat_time_s)
        if now_s - max(heard_s, self._stopping_s) > AUTOPILOT_GONE_S and not flight.has_handed_over:
            return [PhaseRequest(PhaseChange.ABANDON, AUTOPILOT_GONE)]
        if now_s - self._stopping_s > HAND_OVER_S and not flight.has_handed_over:
            return [PhaseRequest(PhaseChange.ABANDON, NOT_TAKEN_OVER)]
        return [PhaseRequest(PhaseChange.HAND_OVER, STOPPING)]

    def _carry_out(
        self, vehicle: VehicleState, flight: Flight, consensus: Consensus, active: ActiveFailsafe
    ) -> list[PhaseRequest]:
        """A hold from formation; from hold the return or landing."""
        if flight.streams:
            in_doubt = not MOTION_IN_DOUBT.isdisjoint(active.flags)
            change = PhaseChange.HAND_OVER_LEVEL if in_doubt else PhaseChange.HAND_OVER
            return [PhaseRequest(change, flags_notice(active.flags))]
        if flight.phase is not FlightPhase.HOLD or active.action is FailsafeAction.HOLD:
            return []
        reason = flags_notice(active.flags)
        if active.action is FailsafeAction.RETURN:
            refusal = self._checks.refusal_of_return(vehicle, consensus.peers.present.values(), consensus.lead.role)
            if refusal is None:
                return [PhaseRequest(PhaseChange.RETURN, reason)]
            reason = Notice(reason.code, f"{reason.text}; no return: {refusal.text}")
        return [PhaseRequest(PhaseChange.LAND, reason)]

    def _end_silent_formation(
        self, now_s: float, vehicle: VehicleState, flight: Flight, active: ActiveFailsafe
    ) -> list[PhaseRequest]:
        """NO_SETPOINT. An autopilot that would drift on is asked to hold, unless a pilot may have taken over unseen."""
        reason = flags_notice(active.flags) if active.flags else NOTHING_TO_DECIDE_ON
        end = PhaseRequest(PhaseChange.END_STREAM, reason)
        if flight.phase not in STREAMING or vehicle.autopilot is None:
            return [end]
        reason = reason.about(f"no setpoint for {SILENT_TOO_LONG_S} s")
        profile = profile_of(vehicle, self._profiles)
        (step,) = BY_CONDITION[Code.NO_SETPOINT].steps_of(profile)
        holds = step.action is FailsafeAction.HOLD and now_s - vehicle.mode_time_s < MODE_SURE_S
        self._gave_up_s = now_s if profile.flies_on_in_silence and not holds else None
        return [PhaseRequest(PhaseChange.HAND_OVER_NOW if holds else PhaseChange.GIVE_UP, reason), end]

    def _hold_after_all(
        self, now_s: float, vehicle: VehicleState, flight: Flight, flags: Set[HealthFlag]
    ) -> list[PhaseRequest]:
        """A hold once the mode is known again and still the one for setpoints: no pilot has taken over, and it drifts."""
        if flight.phase in STREAMING or not flags.isdisjoint(UNSEEN):
            self._gave_up_s = now_s
        elif flight.phase is not FlightPhase.OBSERVE or vehicle.mode is not AutopilotMode.OFFBOARD:
            self._gave_up_s = None
        elif self._gave_up_s is not None and vehicle.mode_time_s > self._gave_up_s:
            self._gave_up_s = None
            return [PhaseRequest(PhaseChange.HOLD, STILL_WAITS)]
        return []


UNSEEN = {HealthFlag.POSITION_STALE, HealthFlag.ATTITUDE_STALE, HealthFlag.MODE_STALE}
STILL_WAITS = Notice(Code.NO_SETPOINT, "telemetry is in time again, and the autopilot still waits for setpoints")
NOTHING_TO_DECIDE_ON = Notice(Code.NO_SETPOINT, "no new position to decide on")
PHASE_CHANGES = (FailsafeAction.HOLD, FailsafeAction.RETURN, FailsafeAction.LAND)


REPEAT_REQUEST_S = 0.1
TELEMETRY_FRESH_S = 0.1  # without telemetry a pilot's change of mode would remain unseen
HAND_OVER_WITHIN_S = leaves_after_s(Code.AGENT_FAILED)


class Response(Struct, frozen=True, gc=False):
    """What to send now. `ended`: the hand-over is complete, or the vehicle is not the agent's."""

    target: AttitudeTarget | None = None
    requests: tuple[AutopilotRequest, ...] = ()
    ended: bool = True


class FailureResponse:
    """Follows a stream of setpoints from outside, so that it can be ended when the stages cannot."""

    def __init__(self) -> None:
        self._mode: AutopilotMode | None = None
        self._telemetry_s = -inf
        self._flight = Flight()
        self._packet: PeerPacket | None = None
        self._level: AttitudeTarget | None = None
        self._failed_s: float | None = None
        self._requested_s = -inf

    def receive(self, telemetry: Iterable[Telemetry]) -> None:
        """The telemetry of a tick, before its stages."""
        for sample in telemetry:
            self._telemetry_s = sample.received_s
            if isinstance(sample, ModeSample):
                self._mode = sample.mode

    def sent(self, flight: Flight, target: AttitudeTarget | None, hover_thrust_norm: float) -> None:
        """What a tick has sent; `target` is None where there was no setpoint."""
        self._flight = flight
        if not flight.streams:
            self._level = None  # a new stream must not take the heading of the last one
        elif target and 0.0 < hover_thrust_norm < 1.0 and isfinite(target.yaw_rad):
            self._level = AttitudeTarget(0.0, 0.0, target.yaw_rad, hover_thrust_norm)

    def publishes(self, packet: PeerPacket | None) -> None:
        """The peer packet of a tick, before it is published; None where peers must not use its position."""
        self._packet = packet

    def step(self, now_s: float) -> Response:
        """The response at this time. The first one goes out in the tick that fails, the others until the autopilot holds.

        A mode that the agent did not command is the pilot's: nothing is sent. Without a stream the autopilot flies itself: only
        a hold that is under way is requested again.
        """
        is_first = self._failed_s is None
        if self._failed_s is None:
            self._failed_s = now_s
        blind = now_s - self._telemetry_s > TELEMETRY_FRESH_S and not is_first
        flight = self._flight
        under_way = flight.streams or flight.phase is FlightPhase.RELEASE
        if not under_way or blind or now_s - self._failed_s > HAND_OVER_WITHIN_S:
            return Response()
        if self._mode is AutopilotMode.OFFBOARD:
            return Response(self._level, self._request(now_s), ended=False)
        if flight.phase is FlightPhase.ENGAGE and self._mode is AutopilotMode.HOLD:
            # The request to follow the setpoints may be under way.
            return Response(None, self._request(now_s), ended=False)
        return Response()

    def packet(self, now_s: float) -> PeerPacket | None:
        """The last peer packet for now: the vehicle is released and brakes. The age of its position has advanced."""
        last = self._packet
        if last is None:
            return None
        sender, motion = last.sender, last.motion
        self._packet = replace(
            last,
            sender=replace(sender, sequence=sender.sequence + 1),
            phase=FlightPhase.RELEASE,
            motion=replace(
                motion,
                acceleration_enu_m_s2=ZERO3,
                state_age_s=motion.state_age_s + max(0.0, now_s - motion.sent_s),
                sent_s=now_s,
            ),
            change=None,
            rft=None,
        )
        return self._packet

    def _request(self, now_s: float) -> tuple[AutopilotRequest, ...]:
        if now_s - self._requested_s < REPEAT_REQUEST_S:
            return ()
        self._requested_s = now_s
        return (SetMode(AutopilotMode.HOLD),)
