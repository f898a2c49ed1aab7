"""ArduCopter in flight: the modes of each phase, the request that carries out each command, and the parameters of the audit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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
    Values,
    always,
    climb,
    differs,
    has_bit,
    mode_is,
    mode_time_s,
    one_of,
    with_bit,
)
from companion.types.autopilot import AutopilotMode, LandedState, SetMode, TakeOff, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import ON_GROUND, FlightPhase
from companion.types.notices import Code

P, M, C = FlightPhase, AutopilotMode, CommandName

THRUST_IS_THRUST = 8  # bit 3 of GUID_OPTIONS


def _enter_guided(_vehicle: VehicleState, _height_m: float) -> Procedure:
    # ArduCopter enters GUIDED without a stream, and keeps its position there until the first setpoint.
    taken = mode_is(M.OFFBOARD)
    return Procedure(SetMode(M.OFFBOARD), taken, taken, mode_time_s, timeout_s=5.0)


def _take_off_in_guided(vehicle: VehicleState, height_m: float) -> Procedure:
    # The motors spin up for 3 s before lift-off, and restart that when the request is repeated. The mode is GUIDED before and
    # after: only the landed state shows that the climb has ended.
    procedure = climb(vehicle, TakeOff(height_m), lambda v: v.mode is M.OFFBOARD and v.landed is LandedState.IN_AIR)
    return replace(procedure, acceptance_counts=True)


GROUND_STATION_LOSS = {0: Judgement(OK, "nothing")}
FENCE_ACTIONS = {0: Judgement(WARNING, "report only")}


def _guided_options(value: float) -> Judgement:
    if int(value) & THRUST_IS_THRUST:
        return Judgement(OK, "thrust is thrust")
    return Judgement(REFUSAL, "thrust is taken as a climb rate")


def _angle_boost(value: float) -> Judgement:
    return Judgement(OK, "tilt is compensated") if value else Judgement(WARNING, "sinks when it tilts")


def _guided_timeout(seconds: float) -> Judgement:
    if seconds > 1.5:
        return Judgement(REFUSAL if seconds > 3.0 else WARNING, "keeps the last attitude and thrust for this time")
    if seconds < SHORTEST_TIMEOUT_S:
        return Judgement(WARNING, "shorter than the agent's")
    return Judgement(OK)


def _switch(value: float) -> Judgement:
    return Judgement(OK, "on") if value else Judgement(WARNING, "no fence")


CEILING, CIRCLE = 1, 2  # bits of FENCE_TYPE; 4: polygons, 8: floor
FENCE_IS_ON, ACTS_AT_FENCE = differs("FENCE_ENABLE", 0), differs("FENCE_ACTION", 0)


def _fence_type(value: float) -> Judgement:
    match int(value) & (CEILING | CIRCLE):
        case 0:
            return Judgement(WARNING, "no ceiling and no circle around home" if value else "no fence")
        case 1:
            return Judgement(WARNING, "no circle around home")
        case 2:
            return Judgement(WARNING, "no ceiling")
    return Judgement(OK, "ceiling and circle")


def _is_on(name: str, bit: int) -> Callable[[Values], bool]:
    of_this_type = has_bit(name, bit)
    return lambda values: FENCE_IS_ON(values) and of_this_type(values)


def _any(_metres: float) -> Judgement:
    """The fleet's fence and the take-off height decide."""
    return Judgement(OK)


