"""Autopilot profiles: the flight modes of each phase, and the request that carries out each command.

All differences between autopilots in flight are data here; `core/command/phase.py` holds the state machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import inf

from companion.core.command.procedure import Procedure, Truth
from companion.types.autopilot import (
    Arm,
    AutopilotKind,
    AutopilotMode,
    Disarm,
    LandedState,
    SetMode,
    TakeOff,
    VehicleState,
    in_air,
)
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase

P, M, C = FlightPhase, AutopilotMode, CommandName

STREAM_BEFORE_OFFBOARD_S = 0.3  # PX4 takes OFFBOARD only from a running stream
CLIMBED_WITHIN_M = 0.3


ProcedureBuilder = Callable[[VehicleState, float], Procedure]
"""(state, take-off height in metres) -> procedure. Raises ValueError where the state does not allow it."""


@dataclass(frozen=True, slots=True)
class AutopilotProfile:
    """`modes`: the modes of each phase; a running procedure also tolerates the mode in which it began.

    `procedures`: all commands that reach the autopilot. `flies_on_in_silence`: when the stream ends, the autopilot continues
    the last attitude and thrust for seconds, so the last setpoint must be safe to continue.
    """

    modes: Mapping[FlightPhase, frozenset[AutopilotMode]]
    procedures: Mapping[CommandName, ProcedureBuilder]
    flies_on_in_silence: bool


def profile_of(vehicle: VehicleState) -> AutopilotProfile:
    """Profile of this vehicle's autopilot. Raises LookupError before its first HEARTBEAT."""
    if vehicle.autopilot is None:
        raise LookupError("no HEARTBEAT has come from the autopilot yet")
    return PROFILES[vehicle.autopilot]


def _mode_is(mode: AutopilotMode) -> Truth:
    return lambda vehicle: vehicle.mode is mode


def _armed(vehicle: VehicleState) -> bool:
    return vehicle.armed


def _disarmed(vehicle: VehicleState) -> bool:
    return not vehicle.armed


def _mode_time_s(vehicle: VehicleState) -> float:
    return vehicle.mode_time_s


def _heartbeat_time_s(vehicle: VehicleState) -> float:
    return vehicle.heartbeat_time_s


