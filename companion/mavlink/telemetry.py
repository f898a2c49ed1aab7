"""MAVLink messages -> Telemetry in ENU, FLU and SI units. The same for every autopilot.

The most frequent ones are read from their numbers in the order on the wire (`Packet.values`), which saves the message object.

Floats of 32 bits are rounded below what a sensor resolves: as floats of 64 bits they have ten digits more that mean nothing,
and a recording would keep them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import isfinite, nan

from companion.geometry.frames import enu_from_ned, euler_enu_from_ned, euler_from_quaternion
from companion.geometry.vectors import rounded
from companion.mavlink.clock import AutopilotClock
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.mavlink.dialect import ANSWERS
from companion.types.autopilot import (
    AckSample,
    AttitudeSample,
    AutopilotKind,
    EstimatorSample,
    GlobalPositionSample,
    HeartbeatSample,
    HomeSample,
    LandedSample,
    LandedState,
    OriginSample,
    PositionAid,
    PositionSample,
    RallySample,
    SystemSample,
    TextSample,
)
from companion.types.values import printable

RESULT_TEXTS = {
    mavlink.MAV_RESULT_ACCEPTED: "accepted",
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "not supported",
    mavlink.MAV_RESULT_FAILED: "failed",
    mavlink.MAV_RESULT_IN_PROGRESS: "in progress",
}

# Flags of ESTIMATOR_STATUS: what must be good, and of which one must be. ESTIMATOR_CONST_POS_MODE says nothing about that: PX4
# sets it on every vehicle that rests on the ground, and without a position it clears those of the position.
ESTIMATES = (
    mavlink.ESTIMATOR_ATTITUDE
    | mavlink.ESTIMATOR_VELOCITY_HORIZ
    | mavlink.ESTIMATOR_VELOCITY_VERT
    | mavlink.ESTIMATOR_POS_VERT_ABS
)
LENGTH_DECIMALS = 4  # 0.1 mm, 0.1 mm/s
ANGLE_DECIMALS = 5  # 10 urad, 0.0006 degrees
POSITIONS = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS

FAILSAFE_STATES = (mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY, mavlink.MAV_STATE_FLIGHT_TERMINATION)
# ArduCopter: "Battery Failsafe", "EKF variance", "Battery 1 is low 10.50V used 900 mAh"; PX4: "Failsafe activated", "Critical
# battery level". Those that end one are "EKF Failsafe Cleared", "Failsafe mode deactivated".
BEGINS_FAILSAFE = re.compile(
    r"failsafe|ekf variance|(low|critical|emergency) battery|battery \d+ is (low|critical)", re.IGNORECASE
)
ENDS_FAILSAFE = re.compile(r"clear|deactivat|disabled|prearm", re.IGNORECASE)
RALLY_POINTS_ID = slice(14, 18)  # bytes of MISSION_CURRENT

LANDED_STATES = {int(state): state for state in LandedState}


def position(values: Sequence[float], received_s: float, clock: AutopilotClock) -> PositionSample:
    """LOCAL_POSITION_NED. Its numbers may be NaN; `VehicleTracker` refuses those."""
    boot_ms, north_m, east_m, down_m, north_m_s, east_m_s, down_m_s = values
    return PositionSample(
        received_s,
        boot_ms / 1000.0,
        rounded(enu_from_ned((north_m, east_m, down_m)), LENGTH_DECIMALS),
        rounded(enu_from_ned((north_m_s, east_m_s, down_m_s)), LENGTH_DECIMALS),
        clock.late_s(boot_ms / 1000.0, received_s),
    )


def attitude(values: Sequence[float], received_s: float) -> AttitudeSample | None:
    """ATTITUDE_QUATERNION; None where the quaternion is not a rotation."""
    _, w, x, y, z, *_ = values
    if not all(map(isfinite, (w, x, y, z))):
        return None
    try:
        euler_ned = euler_from_quaternion((w, x, y, z))
    except ValueError:
        return None
    return AttitudeSample(received_s, *rounded(euler_enu_from_ned(*euler_ned), ANGLE_DECIMALS))


def heartbeat(
    message: MavlinkMessage, autopilot: AutopilotKind, received_s: float, interleaves: bool
) -> HeartbeatSample:
    """Armed flag and state of HEARTBEAT, from an autopilot of this make, or from two in turn."""
    armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    return HeartbeatSample(received_s, armed, autopilot, message.system_status in FAILSAFE_STATES, interleaves)


def landed(message: MavlinkMessage, received_s: float) -> LandedSample:
    """EXTENDED_SYS_STATE; an unknown landed_state is UNDEFINED."""
    return LandedSample(received_s, LANDED_STATES.get(message.landed_state, LandedState.UNDEFINED))


def origin(message: MavlinkMessage, received_s: float) -> OriginSample:
    """GPS_GLOBAL_ORIGIN, degrees in 1e-7 (about 1 cm) and altitude in mm."""
    return OriginSample(received_s, message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)


def home(message: MavlinkMessage, received_s: float) -> HomeSample:
    """HOME_POSITION, degrees in 1e-7."""
    return HomeSample(received_s, message.latitude / 1e7, message.longitude / 1e7)


def rally_points(payload: bytes, received_s: float) -> RallySample:
    """MISSION_CURRENT, which PX4 sends once a second: the id of its rally points is their checksum, 0 without any.

    It is the last of the extensions of this message that pymavlink's definition lacks; zeros at the end are not sent.
    """
    return RallySample(received_s, any(payload[RALLY_POINTS_ID]))


def system(message: MavlinkMessage, received_s: float) -> SystemSample:
    """SYS_STATUS. PX4 enables the bit of the estimator only where it is bad, ArduCopter 10 s after the estimator has begun."""
    healthy = message.onboard_control_sensors_health
    may_arm = bool(healthy & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
    judged = message.onboard_control_sensors_enabled & mavlink.MAV_SYS_STATUS_AHRS
    estimator_healthy = not judged or bool(healthy & mavlink.MAV_SYS_STATUS_AHRS)
    return SystemSample(received_s, float(message.battery_remaining), may_arm, estimator_healthy)


def global_position(message: MavlinkMessage, received_s: float) -> GlobalPositionSample:
    """GLOBAL_POSITION_INT, degrees in 1e-7 and altitude in mm; same clock as LOCAL_POSITION_NED."""
    return GlobalPositionSample(
        received_s, message.time_boot_ms / 1000.0, message.lat / 1e7, message.lon / 1e7, message.alt / 1e3
    )


def estimator_status(message: MavlinkMessage, received_s: float) -> EstimatorSample:
    """ESTIMATOR_STATUS, with accuracies of one sigma; the horizontal one covers both axes. Flags of 0 are not reported.

    PX4 clears the prediction of the relative position 0.5 s after it has lost external vision, the others 4 s later.
    """
    flags = message.flags
    usable = flags & ESTIMATES == ESTIMATES and flags & POSITIONS
    horizontal_m = round(message.pos_horiz_accuracy, LENGTH_DECIMALS)
    vertical_m = round(message.pos_vert_accuracy, LENGTH_DECIMALS)
    if not flags:
        return EstimatorSample(received_s, horizontal_m, vertical_m)
    aid = PositionAid.USED if flags & mavlink.ESTIMATOR_PRED_POS_HORIZ_REL else PositionAid.NOT_USED
    return EstimatorSample(received_s, horizontal_m, vertical_m, bool(usable), aid)


def gps_error(message: MavlinkMessage, received_s: float) -> EstimatorSample:
    """GPS_RAW_INT accuracies, in mm, 0 where unknown. For autopilots that do not report the error of their estimator.

    Receivers without a fix report 2^32 - 1 mm.
    """
    known = message.h_acc > 0 and message.v_acc > 0
    horizontal_m, vertical_m = (message.h_acc / 1e3, message.v_acc / 1e3) if known else (nan, nan)
    aid = PositionAid.FIX if message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX else PositionAid.NO_FIX
    return EstimatorSample(received_s, horizontal_m, vertical_m, aid=aid)


def acknowledgement(message: MavlinkMessage, received_s: float) -> AckSample:
    """COMMAND_ACK, with the command and the result as text."""
    accepted = message.result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
    entry = mavlink.enums["MAV_CMD"].get(message.command)
    name = entry.name.removeprefix("MAV_CMD_") if entry else f"command {message.command}"
    result = RESULT_TEXTS.get(message.result, f"result {message.result}")
    return AckSample(received_s, ANSWERS.get(message.command, ()), accepted, f"{name} {result}")


class TextAssembler:
    """Joins chunks of STATUSTEXT: 50 characters each, with a common id; a shorter chunk is the last."""

    def __init__(self) -> None:
        self._id = 0
        self._chunks: list[str] = []

    def add(self, message: MavlinkMessage, received_s: float) -> TextSample | None:
        """The whole text when its last chunk arrives, else None. A text with a lost chunk is dropped."""
        chunk: str = message.text
        if message.id == 0:
            return _text(message.severity, chunk, received_s)
        if message.chunk_seq == 0:
            self._id, self._chunks = message.id, []
        if message.id != self._id or message.chunk_seq != len(self._chunks):
            return None
        self._chunks.append(chunk)
        if len(chunk) >= 50:
            return None
        return _text(message.severity, "".join(self._chunks), received_s)


def _text(severity: int, received: str, received_s: float) -> TextSample:
    text = printable(received.strip())
    bad = severity <= mavlink.MAV_SEVERITY_WARNING
    failsafe = bad and bool(BEGINS_FAILSAFE.search(text)) and not ENDS_FAILSAFE.search(text)
    return TextSample(received_s, severity, text, failsafe)
