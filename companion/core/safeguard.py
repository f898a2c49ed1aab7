"""What an agent does unasked: leaves formation when something is wrong or it is to stop, falls silent, lands out of hold."""

from __future__ import annotations

from collections.abc import Iterable

from companion.core.battery import BatteryWatch
from companion.core.cooperation import Neighbourhood
from companion.core.envelope import EnvelopeLimits
from companion.core.failsafe import failsafe_action
from companion.core.flight_manners import manners_of
from companion.core.flown_formation import FlownFormation
from companion.core.health import AgeLimits, health_flags
from companion.core.phase import STREAMING, PhaseMachine
from companion.core.setpoint_stream import SetpointStream
from companion.core.succession import HeldForWantOfALeader
from companion.types import FailsafeAction, FlightPhase, HealthFlag, Telemetry, VehicleState

HAND_OVER_S = 2.0  # at the end: how long the autopilot may take to go into its own hold
SILENT_TOO_LONG_S = 0.5  # less than COM_OF_LOSS_T: PX4 re-enters OFFBOARD by itself when a stream returns
MODE_SURE_S = 0.2  # so old may the mode be where the agent, seeing nothing else, still asks for another


class Safeguard:
    """One vehicle's. `fit_to_lead`: as of the last tick it flies in formation and nothing speaks against its leading.

    `events` tells when the leader's word begins to be missed, until somebody takes it.
    """

    def __init__(
        self,
        machine: PhaseMachine,
        formation: FlownFormation,
        setpoints: SetpointStream,
        held: HeldForWantOfALeader,
        battery: BatteryWatch,
        ages: AgeLimits,
        envelope: EnvelopeLimits,
    ) -> None:
        self._machine = machine
        self._formation = formation
        self._setpoints = setpoints
        self._held = held
        self._ages = ages
        self._envelope = envelope
        self._stopping_s: float | None = None  # since when this agent is to stop
        self._missed_leader = False  # as of the last tick
        self.battery = battery
        self.fit_to_lead = False
        self.events: list[str] = []

    def judge(
        self, now_s: float, telemetry: Iterable[Telemetry], vehicle: VehicleState, around: Neighbourhood
    ) -> tuple[frozenset[HealthFlag], FailsafeAction]:
        """All that is wrong in this tick, and what follows from it while setpoints stream."""
        self.battery.hear(telemetry)
        flags = health_flags(now_s, vehicle, around.leaderless, self._ages, self._envelope)
        self._tell_of_missing_leader(flags)
        return flags, failsafe_action(flags)

    def end_landings(self) -> None:
        """Whatever the vehicle was about to do by itself, it was told something."""
        self._held.end()
        self.battery.end()

    def stop(self, now_s: float, vehicle: VehicleState) -> None:
        """Every tick from when the process is to end."""
        if self._stopping_s is None:
            self._stopping_s = now_s
        self._machine.hand_over(now_s, vehicle, "this agent is to stop")
        if now_s - self._stopping_s > HAND_OVER_S and not self._machine.has_handed_over(vehicle):
            self._machine.give_up("this agent is to stop, and the autopilot does not take over")

    def act(
        self,
        now_s: float,
        vehicle: VehicleState,
        around: Neighbourhood,
        flags: frozenset[HealthFlag],
        action: FailsafeAction,
    ) -> None:
        """After the commands of a tick: leave formation, or land, where that is due."""
        machine = self._machine
        if machine.streams(vehicle):
            self._leave(now_s, vehicle, flags, action)
        if self._held.must_land(now_s, machine.phase, led=around.leader_word is not None):
            machine.land(now_s, vehicle, "in hold for want of a leader, and none came")
        if self.battery.must_land(machine.phase):
            machine.land(now_s, vehicle, "in hold for want of battery")
        self.fit_to_lead = (
            machine.phase is FlightPhase.FORMATION
            and action is FailsafeAction.NONE
            and not self._formation.refusal_to_lead(now_s)
        )

    def _tell_of_missing_leader(self, flags: frozenset[HealthFlag]) -> None:
        """At once, for the log and the ground: what follows is due in fractions of a second."""
        misses = HealthFlag.LEADER_AWAITED in flags and self._machine.phase is FlightPhase.FORMATION
        if misses and not self._missed_leader:
            self.events.append("no leader's word: formation is held without")
        self._missed_leader = misses

    def _leave(self, now_s: float, vehicle: VehicleState, flags: frozenset[HealthFlag], action: FailsafeAction) -> None:
        machine = self._machine
        if self._setpoints.silent_s(now_s) > SILENT_TOO_LONG_S:
            self._end_formation_in_silence(now_s, vehicle, flags)
        elif action is FailsafeAction.HOLD:
            if HealthFlag.LEADER_LOST in flags and machine.phase in STREAMING:
                self._held.begin(now_s)
            machine.hand_over(now_s, vehicle, _reason(flags))
        elif machine.phase in STREAMING and (too_low := self.battery.too_low):
            machine.hand_over(now_s, vehicle, too_low)
            self.battery.begin()

    def _end_formation_in_silence(self, now_s: float, vehicle: VehicleState, flags: frozenset[HealthFlag]) -> None:
        """Who would drift on by itself is asked to hold, unless a pilot may have taken over unseen."""
        if self._machine.phase in (FlightPhase.ENGAGE, FlightPhase.FORMATION):
            reason = f"silent for {SILENT_TOO_LONG_S} s: {_reason(flags)}"
            if manners_of(vehicle).flies_on_in_silence and now_s - vehicle.mode_time_s < MODE_SURE_S:
                self._machine.hand_over_silently(now_s, vehicle, reason)
            else:
                self._machine.give_up(reason)
        self._machine.end_stream()


def _reason(flags: frozenset[HealthFlag]) -> str:
    return ", ".join(sorted(flags)) or "nothing to decide on"
