"""Autopilot parameters that matter to a formation: the meaning of each value, and values that may be set automatically.

A value that is set automatically never weakens a failsafe or takes control from the pilot. For PX4 1.16 and ArduCopter 4.5 to
4.7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code


class Verdict(StrEnum):
    """Result of a check. A vehicle may fly with warnings but not with refusals."""

    OK = "ok"
    WARNING = "warning"
    REFUSAL = "refusal"


OK, WARNING, REFUSAL = Verdict.OK, Verdict.WARNING, Verdict.REFUSAL

# The agent leaves its formation after 0.5 s of silence. An autopilot with a shorter timeout would accept a stream that
# returns and continue without a command.
SHORTEST_TIMEOUT_S = 0.6
THRUST_IS_THRUST = 8  # bit 3 of GUID_OPTIONS
OVERRIDE_IN_OFFBOARD = 2  # bit 1 of COM_RC_OVERRIDE


@dataclass(frozen=True, slots=True)
class Judgement:
    """Verdict on a value. `meaning` is what the autopilot does with it.

    `acceptable`: with `accept_uncontrolled_descent` in the vehicle file this refusal is a warning, as a pilot stands by.
    """

    verdict: Verdict
    meaning: str = ""
    acceptable: bool = False


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """Rule for one parameter. With `judge` None it is compared with the hover thrust of the vehicle file.

    `safe` gives the value that may be set instead of a bad one; without it a person decides, with the help of `remedy`.
    """

    name: str
    code: Code
    wanted: str
    judge: Callable[[float], Judgement] | None
    safe: Callable[[float], float] | None = None
    unit: str = ""
    remedy: str = ""
    not_found: Judgement = Judgement(WARNING)


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
PX4_FENCE_ACTIONS = {
    0: Judgement(WARNING, "nothing"),
    1: Judgement(WARNING, "warning only"),
    2: Judgement(OK, "hold"),
    3: Judgement(OK, "return"),
    4: Judgement(REFUSAL, "terminate: it falls at the fence"),
    5: Judgement(OK, "land"),
}
GROUND_STATION_LOSS = {0: Judgement(OK, "nothing")}
ARDUPILOT_FENCE_ACTIONS = {0: Judgement(WARNING, "report only")}


def _one_of(meanings: dict[int, Judgement], otherwise: Judgement) -> Callable[[float], Judgement]:
    return lambda value: meanings.get(round(value), otherwise)


def _rc_override(value: float) -> Judgement:
    if int(value) & OVERRIDE_IN_OFFBOARD:
        return Judgement(OK, "sticks take over in OFFBOARD")
    return Judgement(WARNING, "in OFFBOARD only the mode switch takes over")


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


def _distance(metres: float) -> Judgement:
    return Judgement(OK) if metres > 0.0 else Judgement(WARNING, "no fence")


def _switch(value: float) -> Judgement:
    return Judgement(OK, "on") if value else Judgement(WARNING, "no fence")


def _with_bit(bit: int) -> Callable[[float], float]:
    return lambda value: float(int(value) | bit)


def _always(value: float) -> Callable[[float], float]:
    return lambda _found: value


NEAR_CONFIGURED = "near hover_thrust_norm of the vehicle file"
HOVER = "hover the vehicle, then correct the wrong value"
PILOTS_CHOICE = "set {} to 0, or expect each vehicle to leave the formation separately"
WIDER_FENCE = "set {} a little wider than the fleet's fence (envelope.fence_*)"

RULES: dict[AutopilotKind, tuple[ParameterRule, ...]] = {
    AutopilotKind.PX4: (
        ParameterRule(
            "COM_OF_LOSS_T", Code.SETPOINT_TIMEOUT_UNSAFE, "0.6 to 2 s", _offboard_timeout, _always(1.0), unit="s"
        ),
        ParameterRule(
            "COM_OBL_RC_ACT",
            Code.SETPOINT_LOSS_ACTION_UNSAFE,
            "5 (hold) or 4 (land)",
            _one_of(OFFBOARD_LOSS, Judgement(REFUSAL, "unknown action", acceptable=True)),
            _always(5.0),
            not_found=Judgement(REFUSAL, acceptable=True),
        ),
        ParameterRule(
            "NAV_DLL_ACT",
            Code.GROUND_LOSS_ACTION,
            "0 (nothing)",
            _one_of(DATA_LINK_LOSS, Judgement(WARNING, "unknown action")),
            remedy=PILOTS_CHOICE.format("NAV_DLL_ACT"),
        ),
        ParameterRule(
            "COM_RC_OVERRIDE", Code.RC_OVERRIDE_OFF, "bit 1 (2) set", _rc_override, _with_bit(OVERRIDE_IN_OFFBOARD)
        ),
        ParameterRule(
            "GF_ACTION",
            Code.FENCE_ACTION_UNSAFE,
            "2 (hold), 3 (return) or 5 (land)",
            _one_of(PX4_FENCE_ACTIONS, Judgement(WARNING, "unknown action")),
            _always(2.0),
        ),
        ParameterRule(
            "GF_MAX_HOR_DIST",
            Code.AUTOPILOT_FENCE_OFF,
            "more than 0 m from home",
            _distance,
            remedy=WIDER_FENCE.format("GF_MAX_HOR_DIST"),
            unit="m",
        ),
        ParameterRule(
            "GF_MAX_VER_DIST",
            Code.AUTOPILOT_FENCE_OFF,
            "more than 0 m above home",
            _distance,
            remedy=WIDER_FENCE.format("GF_MAX_VER_DIST"),
            unit="m",
        ),
        ParameterRule("MPC_THR_HOVER", Code.HOVER_THRUST_DIFFERS, NEAR_CONFIGURED, None, remedy=HOVER),
    ),
    AutopilotKind.ARDUPILOT: (
        ParameterRule(
            "GUID_OPTIONS",
            Code.THRUST_IS_CLIMB_RATE,
            "bit 3 (8) set",
            _guided_options,
            _with_bit(THRUST_IS_THRUST),
            not_found=Judgement(REFUSAL),
        ),
        ParameterRule("ATC_ANGLE_BOOST", Code.ANGLE_BOOST_OFF, "1", _angle_boost, _always(1.0)),
        ParameterRule(
            "GUID_TIMEOUT", Code.SETPOINT_TIMEOUT_UNSAFE, "0.6 to 1.5 s", _guided_timeout, _always(1.0), unit="s"
        ),
        ParameterRule(
            "FS_GCS_ENABLE",
            Code.GROUND_LOSS_ACTION,
            "0 (nothing)",
            _one_of(GROUND_STATION_LOSS, Judgement(WARNING, "leaves the formation without a ground station")),
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
            "FENCE_ACTION",
            Code.FENCE_ACTION_UNSAFE,
            "1 (return or land) or more",
            _one_of(ARDUPILOT_FENCE_ACTIONS, Judgement(OK)),
            _always(1.0),
        ),
        ParameterRule("MOT_THST_HOVER", Code.HOVER_THRUST_DIFFERS, NEAR_CONFIGURED, None, remedy=HOVER),
    ),
}
