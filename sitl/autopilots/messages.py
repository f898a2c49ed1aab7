"""Telemetry messages: one function for each, from the autopilot's estimate; None for one without data yet."""

from __future__ import annotations

import struct
from collections.abc import Callable
from math import atan2, degrees, hypot, nan
from zlib import crc32

from pymavlink.dialects.v20.ardupilotmega import MAVLINK_MSG_ID_EKF_STATUS_REPORT, MAVLink_ekf_status_report_message

from companion.geometry.frames import (
    enu_from_geodetic,
    euler_ned_from_enu,
    frd_from_flu,
    ned_from_enu,
    quaternion_from_euler,
)
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.values import Vector3
from sitl.autopilots.autopilot import Autopilot

M = mavlink
BATTERY_V = 16.2
NO_MISSION = 65535  # instead of the number of its items
ESTIMATES = (
    M.ESTIMATOR_ATTITUDE | M.ESTIMATOR_VELOCITY_HORIZ | M.ESTIMATOR_VELOCITY_VERT | M.ESTIMATOR_POS_HORIZ_REL
    | M.ESTIMATOR_POS_HORIZ_ABS | M.ESTIMATOR_POS_VERT_ABS | M.ESTIMATOR_POS_VERT_AGL
    | M.ESTIMATOR_PRED_POS_HORIZ_REL | M.ESTIMATOR_PRED_POS_HORIZ_ABS
)  # fmt: skip
# PX4 that has lost vision, as measured: 0.07 m after 1 s, 0.6 m after 3 s; flags 101 at last.
UNAIDED_AFTER_S, REPORTED_DRIFT_M_S2, WITHOUT_POSITION = 0.5, 0.067, 101
EKF_READY, EKF_WITHOUT_POSITION, EKF_WITHOUT_VISION = 831, 167, 37
COMPASS_VARIANCE_1_DEG = 0.028  # 0.28 for a yaw that is wrong by 10 degrees, 2.5 for 90
NEAR_GROUND_M = 0.5
RELEASE = 255  # FIRMWARE_VERSION_TYPE

Builder = Callable[[Autopilot], MavlinkMessage | None]


def heartbeat(autopilot: Autopilot) -> MavlinkMessage:
    mode = autopilot.mode
    flags = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | M.MAV_MODE_FLAG_STABILIZE_ENABLED | mode.flags
    flags |= M.MAV_MODE_FLAG_SAFETY_ARMED if autopilot.armed else 0
    return M.MAVLink_heartbeat_message(
        M.MAV_TYPE_QUADROTOR, autopilot.data.mav_autopilot, flags, mode.custom_mode, autopilot.reported_status, 3
    )


def current_mode(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_current_mode_message(0, autopilot.mode.custom_mode, autopilot.intended_mode.custom_mode)


def local_position(autopilot: Autopilot) -> MavlinkMessage | None:
    if not autopilot.reports_position:
        return None
    position_enu_m, velocity_enu_m_s = autopilot.local_state()
    return M.MAVLink_local_position_ned_message(
        autopilot.boot_ms, *ned_from_enu(position_enu_m), *ned_from_enu(velocity_enu_m_s)
    )


def attitude(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_attitude_message(
        autopilot.boot_ms, *euler_ned_from_enu(*autopilot.quad.estimated_euler_rad()), *rates_frd(autopilot)
    )


def attitude_quaternion(autopilot: Autopilot) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*autopilot.quad.estimated_euler_rad()))
    return M.MAVLink_attitude_quaternion_message(autopilot.boot_ms, *quaternion, *rates_frd(autopilot))


def attitude_target(autopilot: Autopilot) -> MavlinkMessage:
    """ATTITUDE_TARGET with the commanded thrust, before any compensation of the tilt."""
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*autopilot.wanted_euler_rad()))
    return M.MAVLink_attitude_target_message(
        autopilot.boot_ms, 0, quaternion, 0.0, 0.0, 0.0, autopilot.commanded_thrust_norm
    )


def odometry(autopilot: Autopilot) -> MavlinkMessage:
    position_enu_m, velocity_enu_m_s = autopilot.local_state()
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*autopilot.quad.estimated_euler_rad()))
    return M.MAVLink_odometry_message(
        autopilot.boot_ms * 1000, M.MAV_FRAME_LOCAL_NED, M.MAV_FRAME_LOCAL_NED,
        *ned_from_enu(position_enu_m), quaternion, *ned_from_enu(velocity_enu_m_s), *rates_frd(autopilot),
        [nan] * 21, [nan] * 21,
    )  # fmt: skip


def altitude(autopilot: Autopilot) -> MavlinkMessage:
    up = autopilot.quad.estimated_position_local_enu_m()[2]
    amsl = autopilot.quad.origin[2] + up if autopilot.reports_globally else nan
    return M.MAVLink_altitude_message(autopilot.boot_ms * 1000, amsl, amsl, up, amsl - autopilot.home[2], nan, nan)


