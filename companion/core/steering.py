"""The setpoint of a tick: what the phase wants, through the last gate, or what is said to an autopilot that hears no more."""

from __future__ import annotations

from companion.core.control import FormationControl
from companion.core.cooperation import COOPERATING, Neighbourhood
from companion.core.flight_manners import manners_of
from companion.core.flown_formation import FlownFormation
from companion.core.phase import PhaseMachine
from companion.core.setpoint_stream import SetpointStream
from companion.types import (
    AttitudeTarget,
    AutopilotMode,
    FailsafeAction,
    FlightPhase,
    LandedState,
    VehicleState,
)

CLIMBS_M_S = 0.3  # faster than that it does not stand on the ground any more


class Steering:
    """One vehicle's."""

    def __init__(
        self, machine: PhaseMachine, formation: FlownFormation, control: FormationControl, setpoints: SetpointStream
    ) -> None:
        self._machine = machine
        self._formation = formation
        self._control = control
        self.setpoints = setpoints

    def observe_disturbance(self, now_s: float, vehicle: VehicleState, action: FailsafeAction) -> None:
        """Only flight under a thrust that is known tells of hover thrust and wind."""
        observer = self.setpoints.observer
        if not vehicle.armed:
            observer.landed()
        if action is FailsafeAction.SILENT or not self._flies_freely(vehicle):
            observer.pause()
        elif vehicle.mode is AutopilotMode.OFFBOARD and self._machine.streams(vehicle):
            self.setpoints.observe_own(now_s, vehicle)
        else:
            self.setpoints.observe_told(now_s, vehicle)

    def setpoint(
        self, now_s: float, vehicle: VehicleState, around: Neighbourhood, action: FailsafeAction, streamed: bool
    ) -> AttitudeTarget | None:
        """None where there is nothing to be sent. `streamed`: setpoints went out until this tick."""
        if self._machine.streams(vehicle) and action is not FailsafeAction.SILENT:
            return self._decide(now_s, vehicle, around) if self.setpoints.may_follow(vehicle) else None
        if streamed and _listens_in_silence(vehicle):
            return self.setpoints.last_word(now_s)
        return None

    def _decide(self, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> AttitudeTarget | None:
        """What this phase wants, as a setpoint; None where nothing passes the last gate."""
        match self._machine.phase:
            case FlightPhase.ENGAGE:  # the autopilot has not taken the stream yet
                self._control.stand_by(vehicle)
                return self.setpoints.carry_on(now_s, vehicle)
            case FlightPhase.FORMATION:
                slot, reference = self._formation.slot, self._formation.reference
                wanted_enu_m_s2 = self._control.in_formation(vehicle, around.neighbours, slot, reference)
            case _ if self._machine.hands_over_level(now_s):
                wanted_enu_m_s2 = self._control.level(vehicle)
            case _:  # nobody takes over
                wanted_enu_m_s2 = self._control.braking(vehicle)
        return self.setpoints.follow(now_s, vehicle, wanted_enu_m_s2)

    def _flies_freely(self, vehicle: VehicleState) -> bool:
        """Off the ground, and flown by the agent or as the agent asked for."""
        if vehicle.landed not in (LandedState.IN_AIR, LandedState.TAKEOFF):
            return False
        if self._machine.phase is FlightPhase.TAKEOFF:  # it may not have left the ground yet, whatever is said of it
            return vehicle.velocity_enu_m_s[2] > CLIMBS_M_S
        return self._machine.phase in COOPERATING


def _listens_in_silence(vehicle: VehicleState) -> bool:
    """An autopilot that still takes setpoints, and would go on with the last one."""
    return vehicle.mode is AutopilotMode.OFFBOARD and manners_of(vehicle).flies_on_in_silence
