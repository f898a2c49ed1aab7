"""Messages that only ArduCopter sends, and the builders of all its messages; None for one without data yet."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20.ardupilotmega import MAVLINK_MSG_ID_EKF_STATUS_REPORT, MAVLink_ekf_status_report_message

from companion.geometry.frames import euler_ned_from_enu, quaternion_from_euler
from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots import messages as shared
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.modes import REPORTED_AS_GUIDED

M = mavlink
# As recorded of ArduCopter 4.5 in SITL. Armed: motors, position and altitude control are enabled.
PRESENT = 0x5371FC2F
DISARMED = shared.SensorBits(PRESENT, enabled=0x52619C2F, healthy=0x47719C2F)
ARMED = shared.SensorBits(PRESENT, enabled=0x5361FC2F, healthy=0x4771FC2F)
EKF_READY, EKF_WITHOUT_POSITION = 831, 167
VERSION = (4 << 24) | (6 << 16) | (2 << 8) | 255  # 4.6.2, release

Builder = Callable[[ArduCopter], MavlinkMessage | None]


def heartbeat(copter: ArduCopter) -> MavlinkMessage:
    base = (
        M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | M.MAV_MODE_FLAG_STABILIZE_ENABLED | M.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    base |= M.MAV_MODE_FLAG_GUIDED_ENABLED if copter.mode in REPORTED_AS_GUIDED else 0
    base |= M.MAV_MODE_FLAG_SAFETY_ARMED if copter.armed else 0
    return M.MAVLink_heartbeat_message(
        M.MAV_TYPE_QUADROTOR, M.MAV_AUTOPILOT_ARDUPILOTMEGA, base, copter.mode.custom_mode, copter.system_status, 3
    )


def local_position(copter: ArduCopter) -> MavlinkMessage | None:
    return shared.local_position(copter) if copter.has_position else None


def gps_global_origin(copter: ArduCopter) -> MavlinkMessage | None:
    return shared.gps_global_origin(copter) if copter.start.has_origin(copter.time_s) else None


def home_position(copter: ArduCopter) -> MavlinkMessage | None:
    return shared.home_position(copter) if copter.start.has_origin(copter.time_s) else None


def attitude_target(copter: ArduCopter) -> MavlinkMessage:
    """ATTITUDE_TARGET with the commanded thrust, before the compensation of the tilt."""
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*copter.wanted_euler_rad()))
    return M.MAVLink_attitude_target_message(copter.boot_ms, 0, quaternion, 0.0, 0.0, 0.0, copter.throttle_norm)


def sys_status(copter: ArduCopter) -> MavlinkMessage:
    return shared.sys_status(copter, ARMED if copter.armed else DISARMED)


def ekf_status_report(copter: ArduCopter) -> MavlinkMessage:
    """Square roots of the innovation test ratios, 1 is the gate; small, as measured in a hover."""
    flags = EKF_READY if copter.has_position else EKF_WITHOUT_POSITION
    return MAVLink_ekf_status_report_message(flags, 0.02, 0.02, 0.02, 0.02, 0.0)


def autopilot_version(copter: ArduCopter) -> MavlinkMessage:
    capabilities = (
        M.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT | M.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | M.MAV_PROTOCOL_CAPABILITY_MISSION_INT | M.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | M.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED | M.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | M.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | M.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | M.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    )  # fmt: skip
    return M.MAVLink_autopilot_version_message(
        capabilities,
        VERSION,
        VERSION,
        0,
        0,
        b"\0" * 8,
        b"\0" * 8,
        b"\0" * 8,
        0,
        0,
        0xA7D0000000000000 | copter.system_id,
    )


BUILDERS: dict[int, Builder] = {
    M.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    M.MAVLINK_MSG_ID_ATTITUDE: shared.attitude,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: shared.attitude_quaternion,
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: attitude_target,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: shared.global_position,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: shared.gps_raw,
    M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    M.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: shared.extended_sys_state,
    M.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    M.MAVLINK_MSG_ID_BATTERY_STATUS: shared.battery_status,
    M.MAVLINK_MSG_ID_VFR_HUD: shared.vfr_hud,
    M.MAVLINK_MSG_ID_HIGHRES_IMU: shared.highres_imu,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: shared.system_time,
    M.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report,
}