def estimator_status(autopilot: Autopilot) -> MavlinkMessage:
    """PX4 calls the position of a vehicle that rests on the ground constant, however good it is."""
    flags = estimates(autopilot) | (M.ESTIMATOR_CONST_POS_MODE if autopilot.at_rest else 0)
    lost_s, (horizontal_m, vertical_m) = autopilot.position_lost_s, autopilot.quad.reported_error_m
    if lost_s > UNAIDED_AFTER_S:
        flags &= ~M.ESTIMATOR_PRED_POS_HORIZ_REL if autopilot.has_position else WITHOUT_POSITION
    horizontal_m += REPORTED_DRIFT_M_S2 * lost_s * lost_s
    position_ratio = autopilot.vision.position_ratio if autopilot.vision else 0.1
    return M.MAVLink_estimator_status_message(
        autopilot.boot_ms * 1000, flags, 0.1, position_ratio, 0.1, 0.1, 0.1, 0.1, horizontal_m, vertical_m
    )


def estimates(autopilot: Autopilot) -> int:
    """What PX4 estimates, by GPS or vision."""
    if autopilot.vision is None:
        return ESTIMATES
    if not autopilot.vision.fixed:
        return WITHOUT_POSITION
    flags = ESTIMATES & ~M.ESTIMATOR_PRED_POS_HORIZ_ABS
    if not autopilot.has_origin:
        flags &= ~M.ESTIMATOR_POS_HORIZ_ABS
    if autopilot.armed and autopilot.quad.height_m < NEAR_GROUND_M:
        flags &= ~M.ESTIMATOR_POS_VERT_AGL
    return int(flags)


def ekf_status_report(autopilot: Autopilot) -> MavlinkMessage:
    """Square roots of the innovation test ratios, 1 is the gate; small, as measured in a hover."""
    flags, vision = EKF_READY if autopilot.has_position else EKF_WITHOUT_POSITION, autopilot.vision
    if vision is not None:
        lost = vision.fixed and not autopilot.has_position
        compass = COMPASS_VARIANCE_1_DEG * degrees(vision.yaw_off_rad)
        return MAVLink_ekf_status_report_message(EKF_WITHOUT_VISION if lost else flags, 0.0, 0.0, 0.0, compass, 0.0)
    return MAVLink_ekf_status_report_message(flags, 0.02, 0.02, 0.02, 0.02, 0.0)


def global_position(autopilot: Autopilot) -> MavlinkMessage | None:
    if not autopilot.reports_globally:
        zeros = M.MAVLink_global_position_int_message(autopilot.boot_ms, 0, 0, 0, 0, 0, 0, 0, 0)
        return zeros if autopilot.data.external_vision.sends_zeros else None
    latitude, longitude, altitude = autopilot.here_geodetic()
    north, east, down = ned_from_enu(autopilot.quad.estimated_velocity_enu_m_s())
    return M.MAVLink_global_position_int_message(
        autopilot.boot_ms, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3),
        round((altitude - autopilot.home[2]) * 1e3), round(north * 100), round(east * 100), round(down * 100),
        heading_cdeg(autopilot),
    )  # fmt: skip


def gps_raw(autopilot: Autopilot) -> MavlinkMessage | None:
    if autopilot.vision is not None:
        no_gps = M.MAVLink_gps_raw_int_message(0, M.GPS_FIX_TYPE_NO_GPS, 0, 0, 0, 65535, 65535, 0, 0, 0, 0, 0, 0)
        return no_gps if autopilot.data.external_vision.sends_zeros else None
    latitude, longitude, altitude = autopilot.here_geodetic()
    x, y, _ = autopilot.quad.estimated_velocity_enu_m_s()
    course = round(degrees(atan2(x, y)) % 360.0 * 100) % 36000
    horizontal_mm, vertical_mm = (max(1, round(error_m * 1e3)) for error_m in autopilot.quad.reported_error_m)
    fix, satellites = M.GPS_FIX_TYPE_3D_FIX, 14
    if autopilot.loss and autopilot.loss.receiver == "jammed":
        fix, satellites, horizontal_mm, vertical_mm = M.GPS_FIX_TYPE_NO_FIX, 3, 2**32 - 1, 2**32 - 1
    elif autopilot.loss:
        fix, satellites, horizontal_mm, vertical_mm = M.GPS_FIX_TYPE_NO_GPS, 0, 0, 0
    return M.MAVLink_gps_raw_int_message(
        autopilot.boot_ms * 1000, fix, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3),
        90, 120, round(hypot(x, y) * 100), course, satellites, round(altitude * 1e3), horizontal_mm, vertical_mm,
    )  # fmt: skip


def gps_global_origin(autopilot: Autopilot) -> MavlinkMessage | None:
    if not autopilot.has_origin:
        return None
    latitude, longitude, altitude = autopilot.quad.origin
    return M.MAVLink_gps_global_origin_message(
        round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), autopilot.boot_ms * 1000
    )


