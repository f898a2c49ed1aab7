"""Failsafes without a command: leave formation when something is wrong, end the stream, land or return out of hold."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, cos, inf, radians

from msgspec import Struct

from companion.core.autopilot import Profiles, profile_of
from companion.core.consensus.stage import Consensus
from companion.core.estimation.corrections import LARGEST_JUMP_M, ORIGIN_WITHIN_S
from companion.core.safety.failsafe import (
    LATE_TICK_S,
    NO_SETPOINT_FAILSAFE,
    NONE_ACTIVE,
    SILENT_TOO_LONG_S,
    ActiveFailsafe,
    FailsafeSettings,
    FailsafeWatch,
    flags_notice,
    schedule,
)
from companion.core.safety.fleet_checks import refusal_of_return
from companion.core.safety.limits import OutputLimits
from companion.types.autopilot import VehicleState
from companion.types.flight import (
    COOPERATING,
    STREAMING,
    FailsafeAction,
    Flight,
    FlightPhase,
    HealthFlag,
    PhaseChange,
    PhaseRequest,
)
from companion.types.notices import Code, Notice
from companion.types.status import SeparationReport

HAND_OVER_S = 2.0  # at the end: how long the autopilot may take to go into its own hold
MODE_SURE_S = 0.2  # so old may the mode be where the agent, without other telemetry, still requests another
LATE_FOR_S = 1.0  # so long TICK_LATE stays after a late tick
DUPLICATE_FOR_S = 3.0  # so long DUPLICATE_ID stays after a packet of the other agent

STOPPING = Notice(Code.AGENT_STOPPING, "this agent is stopping")
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
        self, own_id: int, separation_m: float, limits: HealthLimits, settings: FailsafeSettings, profiles: Profiles
    ) -> None:
        self._own_id = own_id
        self._separation_m = separation_m
        self._limits = limits
        self._settings = settings
        self._profiles = profiles
        self._watch = FailsafeWatch(settings)
        self._stopping_s: float | None = None  # since when this agent is to stop
        self._late_s = -inf  # when a tick was last late

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        separation: SeparationReport,
        last_setpoint_s: float,
        commanded: bool,
        stopping: bool,
        late_s: float,
    ) -> Safety:
        """`separation` is of the last setpoint. `commanded`: the last tick executed a command, which ends automatic landings.

        `stopping`: the process ends. `late_s`: how much later than due this tick began.
        """
        if late_s > LATE_TICK_S:
            self._late_s = now_s
        flags = health_flags(now_s, vehicle, self._limits)
        flags |= self._flags_of_fleet(now_s, flight.phase, consensus)
        if separation.violated:
            flags.add(HealthFlag.SEPARATION_VIOLATED)
        if now_s - self._late_s < LATE_FOR_S:
            flags.add(HealthFlag.TICK_LATE)
        active = NONE_ACTIVE
        if flags or not self._watch.is_idle:
            active = self._watch.update(now_s, flight.phase, flags, commanded)
        requests: list[PhaseRequest] = []
        if stopping:
            requests += self._stop(now_s, flight)
        if flight.streams and now_s - last_setpoint_s > SILENT_TOO_LONG_S:
            requests += self._end_silent_formation(now_s, vehicle, flight, active)
        elif active.action in PHASE_CHANGES:
            requests += self._carry_out(vehicle, flight, consensus, active)
        if not flags and not requests and active is NONE_ACTIVE:
            return SAFE
        return Safety(
            frozenset(flags), active.action, tuple(requests), tuple([flags_notice([flag]) for flag in active.warnings])
        )

    def _flags_of_fleet(self, now_s: float, phase: FlightPhase, consensus: Consensus) -> set[HealthFlag]:
        """What is wrong between the vehicles. The link counts as lost only where it was there before."""
        flags = set()
        if consensus.leaderless is not None:
            flags.add(consensus.leaderless)
        if phase in COOPERATING and consensus.newest and not consensus.present:
            flags.add(HealthFlag.FLEET_LINK_LOST)
        if now_s - consensus.duplicate_id_s < DUPLICATE_FOR_S:
            flags.add(HealthFlag.DUPLICATE_ID)
        return flags

    def _stop(self, now_s: float, flight: Flight) -> list[PhaseRequest]:
        """Hand over, and give up where the autopilot does not take over in time."""
        if self._stopping_s is None:
            self._stopping_s = now_s
        if now_s - self._stopping_s > HAND_OVER_S and not flight.has_handed_over:
            return [PhaseRequest(PhaseChange.ABANDON, NOT_TAKEN_OVER)]
        return [PhaseRequest(PhaseChange.HAND_OVER, STOPPING)]

    def _carry_out(
        self, vehicle: VehicleState, flight: Flight, consensus: Consensus, active: ActiveFailsafe
    ) -> list[PhaseRequest]:
        """A hold from formation; from hold the return or landing."""
        if flight.streams:
            return [PhaseRequest(PhaseChange.HAND_OVER, flags_notice(active.flags))]
        if flight.phase is not FlightPhase.HOLD or active.action is FailsafeAction.HOLD:
            return []
        reason = flags_notice(active.flags)
        if active.action is FailsafeAction.RETURN:
            peers, homes_enu_m = consensus.peers, consensus.ground_position_enu_m
            refusal = refusal_of_return(self._own_id, self._separation_m, vehicle, peers, homes_enu_m)
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
        ((_, action),) = schedule(NO_SETPOINT_FAILSAFE.steps_of(profile_of(vehicle, self._profiles)), self._settings)
        holds = action is FailsafeAction.HOLD and now_s - vehicle.mode_time_s < MODE_SURE_S
        return [PhaseRequest(PhaseChange.HAND_OVER_NOW if holds else PhaseChange.GIVE_UP, reason), end]


NOTHING_TO_DECIDE_ON = Notice(Code.NO_SETPOINT, "no new position to decide on")
PHASE_CHANGES = (FailsafeAction.HOLD, FailsafeAction.RETURN, FailsafeAction.LAND)


# Positions that peers must not use; positions that the vehicle itself does not know.
POSITION_WRONG = frozenset({HealthFlag.FRAME_CONTRADICTED, HealthFlag.POSITION_JUMPED})
POSITION_IN_DOUBT = POSITION_WRONG | {HealthFlag.POSITION_STALE, HealthFlag.FRAME_UNKNOWN}


@dataclass(frozen=True, slots=True)
class AgeLimits:
    """How old what the agent decides on may be, in seconds."""

    state_s: float = 0.04  # two periods of 50 Hz: no fresh decision, no setpoint
    attitude_s: float = 0.1
    mode_s: float = 0.8  # PX4 sends a new mode at once and an unchanged one twice a second, up to 0.53 s apart
    armed_s: float = 3.0  # PX4 sends HEARTBEAT once a second, whatever is asked
    landed_s: float = 3.0


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """What raises the flags of the vehicle. A battery limit of None raises none."""

    ages: AgeLimits
    envelope: OutputLimits
    low_battery_percent: float | None = None
    critical_battery_percent: float | None = None
    max_position_error_m: float = 5.0  # PX4: COM_POS_FS_EPH
    tilt_margin_rad: float = radians(10.0)  # above the commanded limit: autopilots overshoot it, and gusts add to it


def health_flags(now_s: float, vehicle: VehicleState, limits: HealthLimits) -> set[HealthFlag]:
    """The flags that the state of the own vehicle raises at `now_s`."""
    flags, ages = set(), limits.ages
    if now_s - vehicle.position_time_s > ages.state_s:
        flags.add(HealthFlag.POSITION_STALE)
    if now_s - vehicle.attitude_time_s > ages.attitude_s:
        flags.add(HealthFlag.ATTITUDE_STALE)
    if now_s - vehicle.mode_time_s > ages.mode_s:
        flags.add(HealthFlag.MODE_STALE)
    if now_s - vehicle.heartbeat_time_s > ages.armed_s:
        flags.add(HealthFlag.ARMED_STALE)
    if now_s - vehicle.landed_time_s > ages.landed_s:
        flags.add(HealthFlag.LANDED_STALE)
    if not vehicle.frame_known:
        flags.add(HealthFlag.FRAME_UNKNOWN)
    if vehicle.frame_contradicted:
        flags.add(HealthFlag.FRAME_CONTRADICTED)
    if vehicle.held_back_m > LARGEST_JUMP_M and now_s - vehicle.jump_time_s > ORIGIN_WITHIN_S:
        flags.add(HealthFlag.POSITION_JUMPED)
    if vehicle.position_time_s > -inf and not limits.envelope.fence.contains(vehicle.position_enu_m):
        flags.add(HealthFlag.OUTSIDE_FENCE)
    error = vehicle.position_error
    if not vehicle.estimator_healthy or (error and error.horizontal_m > limits.max_position_error_m):
        flags.add(HealthFlag.ESTIMATOR_BAD)
    if acos(cos(vehicle.roll_rad) * cos(vehicle.pitch_rad)) > limits.envelope.max_tilt_rad + limits.tilt_margin_rad:
        flags.add(HealthFlag.TILT_EXCEEDED)
    percent, low, critical = vehicle.battery_percent, limits.low_battery_percent, limits.critical_battery_percent
    if percent >= 0.0:  # an unknown charge (-1) is not low
        if low is not None and percent < low:
            flags.add(HealthFlag.BATTERY_LOW)
        if critical is not None and percent < critical:
            flags.add(HealthFlag.BATTERY_CRITICAL)
    return flags
