"""PX4 in flight: the modes of each phase, the request that carries out each command, and the parameters of the audit."""

from __future__ import annotations

from dataclasses import replace
from math import inf

from companion.core.autopilot import (
    HOVER,
    MODES,
    NEAR_CONFIGURED,
    OK,
    PILOTS_CHOICE,
    PROCEDURES,
    REFUSAL,
    SHORTEST_TIMEOUT_S,
    WARNING,
    WIDER_FENCE,
    AutopilotProfile,
    FenceSide,
    Judgement,
    ParameterRule,
    Procedure,
    SentFrom,
    always,
    climb,
    differs,
    hold,
    mode_is,
    mode_time_s,
    one_of,
    with_bit,
)
from companion.types.autopilot import AutopilotMode, SetMode, TakeOff, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import ON_GROUND, FlightPhase
from companion.types.notices import Code

P, M, C = FlightPhase, AutopilotMode, CommandName

STREAM_BEFORE_OFFBOARD_S = 0.3  # PX4 takes OFFBOARD only from a running stream
OVERRIDE_IN_OFFBOARD = 2  # bit 1 of COM_RC_OVERRIDE


def _hold_on_ground(vehicle: VehicleState, height_m: float) -> Procedure:
    # Nothing drifts there: a refusal may pass, as while PX4 starts.
    return replace(hold(vehicle, height_m), refused_for_s=inf)


def _enter_offboard(_vehicle: VehicleState, _height_m: float) -> Procedure:
    taken = mode_is(M.OFFBOARD)
    return Procedure(SetMode(M.OFFBOARD), taken, taken, mode_time_s, timeout_s=5.0, delay_s=STREAM_BEFORE_OFFBOARD_S)


def _take_off(vehicle: VehicleState, height_m: float) -> Procedure:
    if vehicle.altitude_amsl_m is None:
        raise ValueError("the autopilot's altitude above sea level is unknown")
    return climb(vehicle, TakeOff(height_m, vehicle.altitude_amsl_m + height_m), mode_is(M.HOLD))


def _offboard_timeout(seconds: float) -> Judgement:
    if seconds > 2.0:
        return Judgement(REFUSAL, "keeps the last setpoint for this time")
    if seconds < 0.1:
        return Judgement(REFUSAL, "OFFBOARD ends between two setpoints")
    if seconds < SHORTEST_TIMEOUT_S:
        return Judgement(WARNING, "shorter than the agent's: OFFBOARD may return without a command")
    return Judgement(OK)


OFFBOARD_LOSS = {
    0: Judgement(REFUSAL, "position mode: sinks and drifts without a pilot", acceptable=True),
    1: Judgement(REFUSAL, "altitude mode: sinks and drifts without a pilot", acceptable=True),
    2: Judgement(REFUSAL, "stabilized: needs a pilot at once", acceptable=True),
    3: Judgement(WARNING, "return: climbs and flies home between the other vehicles"),
    4: Judgement(OK, "land"),
    5: Judgement(OK, "hold"),
    6: Judgement(REFUSAL, "terminate: it falls"),
    7: Judgement(REFUSAL, "disarm: it falls"),
}
DATA_LINK_LOSS = {
    0: Judgement(OK, "nothing"),
    1: Judgement(WARNING, "hold: leaves the formation without a ground station"),
    2: Judgement(WARNING, "return: leaves the formation without a ground station"),
    3: Judgement(WARNING, "land: leaves the formation without a ground station"),
    5: Judgement(REFUSAL, "terminate: falls without a ground station"),
    6: Judgement(REFUSAL, "disarm: falls without a ground station"),
}
FENCE_ACTIONS = {
    0: Judgement(WARNING, "nothing"),
    1: Judgement(WARNING, "warning only"),
    2: Judgement(OK, "hold"),
    3: Judgement(OK, "return"),
    4: Judgement(REFUSAL, "terminate: it falls at the fence"),
    5: Judgement(OK, "land"),
}


ACTS_AT_FENCE = differs("GF_ACTION", 0, 1)


def _rc_override(value: float) -> Judgement:
    if int(value) & OVERRIDE_IN_OFFBOARD:
        return Judgement(OK, "sticks take over in OFFBOARD")
    return Judgement(WARNING, "in OFFBOARD only the mode switch takes over")


def _distance(metres: float) -> Judgement:
    return Judgement(OK) if metres > 0.0 else Judgement(WARNING, "no fence")