def home_position(autopilot: Autopilot) -> MavlinkMessage | None:
    if not autopilot.has_origin:
        return None
    latitude, longitude, altitude = autopilot.home
    local = ned_from_enu(enu_from_geodetic(latitude, longitude, altitude, autopilot.quad.origin))
    return M.MAVLink_home_position_message(
        round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), *local, [1.0, 0.0, 0.0, 0.0],
        0.0, 0.0, 0.0, autopilot.boot_ms * 1000,
    )  # fmt: skip


class MissionCurrent(M.MAVLink_message):
    """MISSION_CURRENT with its newest extensions, the ids of the stored plans, which pymavlink's definition lacks."""

    def __init__(self, rally_points_id: int) -> None:
        super().__init__(M.MAVLINK_MSG_ID_MISSION_CURRENT, "MISSION_CURRENT")
        self._content = struct.pack("<HHBBIII", 0, NO_MISSION, 0, 0, 0, 0, rally_points_id)

    def pack(self, mav: M.MAVLink, force_mavlink1: bool = False) -> bytes:
        return self._pack(mav, M.mavlink_map[M.MAVLINK_MSG_ID_MISSION_CURRENT].crc_extra, self._content, force_mavlink1)


def mission_current(autopilot: Autopilot) -> MavlinkMessage:
    """There is no mission; the id of the rally points is a checksum of them."""
    places = ",".join(f"{latitude:.7f} {longitude:.7f}" for latitude, longitude, _ in autopilot.rally_points)
    return MissionCurrent(crc32(places.encode()))


def extended_sys_state(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_extended_sys_state_message(0, autopilot.landed_state)


def system_time(autopilot: Autopilot) -> MavlinkMessage:
    """Time since boot only: the stand-in has no wall clock."""
    return M.MAVLink_system_time_message(0, autopilot.boot_ms)


def sys_status(autopilot: Autopilot) -> MavlinkMessage:
    sensors = autopilot.data.armed if autopilot.armed else autopilot.data.disarmed
    healthy = sensors.healthy | (M.MAV_SYS_STATUS_PREARM_CHECK if autopilot.armable else 0)
    return M.MAVLink_sys_status_message(
        sensors.present, sensors.enabled, healthy,
        250, round(BATTERY_V * 1000), 800, autopilot.battery_percent, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def battery_status(autopilot: Autopilot) -> MavlinkMessage:
    cells = [round(BATTERY_V / 4 * 1000)] * 4 + [65535] * 6
    return M.MAVLink_battery_status_message(0, 0, 1, 2500, cells, 800, 100, -1, autopilot.battery_percent)


def vfr_hud(autopilot: Autopilot) -> MavlinkMessage:
    x, y, z = autopilot.quad.estimated_velocity_enu_m_s()
    speed = hypot(x, y)
    altitude = autopilot.quad.origin[2] + autopilot.quad.estimated_position_local_enu_m()[2]
    throttle = round(autopilot.setpoint.thrust_norm * 100) if autopilot.armed else 0
    return M.MAVLink_vfr_hud_message(speed, speed, heading_cdeg(autopilot) // 100, throttle, altitude, z)


def highres_imu(autopilot: Autopilot) -> MavlinkMessage:
    """True body rates and specific force; the other sensors are not modelled."""
    force = frd_from_flu(autopilot.quad.specific_force_m_s2)
    fields_updated = 0x3F
    return M.MAVLink_highres_imu_message(
        autopilot.boot_ms * 1000, *force, *rates_frd(autopilot), 0.2, 0.0, 0.4, 0.0, 0.0, 0.0, 25.0, fields_updated
    )


def timesync(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_timesync_message(0, autopilot.boot_ms * 1_000_000)


def ping(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_ping_message(autopilot.boot_ms * 1000, autopilot.boot_ms // 1000, 0, 0)


def autopilot_version(autopilot: Autopilot) -> MavlinkMessage:
    data = autopilot.data
    capabilities = sum({getattr(M, f"MAV_PROTOCOL_CAPABILITY_{name}") for name in data.capabilities})
    major, minor, patch = data.version
    version = major << 24 | minor << 16 | patch << 8 | RELEASE
    return M.MAVLink_autopilot_version_message(
        capabilities, version, version, 0, 0, b"\0" * 8, b"\0" * 8, b"\0" * 8, 0, 0, data.uid | autopilot.system_id
    )


def rates_frd(autopilot: Autopilot) -> Vector3:
    return frd_from_flu(autopilot.quad.rates_rad_s)


def heading_cdeg(autopilot: Autopilot) -> int:
    yaw_ned = euler_ned_from_enu(*autopilot.quad.estimated_euler_rad())[2]
    return round(degrees(yaw_ned) % 360.0 * 100) % 36000


BUILDERS: dict[int, Builder] = {
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
    M.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    M.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    M.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    M.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    M.MAVLINK_MSG_ID_ALTITUDE: altitude,
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report,
    M.MAVLINK_MSG_ID_HIGHRES_IMU: highres_imu,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    M.MAVLINK_MSG_ID_PING: ping,
    M.MAVLINK_MSG_ID_TIMESYNC: timesync,
    M.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
}
"""The messages of all autopilot types; the data of each names those that it sends."""