PARAMETERS: tuple[ParameterRule, ...] = (
    ParameterRule(
        "GUID_OPTIONS",
        Code.THRUST_IS_CLIMB_RATE,
        "bit 3 (8) set",
        _guided_options,
        with_bit(THRUST_IS_THRUST),
        not_found=Judgement(REFUSAL),
    ),
    ParameterRule("ATC_ANGLE_BOOST", Code.ANGLE_BOOST_OFF, "1", _angle_boost, always(1.0)),
    ParameterRule("GUID_TIMEOUT", Code.SETPOINT_TIMEOUT_UNSAFE, "0.6 to 1.5 s", _guided_timeout, always(1.0), unit="s"),
    ParameterRule(
        "FS_GCS_ENABLE",
        Code.GROUND_LOSS_ACTION,
        "0 (nothing)",
        one_of(GROUND_STATION_LOSS, Judgement(WARNING, "leaves the formation without a ground station")),
        remedy=PILOTS_CHOICE.format("FS_GCS_ENABLE"),
    ),
    ParameterRule(
        "FENCE_ENABLE",
        Code.AUTOPILOT_FENCE_OFF,
        "1",
        _switch,
        remedy="set FENCE_RADIUS and FENCE_ALT_MAX a little wider than the fleet's fence, then FENCE_ENABLE to 1",
    ),
    ParameterRule(
        "FENCE_TYPE",
        Code.AUTOPILOT_FENCE_OFF,
        "bits 0 (ceiling) and 1 (circle) set, such as 7",
        _fence_type,
        remedy="set FENCE_RADIUS and FENCE_ALT_MAX a little wider than the fleet's fence, then FENCE_TYPE to 7",
        applies=FENCE_IS_ON,
    ),
    ParameterRule(
        "FENCE_RADIUS",
        Code.AUTOPILOT_FENCE_OFF,
        "more than 0 m from home",
        _any,
        remedy=WIDER_FENCE.format("FENCE_RADIUS"),
        unit="m",
        applies=_is_on("FENCE_TYPE", CIRCLE),
        fence_side=FenceSide.RADIUS,
        acts=ACTS_AT_FENCE,
    ),
    ParameterRule(
        "FENCE_ALT_MAX",
        Code.AUTOPILOT_FENCE_OFF,
        "more than 0 m above home",
        _any,
        remedy=WIDER_FENCE.format("FENCE_ALT_MAX"),
        unit="m",
        applies=_is_on("FENCE_TYPE", CEILING),
        fence_side=FenceSide.CEILING,
        acts=ACTS_AT_FENCE,
    ),
    ParameterRule(
        "FENCE_ACTION",
        Code.FENCE_ACTION_UNSAFE,
        "1 (return or land) or more",
        one_of(FENCE_ACTIONS, Judgement(OK)),
        always(1.0),
    ),
    ParameterRule(
        "RALLY_TOTAL",
        Code.RETURNS_ELSEWHERE,
        "0",
        one_of({0: Judgement(OK, "returns home")}, Judgement(WARNING, "returns to a rally point or home")),
        remedy="clear the rally points, or expect `return` to be refused",
    ),
    ParameterRule("MOT_THST_HOVER", Code.HOVER_THRUST_DIFFERS, NEAR_CONFIGURED, None, remedy=HOVER),
)

SENDERS, UPDATE = "ArduCopter 4.5 and newer", "update the firmware of the autopilot"
# Its modes come in HEARTBEAT, without which there is no autopilot.
MESSAGES = {
    "positions": SentFrom("LOCAL_POSITION_NED", SENDERS, "wait: it comes once the estimator has a position"),
    "attitudes": SentFrom("ATTITUDE_QUATERNION", SENDERS, UPDATE),
    "landed states": SentFrom("EXTENDED_SYS_STATE", SENDERS, UPDATE),
}

# ArduCopter arms, climbs, holds and flies formation in GUIDED. It leaves formation for BRAKE.
EXTERNAL_NAVIGATION = 6  # of EK3_SRC1_*


def _source(name: str, otherwise: Judgement) -> ParameterRule:
    """The rule that the estimator takes this from poses."""
    used = one_of({EXTERNAL_NAVIGATION: Judgement(OK, "external navigation")}, otherwise)
    return ParameterRule(name, Code.POSES_NOT_USED, "6 (external navigation)", used, always(6.0))


VISION_PARAMETERS: tuple[ParameterRule, ...] = (
    ParameterRule(
        "VISO_TYPE",
        Code.POSES_NOT_USED,
        "1 (MAVLink)",
        one_of({1: Judgement(OK, "MAVLink")}, Judgement(REFUSAL, "takes no poses from MAVLink")),
        always(1.0),
        not_found=Judgement(REFUSAL),
    ),
    _source("EK3_SRC1_POSXY", Judgement(REFUSAL, "position is not from poses")),
    _source("EK3_SRC1_VELXY", Judgement(WARNING, "velocity is not from poses")),
    _source("EK3_SRC1_POSZ", Judgement(WARNING, "another height that drifts against the poses")),
    _source("EK3_SRC1_YAW", Judgement(WARNING, "yaw is not from poses: a compass is wrong near steel")),
)

PROFILE = AutopilotProfile(
    modes=MODES
    | dict.fromkeys(ON_GROUND, frozenset({M.OFFBOARD}))
    | {
        P.TAKEOFF: frozenset({M.OFFBOARD}),
        P.HOLD: frozenset({M.OFFBOARD, M.HOLD}),
        P.ENGAGE: frozenset({M.OFFBOARD, M.HOLD}),
        P.FORMATION: frozenset({M.OFFBOARD}),
    },
    procedures=PROCEDURES | {C.PREPARE: _enter_guided, C.TAKEOFF: _take_off_in_guided, C.FORM: _enter_guided},
    flies_on_in_silence=True,  # for GUID_TIMEOUT, 3 s; then it levels and keeps its altitude, but not its position
    takes_off_by_altitude=False,
    parameters=PARAMETERS,
    vision_parameters=VISION_PARAMETERS,
    decide_in_silence=("GUID_TIMEOUT", "GUID_OPTIONS"),
    messages=MESSAGES,
)