PARAMETERS: tuple[ParameterRule, ...] = (
    ParameterRule(
        "COM_OF_LOSS_T", Code.SETPOINT_TIMEOUT_UNSAFE, "0.6 to 2 s", _offboard_timeout, always(1.0), unit="s"
    ),
    ParameterRule(
        "COM_OBL_RC_ACT",
        Code.SETPOINT_LOSS_ACTION_UNSAFE,
        "5 (hold) or 4 (land)",
        one_of(OFFBOARD_LOSS, Judgement(REFUSAL, "unknown action", acceptable=True)),
        always(5.0),
        not_found=Judgement(REFUSAL, acceptable=True),
    ),
    ParameterRule(
        "NAV_DLL_ACT",
        Code.GROUND_LOSS_ACTION,
        "0 (nothing)",
        one_of(DATA_LINK_LOSS, Judgement(WARNING, "unknown action")),
        remedy=PILOTS_CHOICE.format("NAV_DLL_ACT"),
    ),
    ParameterRule(
        "COM_RC_OVERRIDE", Code.RC_OVERRIDE_OFF, "bit 1 (2) set", _rc_override, with_bit(OVERRIDE_IN_OFFBOARD)
    ),
    ParameterRule(
        "GF_ACTION",
        Code.FENCE_ACTION_UNSAFE,
        "2 (hold), 3 (return) or 5 (land)",
        one_of(FENCE_ACTIONS, Judgement(WARNING, "unknown action")),
        always(2.0),
    ),
    ParameterRule(
        "GF_MAX_HOR_DIST",
        Code.AUTOPILOT_FENCE_OFF,
        "more than 0 m from home",
        _distance,
        remedy=WIDER_FENCE.format("GF_MAX_HOR_DIST"),
        unit="m",
        fence_side=FenceSide.RADIUS,
        acts=ACTS_AT_FENCE,
    ),
    ParameterRule(
        "GF_MAX_VER_DIST",
        Code.AUTOPILOT_FENCE_OFF,
        "more than 0 m above home",
        _distance,
        remedy=WIDER_FENCE.format("GF_MAX_VER_DIST"),
        unit="m",
        fence_side=FenceSide.CEILING,
        acts=ACTS_AT_FENCE,
    ),
    ParameterRule(
        "RTL_TYPE",
        Code.RETURNS_ELSEWHERE,
        "0 (home or the nearest rally point)",
        one_of({0: Judgement(OK, "home or the nearest rally point")}, Judgement(WARNING, "may end elsewhere")),
        remedy="set RTL_TYPE to 0, or expect `return` to be refused",
    ),
    ParameterRule("MPC_THR_HOVER", Code.HOVER_THRUST_DIFFERS, NEAR_CONFIGURED, None, remedy=HOVER),
)

POSE_PARTS = 1 | 2 | 8  # bits of EKF2_EV_CTRL: horizontal position, vertical position, yaw; 4 is velocity


def _vision_parts(value: float) -> Judgement:
    lacks = {1: "position", 2: "height", 8: "yaw"}
    names = [name for bit, name in lacks.items() if not int(value) & bit]
    return Judgement(REFUSAL, f"does not take {', '.join(names)} from poses") if names else Judgement(OK, "takes poses")


VISION_PARAMETERS: tuple[ParameterRule, ...] = (
    ParameterRule(
        "EKF2_EV_CTRL",
        Code.POSES_NOT_USED,
        "bits 0, 1 and 3 set, such as 11",
        _vision_parts,
        with_bit(POSE_PARTS),
        not_found=Judgement(REFUSAL),
    ),
    ParameterRule(
        "EKF2_HGT_REF",
        Code.POSES_NOT_USED,
        "3 (vision)",
        one_of({3: Judgement(OK, "vision")}, Judgement(WARNING, "another height that drifts against the poses")),
        always(3.0),
    ),
    ParameterRule(
        "EKF2_GPS_CTRL",
        Code.POSES_NOT_USED,
        "0 (no GPS)",
        one_of({0: Judgement(OK, "no GPS")}, Judgement(WARNING, "uses a GPS beside the poses, if one has a fix")),
        always(0.0),
    ),
)

OF_ONBOARD_LINKS = "set the MAV_x_MODE of this port to 2 (Onboard)"
SENDERS = "PX4 v1.15 and newer"  # CURRENT_MODE came with it, the others are older
MESSAGES = {
    "positions": SentFrom("LOCAL_POSITION_NED", SENDERS, OF_ONBOARD_LINKS),
    "attitudes": SentFrom("ATTITUDE_QUATERNION", SENDERS, OF_ONBOARD_LINKS),
    "modes": SentFrom("CURRENT_MODE", SENDERS, "update the firmware of the autopilot"),
    "landed states": SentFrom("EXTENDED_SYS_STATE", SENDERS, OF_ONBOARD_LINKS),
}

PROFILE = AutopilotProfile(
    modes=MODES
    | dict.fromkeys(ON_GROUND, frozenset({M.HOLD}))
    | {
        P.TAKEOFF: frozenset({M.TAKEOFF, M.HOLD}),
        P.HOLD: frozenset({M.HOLD}),
        P.ENGAGE: frozenset({M.HOLD, M.OFFBOARD}),
        P.FORMATION: frozenset({M.OFFBOARD}),
    },
    procedures=PROCEDURES | {C.PREPARE: _hold_on_ground, C.TAKEOFF: _take_off, C.FORM: _enter_offboard},
    flies_on_in_silence=False,  # COM_OF_LOSS_T after the last setpoint its own failsafe acts
    takes_off_by_altitude=True,
    parameters=PARAMETERS,
    vision_parameters=VISION_PARAMETERS,
    decide_in_silence=("COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    messages=MESSAGES,
)
