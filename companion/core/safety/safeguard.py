"""Failsafes without a command: leave formation when something is wrong, end the stream, land or return out of hold."""

from __future__ import annotations

from math import inf

from msgspec import Struct

from companion.core.consensus.stage import Consensus
from companion.core.safety.failsafe import (
    LATE_TICK_S,
    NO_SETPOINT_FAILSAFE,
    SILENT_TOO_LONG_S,
    FailsafeSettings,
    flags_notice,
    schedule,
)
from companion.core.safety.failsafe_watch import NONE_ACTIVE, ActiveFailsafe, FailsafeWatch
from companion.core.safety.health import HealthLimits, health_flags
from companion.core.safety.return_check import refusal_of_return
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

    def __init__(self, own_id: int, separation_m: float, limits: HealthLimits, settings: FailsafeSettings) -> None:
        self._own_id = own_id
        self._separation_m = separation_m
        self._limits = limits
        self._settings = settings
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
        ((_, action),) = schedule(NO_SETPOINT_FAILSAFE.steps_of(vehicle.autopilot), self._settings)
        holds = action is FailsafeAction.HOLD and now_s - vehicle.mode_time_s < MODE_SURE_S
        return [PhaseRequest(PhaseChange.HAND_OVER_NOW if holds else PhaseChange.GIVE_UP, reason), end]


NOTHING_TO_DECIDE_ON = Notice(Code.NO_SETPOINT, "no new position to decide on")
PHASE_CHANGES = (FailsafeAction.HOLD, FailsafeAction.RETURN, FailsafeAction.LAND)
