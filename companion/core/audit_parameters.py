"""The autopilots' parameters that matter to a formation: what each value means, and what may be set without asking a pilot.

A safe value never loosens a failsafe, nor takes a means from the pilot. Facts are of PX4 v1.16 and ArduCopter 4.5 to 4.7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from companion.types import AutopilotKind


class Verdict(StrEnum):
    OK = "ok"
    WARNING = "warning"
    REFUSAL = "refusal"


OK, WARNING, REFUSAL = Verdict.OK, Verdict.WARNING, Verdict.REFUSAL

# The agent gives up its formation after 0.5 s of silence. An autopilot that gives up before would take a stream that
# returns, and fly on without having been asked to.
SHORTEST_TIMEOUT_S = 0.6
THRUST_IS_THRUST = 8  # bit 3 of GUID_OPTIONS
OVERRIDE_IN_OFFBOARD = 2  # bit 1 of COM_RC_OVERRIDE


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a value comes to. `meaning` is what the autopilot does with it."""

    verdict: Verdict
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """One parameter. `judge` None: it is compared with the vehicle file's hover thrust.

    `safe` gives, from a value that is not in order, the one that may be set instead; without it a human decides, by `remedy`.
    """

    name: str
    wanted: str
    judge: Callable[[float], Judgement] | None
    safe: Callable[[float], float] | None = None
    unit: str = ""
    remedy: str = ""
    not_found: Verdict = WARNING


def _offboard_timeout(seconds: float) -> Judgement:
    if seconds > 2.0:
        return Judgement(REFUSAL, "so long it flies its last setpoint on")
    if seconds < 0.1:
        return Judgement(REFUSAL, "OFFBOARD cannot last")
    if seconds < SHORTEST_TIMEOUT_S:
        return Judgement(WARNING, "before the agent gives up: OFFBOARD may return unasked")
    return Judgement(OK)


OFFBOARD_LOSS = {
    0: Judgement(WARNING, "position mode: sinks and drifts without a pilot"),
    1: Judgement(WARNING, "altitude mode: drifts without a pilot"),
    2: Judgement(WARNING, "stabilized: a pilot must fly it at once"),
    3: Judgement(WARNING, "return: climbs and flies home past the others"),
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
    return Judgement(REFUSAL, "thrust would be taken as a climb rate")


def _angle_boost(value: float) -> Judgement:
    return Judgement(OK, "tilt is compensated") if value else Judgement(WARNING, "it would sink when it tilts")


def _guided_timeout(seconds: float) -> Judgement:
    if seconds > 3.0:
        return Judgement(REFUSAL, "so long it flies its last attitude and thrust on")
    if seconds > 1.5:
        return Judgement(WARNING, "so long it flies its last attitude and thrust on")
    if seconds < SHORTEST_TIMEOUT_S:
        return Judgement(WARNING, "before the agent gives up")
    return Judgement(OK)


def _distance(metres: float) -> Judgement:
    return Judgement(OK) if metres > 0.0 else Judgement(WARNING, "no fence")


def _switch(value: float) -> Judgement:
    return Judgement(OK, "on") if value else Judgement(WARNING, "no fence")


def _with_bit(bit: int) -> Callable[[float], float]:
    return lambda value: float(int(value) | bit)


def _always(value: float) -> Callable[[float], float]:
    return lambda _found: value


NEAR_OURS = "near hover_thrust_norm of the vehicle file"
HOVER = "fly a hover, then correct the one that is wrong"
PILOTS_CHOICE = "set {} to 0, or know that each one leaves by itself"
WIDER_FENCE = "set {} a little wider than the fleet's own fence (envelope.fence_*)"

RULES: dict[AutopilotKind, tuple[ParameterRule, ...]] = {
    AutopilotKind.PX4: (
        ParameterRule("COM_OF_LOSS_T", "0.6 to 2 s", _offboard_timeout, _always(1.0), unit="s"),
        ParameterRule(
            "COM_OBL_RC_ACT",
            "5 (hold) or 4 (land)",
            _one_of(OFFBOARD_LOSS, Judgement(WARNING, "unknown action")),
            _always(5.0),
        ),
        ParameterRule(
            "NAV_DLL_ACT",
            "0 (nothing)",
            _one_of(DATA_LINK_LOSS, Judgement(WARNING, "unknown action")),
            remedy=PILOTS_CHOICE.format("NAV_DLL_ACT"),
        ),
        ParameterRule("COM_RC_OVERRIDE", "bit 1 (2) set", _rc_override, _with_bit(OVERRIDE_IN_OFFBOARD)),
        ParameterRule(
            "GF_ACTION",
            "2 (hold), 3 (return) or 5 (land)",
            _one_of(PX4_FENCE_ACTIONS, Judgement(WARNING, "unknown action")),
            _always(2.0),
        ),
        ParameterRule(
            "GF_MAX_HOR_DIST",
            "more than 0 m from home",
            _distance,
            remedy=WIDER_FENCE.format("GF_MAX_HOR_DIST"),
            unit="m",
        ),
        ParameterRule(
            "GF_MAX_VER_DIST",
            "more than 0 m above home",
            _distance,
            remedy=WIDER_FENCE.format("GF_MAX_VER_DIST"),
            unit="m",
        ),
        ParameterRule("MPC_THR_HOVER", NEAR_OURS, None, remedy=HOVER),
    ),
    AutopilotKind.ARDUPILOT: (
        ParameterRule("GUID_OPTIONS", "bit 3 (8) set", _guided_options, _with_bit(THRUST_IS_THRUST), not_found=REFUSAL),
        ParameterRule("ATC_ANGLE_BOOST", "1", _angle_boost, _always(1.0)),
        ParameterRule("GUID_TIMEOUT", "0.6 to 1.5 s", _guided_timeout, _always(1.0), unit="s"),
        ParameterRule(
            "FS_GCS_ENABLE",
            "0 (nothing)",
            _one_of(GROUND_STATION_LOSS, Judgement(WARNING, "leaves the formation without a ground station")),
            remedy=PILOTS_CHOICE.format("FS_GCS_ENABLE"),
        ),
        ParameterRule(
            "FENCE_ENABLE",
            "1",
            _switch,
            remedy="set FENCE_RADIUS and FENCE_ALT_MAX a little wider than the fleet's own fence, then FENCE_ENABLE to 1",
        ),
        ParameterRule(
            "FENCE_ACTION",
            "1 (return or land) or more",
            _one_of(ARDUPILOT_FENCE_ACTIONS, Judgement(OK)),
            _always(1.0),
        ),
        ParameterRule("MOT_THST_HOVER", NEAR_OURS, None, remedy=HOVER),
    ),
}