def _hold(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # settle_s: an OFFBOARD request sent just before the hold may still arrive after the hold looked done.
    held = _mode_is(M.HOLD)
    return Procedure(SetMode(M.HOLD), held, held, _mode_time_s, timeout_s=5.0, settle_s=0.2)


def _guided(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # ArduCopter enters GUIDED without a stream, and keeps its position there until the first setpoint.
    taken = _mode_is(M.OFFBOARD)
    return Procedure(SetMode(M.OFFBOARD), taken, taken, _mode_time_s, timeout_s=5.0)


def _offboard(_vehicle: VehicleState, _height_m: float) -> Procedure:
    taken = _mode_is(M.OFFBOARD)
    return Procedure(SetMode(M.OFFBOARD), taken, taken, _mode_time_s, timeout_s=5.0, delay_s=STREAM_BEFORE_OFFBOARD_S)


def _arm(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # Not repeated once accepted, as a pilot may have disarmed meanwhile. HEARTBEAT shows it only once a second.
    return Procedure(Arm(), _armed, _armed, _heartbeat_time_s, timeout_s=10.0, repeat_s=1.5, acceptance_counts=True)


def _disarm(_vehicle: VehicleState, _height_m: float) -> Procedure:
    return Procedure(Disarm(), _disarmed, _disarmed, _heartbeat_time_s, timeout_s=5.0)


def _land(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # On the ground only disarming remains, in whatever mode.
    return Procedure(SetMode(M.LAND), _lands_or_has_landed, _disarmed, _heartbeat_time_s, timeout_s=120.0)


def _lands_or_has_landed(vehicle: VehicleState) -> bool:
    return vehicle.mode is M.LAND or vehicle.landed is LandedState.ON_GROUND


def _return(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # No time limit: the autopilot decides, and waits above home for ever where it is configured to.
    return Procedure(
        SetMode(M.RETURN), _returns_or_has_landed, _disarmed, _heartbeat_time_s, timeout_s=inf, taken_within_s=5.0
    )


def _returns_or_has_landed(vehicle: VehicleState) -> bool:
    return vehicle.mode is M.RETURN or vehicle.landed is LandedState.ON_GROUND


def _take_off(vehicle: VehicleState, height_m: float) -> Procedure:
    return _climb(vehicle, height_m, _mode_is(M.HOLD))


def _take_off_in_guided(vehicle: VehicleState, height_m: float) -> Procedure:
    # The motors spin up for 3 s before lift-off, and restart that when the request is repeated. The mode is GUIDED before and
    # after: only the landed state shows that the climb has ended.
    climb = _climb(vehicle, height_m, lambda v: v.mode is M.OFFBOARD and v.landed is LandedState.IN_AIR)
    return replace(climb, acceptance_counts=True)


def _climb(vehicle: VehicleState, height_m: float, has_ended: Truth) -> Procedure:
    if vehicle.altitude_amsl_m is None:
        raise ValueError("the autopilot's altitude above sea level is unknown")
    target_z_m = vehicle.position_enu_m[2] + height_m
    return Procedure(
        TakeOff(vehicle.altitude_amsl_m + height_m, height_m),
        taken=lambda v: v.mode is M.TAKEOFF or in_air(v),
        done=lambda v: has_ended(v) and abs(v.position_enu_m[2] - target_z_m) < CLIMBED_WITHIN_M,
        truth_time=_mode_time_s,
        timeout_s=15.0 + 2.0 * height_m,
    )


PX4 = AutopilotProfile(
    modes={
        P.PREPARE: frozenset({M.HOLD}),
        P.READY: frozenset({M.HOLD}),
        P.ARM: frozenset({M.HOLD}),
        P.ARMED: frozenset({M.HOLD}),
        P.TAKEOFF: frozenset({M.TAKEOFF, M.HOLD}),
        P.HOLD: frozenset({M.HOLD}),
        P.ENGAGE: frozenset({M.HOLD, M.OFFBOARD}),
        P.FORMATION: frozenset({M.OFFBOARD}),
        P.RELEASE: frozenset({M.HOLD}),
        P.LAND: frozenset({M.LAND}),
        P.RETURN: frozenset({M.RETURN}),
    },
    procedures={
        C.PREPARE: _hold,
        C.ARM: _arm,
        C.TAKEOFF: _take_off,
        C.FORM: _offboard,
        C.HOLD: _hold,
        C.LAND: _land,
        C.RETURN: _return,
        C.DISARM: _disarm,
    },
    flies_on_in_silence=False,  # COM_OF_LOSS_T after the last setpoint its own failsafe acts
)

# ArduCopter arms, climbs, holds and flies formation in GUIDED. It leaves formation for BRAKE.
ARDUPILOT = AutopilotProfile(
    modes={
        P.PREPARE: frozenset({M.OFFBOARD}),
        P.READY: frozenset({M.OFFBOARD}),
        P.ARM: frozenset({M.OFFBOARD}),
        P.ARMED: frozenset({M.OFFBOARD}),
        P.TAKEOFF: frozenset({M.OFFBOARD}),
        P.HOLD: frozenset({M.OFFBOARD, M.HOLD}),
        P.ENGAGE: frozenset({M.OFFBOARD, M.HOLD}),
        P.FORMATION: frozenset({M.OFFBOARD}),
        P.RELEASE: frozenset({M.HOLD}),
        P.LAND: frozenset({M.LAND}),
        P.RETURN: frozenset({M.RETURN}),
    },
    procedures={
        C.PREPARE: _guided,
        C.ARM: _arm,
        C.TAKEOFF: _take_off_in_guided,
        C.FORM: _guided,
        C.HOLD: _hold,
        C.LAND: _land,
        C.RETURN: _return,
        C.DISARM: _disarm,
    },
    flies_on_in_silence=True,  # for GUID_TIMEOUT, 3 s; then it levels and keeps its altitude, but not its position
)

PROFILES: dict[AutopilotKind, AutopilotProfile] = {AutopilotKind.PX4: PX4, AutopilotKind.ARDUPILOT: ARDUPILOT}
