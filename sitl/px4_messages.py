"""What the stand-in tells: one function per telemetry message, from the autopilot's own estimate."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, degrees, hypot, nan
from typing import TYPE_CHECKING

from companion.frames import (
    enu_from_geodetic,
    euler_ned_from_enu,
    frd_from_flu,
    geodetic_from_enu,
    ned_from_enu,
    quaternion_from_euler,
)
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types import Vector3
from sitl.px4_modes import NEED_A_PILOT

if TYPE_CHECKING:
    from sitl.px4 import Px4

M = mavlink
LANDED_ON_GROUND, LANDED_IN_AIR, LANDED_TAKEOFF, LANDED_LANDING = 1, 2, 3, 4
BATTERY_V, BATTERY_PERCENT = 16.2, 98


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


def local_position(px4: Px4) -> MavlinkMessage:
    position = ned_from_enu(px4.quad.estimated_position_local_enu_m())
    velocity = ned_from_enu(px4.quad.estimated_velocity_enu_m_s())
    return M.MAVLink_local_position_ned_message(px4.boot_ms, *position, *velocity)


def attitude(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_attitude_message(
        px4.boot_ms, *euler_ned_from_enu(*px4.quad.estimated_euler_rad()), *_rates_frd(px4)
    )


def attitude_quaternion(px4: Px4) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*px4.quad.estimated_euler_rad()))
    return M.MAVLink_attitude_quaternion_message(px4.boot_ms, *quaternion, *_rates_frd(px4))


def attitude_target(px4: Px4) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*px4.wanted_euler_rad()))
    return M.MAVLink_attitude_target_message(px4.boot_ms, 0, quaternion, 0.0, 0.0, 0.0, px4.setpoint.thrust_norm)


def odometry(px4: Px4) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*px4.quad.estimated_euler_rad()))
    return M.MAVLink_odometry_message(
        px4.boot_ms * 1000, M.MAV_FRAME_LOCAL_NED, M.MAV_FRAME_LOCAL_NED,
        *ned_from_enu(px4.quad.estimated_position_local_enu_m()), quaternion,
        *ned_from_enu(px4.quad.estimated_velocity_enu_m_s()), *_rates_frd(px4), [nan] * 21, [nan] * 21,
    )  # fmt: skip


def global_position(px4: Px4) -> MavlinkMessage:
    local = px4.quad.estimated_position_local_enu_m()
    latitude, longitude, altitude = geodetic_from_enu(local, px4.quad.origin)
    north, east, down = ned_from_enu(px4.quad.estimated_velocity_enu_m_s())
    return M.MAVLink_global_position_int_message(
        px4.boot_ms, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3),
        round((altitude - px4.home[2]) * 1e3), round(north * 100), round(east * 100), round(down * 100),
        _heading_cdeg(px4),
    )  # fmt: skip


def gps_raw(px4: Px4) -> MavlinkMessage:
    latitude, longitude, altitude = geodetic_from_enu(px4.quad.estimated_position_local_enu_m(), px4.quad.origin)
    x, y, _ = px4.quad.estimated_velocity_enu_m_s()
    course = round(degrees(atan2(x, y)) % 360.0 * 100) % 36000
    return M.MAVLink_gps_raw_int_message(
        px4.boot_ms * 1000, M.GPS_FIX_TYPE_3D_FIX, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3),
        90, 120, round(hypot(x, y) * 100), course, 14,
    )  # fmt: skip


def gps_global_origin(px4: Px4) -> MavlinkMessage:
    latitude, longitude, altitude = px4.quad.origin
    return M.MAVLink_gps_global_origin_message(
        round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), px4.boot_ms * 1000
    )


def home_position(px4: Px4) -> MavlinkMessage:
    latitude, longitude, altitude = px4.home
    local = ned_from_enu(enu_from_geodetic(latitude, longitude, altitude, px4.quad.origin))
    return M.MAVLink_home_position_message(
        round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), *local, [1.0, 0.0, 0.0, 0.0],
        0.0, 0.0, 0.0, px4.boot_ms * 1000,
    )  # fmt: skip


def extended_sys_state(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_extended_sys_state_message(0, px4.landed_state)


SENSORS = (
    M.MAV_SYS_STATUS_SENSOR_3D_GYRO | M.MAV_SYS_STATUS_SENSOR_3D_ACCEL | M.MAV_SYS_STATUS_SENSOR_3D_MAG
    | M.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE | M.MAV_SYS_STATUS_SENSOR_GPS | M.MAV_SYS_STATUS_AHRS
    | M.MAV_SYS_STATUS_SENSOR_BATTERY
)  # fmt: skip


def sys_status(px4: Px4) -> MavlinkMessage:
    healthy = SENSORS | (M.MAV_SYS_STATUS_PREARM_CHECK if px4.armable else 0)
    present = SENSORS | M.MAV_SYS_STATUS_PREARM_CHECK
    return M.MAVLink_sys_status_message(
        present, present, healthy, 250, round(BATTERY_V * 1000), 800, BATTERY_PERCENT, 0, 0, 0, 0, 0, 0
    )


def battery_status(_px4: Px4) -> MavlinkMessage:
    cells = [round(BATTERY_V / 4 * 1000)] * 4 + [65535] * 6
    return M.MAVLink_battery_status_message(0, 0, 1, 2500, cells, 800, 100, -1, BATTERY_PERCENT)


def vfr_hud(px4: Px4) -> MavlinkMessage:
    x, y, z = px4.quad.estimated_velocity_enu_m_s()
    speed = hypot(x, y)
    altitude = px4.quad.origin[2] + px4.quad.estimated_position_local_enu_m()[2]
    throttle = round(px4.setpoint.thrust_norm * 100) if px4.armed else 0
    return M.MAVLink_vfr_hud_message(speed, speed, _heading_cdeg(px4) // 100, throttle, altitude, z)


def altitude(px4: Px4) -> MavlinkMessage:
    up = px4.quad.estimated_position_local_enu_m()[2]
    amsl = px4.quad.origin[2] + up
    return M.MAVLink_altitude_message(px4.boot_ms * 1000, amsl, amsl, up, amsl - px4.home[2], nan, nan)


def estimator_status(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_estimator_status_message(px4.boot_ms * 1000, 0x3F, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.2)


def highres_imu(px4: Px4) -> MavlinkMessage:
    """Gyroscopes and specific force as they truly are; the other sensors are not modelled."""
    force = frd_from_flu(px4.quad.specific_force_m_s2)
    fields_updated = 0x3F
    return M.MAVLink_highres_imu_message(
        px4.boot_ms * 1000, *force, *_rates_frd(px4), 0.2, 0.0, 0.4, 0.0, 0.0, 0.0, 25.0, fields_updated
    )


def system_time(px4: Px4) -> MavlinkMessage:
    """Time since boot alone: there is no wall clock here."""
    return M.MAVLink_system_time_message(0, px4.boot_ms)


def ping(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_ping_message(px4.boot_ms * 1000, px4.boot_ms // 1000, 0, 0)


def timesync(px4: Px4) -> MavlinkMessage:
    return M.MAVLink_timesync_message(0, px4.boot_ms * 1_000_000)


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


def _rates_frd(px4: Px4) -> Vector3:
    return frd_from_flu(px4.quad.rates_rad_s)


def _heading_cdeg(px4: Px4) -> int:
    yaw_ned = euler_ned_from_enu(*px4.quad.estimated_euler_rad())[2]
    return round(degrees(yaw_ned) % 360.0 * 100) % 36000


BUILDERS: dict[int, Callable[[Px4], MavlinkMessage]] = {
    M.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    M.MAVLINK_MSG_ID_CURRENT_MODE: current_mode,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    M.MAVLINK_MSG_ID_ATTITUDE: attitude,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: attitude_target,
    M.MAVLINK_MSG_ID_ODOMETRY: odometry,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    M.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    M.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    M.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    M.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    M.MAVLINK_MSG_ID_ALTITUDE: altitude,
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    M.MAVLINK_MSG_ID_HIGHRES_IMU: highres_imu,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    M.MAVLINK_MSG_ID_PING: ping,
    M.MAVLINK_MSG_ID_TIMESYNC: timesync,
    M.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
}
