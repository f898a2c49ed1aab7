"""Messages that only PX4 sends, and the builders of all its messages."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

from companion.geometry.frames import euler_ned_from_enu, ned_from_enu, quaternion_from_euler
from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots import messages as shared
from sitl.autopilots.px4.autopilot import NEED_A_PILOT, Px4

M = mavlink
ESTIMATES = (
    M.ESTIMATOR_ATTITUDE | M.ESTIMATOR_VELOCITY_HORIZ | M.ESTIMATOR_VELOCITY_VERT | M.ESTIMATOR_POS_HORIZ_REL
    | M.ESTIMATOR_POS_HORIZ_ABS | M.ESTIMATOR_POS_VERT_ABS | M.ESTIMATOR_POS_VERT_AGL
    | M.ESTIMATOR_PRED_POS_HORIZ_REL | M.ESTIMATOR_PRED_POS_HORIZ_ABS
)  # fmt: skip
# Recorded of PX4 v1.16 in SIH. The attitude estimate (AHRS) is neither present nor enabled while it is good, the arming checks
# never are. Without a transmitter the receiver is enabled and not healthy.
PRESENT = (
    M.MAV_SYS_STATUS_SENSOR_3D_GYRO | M.MAV_SYS_STATUS_SENSOR_3D_ACCEL | M.MAV_SYS_STATUS_SENSOR_3D_MAG
    | M.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE | M.MAV_SYS_STATUS_SENSOR_GPS
    | M.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL | M.MAV_SYS_STATUS_SENSOR_BATTERY
)  # fmt: skip
SENSORS = shared.SensorBits(
    present=PRESENT,
    enabled=PRESENT | M.MAV_SYS_STATUS_SENSOR_RC_RECEIVER,
    healthy=PRESENT | M.MAV_SYS_STATUS_AHRS | M.MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE
    | M.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION | M.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS | M.MAV_SYS_STATUS_LOGGING,
)  # fmt: skip


def heartbeat(px4: Px4) -> MavlinkMessage:
    base = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | M.MAV_MODE_FLAG_STABILIZE_ENABLED
    if px4.mode.is_auto:
        base |= M.MAV_MODE_FLAG_AUTO_ENABLED | M.MAV_MODE_FLAG_GUIDED_ENABLED
    elif px4.mode in NEED_A_PILOT:
        base |= M.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    base |= M.MAV_MODE_FLAG_SAFETY_ARMED if px4.armed else 0
    return M.MAVLink_heartbeat_message(
        M.MAV_TYPE_QUADROTOR, M.MAV_AUTOPILOT_PX4, base, px4.mode.custom_mode, px4.system_status, 3
    )


def current_mode(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_current_mode_message(0, px4.mode.custom_mode, px4.intended_mode.custom_mode)


def attitude_target(px4: Px4) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*px4.wanted_euler_rad()))
    return M.MAVLink_attitude_target_message(px4.boot_ms, 0, quaternion, 0.0, 0.0, 0.0, px4.setpoint.thrust_norm)


def odometry(px4: Px4) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*px4.quad.estimated_euler_rad()))
    return M.MAVLink_odometry_message(
        px4.boot_ms * 1000, M.MAV_FRAME_LOCAL_NED, M.MAV_FRAME_LOCAL_NED,
        *ned_from_enu(px4.quad.estimated_position_local_enu_m()), quaternion,
        *ned_from_enu(px4.quad.estimated_velocity_enu_m_s()), *shared.rates_frd(px4), [nan] * 21, [nan] * 21,
    )  # fmt: skip


def altitude(px4: Px4) -> MavlinkMessage:
    up = px4.quad.estimated_position_local_enu_m()[2]
    amsl = px4.quad.origin[2] + up
    return M.MAVLink_altitude_message(px4.boot_ms * 1000, amsl, amsl, up, amsl - px4.home[2], nan, nan)


def estimator_status(px4: Px4) -> MavlinkMessage:
    """PX4 calls the position of a vehicle that rests on the ground constant, however good it is."""
    flags = ESTIMATES | (M.ESTIMATOR_CONST_POS_MODE if px4.at_rest else 0)
    return M.MAVLink_estimator_status_message(
        px4.boot_ms * 1000, flags, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, *px4.quad.reported_error_m
    )


def sys_status(px4: Px4) -> MavlinkMessage:
    return shared.sys_status(px4, SENSORS)


def ping(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_ping_message(px4.boot_ms * 1000, px4.boot_ms // 1000, 0, 0)


def autopilot_version(px4: Px4) -> MavlinkMessage:
    capabilities = (
        M.MAV_PROTOCOL_CAPABILITY_MISSION_INT | M.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | M.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET | M.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | M.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED | M.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | M.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | M.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    )  # fmt: skip
    version = (1 << 24) | (16 << 16) | 255  # 1.16.0, release
    return M.MAVLink_autopilot_version_message(
        capabilities, version, version, 0, 0, b"\0" * 8, b"\0" * 8, b"\0" * 8, 0, 0, 0x5117000000000000 | px4.system_id
    )


BUILDERS: dict[int, Callable[[Px4], MavlinkMessage]] = {
    M.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    M.MAVLINK_MSG_ID_CURRENT_MODE: current_mode,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: shared.local_position,
    M.MAVLINK_MSG_ID_ATTITUDE: shared.attitude,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: shared.attitude_quaternion,
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: attitude_target,
    M.MAVLINK_MSG_ID_ODOMETRY: odometry,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: shared.global_position,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: shared.gps_raw,
    M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: shared.gps_global_origin,
    M.MAVLINK_MSG_ID_HOME_POSITION: shared.home_position,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: shared.extended_sys_state,
    M.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    M.MAVLINK_MSG_ID_BATTERY_STATUS: shared.battery_status,
    M.MAVLINK_MSG_ID_VFR_HUD: shared.vfr_hud,
    M.MAVLINK_MSG_ID_ALTITUDE: altitude,
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    M.MAVLINK_MSG_ID_HIGHRES_IMU: shared.highres_imu,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: shared.system_time,
    M.MAVLINK_MSG_ID_PING: ping,
    M.MAVLINK_MSG_ID_TIMESYNC: shared.timesync,
    M.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
}
