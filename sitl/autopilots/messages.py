"""Telemetry messages that all makes send alike: one function per message, from the autopilot's estimate."""

from __future__ import annotations

from math import atan2, degrees, hypot
from typing import NamedTuple

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
LANDED_ON_GROUND, LANDED_IN_AIR, LANDED_TAKEOFF, LANDED_LANDING = 1, 2, 3, 4
BATTERY_V = 16.2


def local_position(autopilot: Autopilot) -> MavlinkMessage:
    position = ned_from_enu(autopilot.quad.estimated_position_local_enu_m())
    velocity = ned_from_enu(autopilot.quad.estimated_velocity_enu_m_s())
    return M.MAVLink_local_position_ned_message(autopilot.boot_ms, *position, *velocity)


def attitude(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_attitude_message(
        autopilot.boot_ms, *euler_ned_from_enu(*autopilot.quad.estimated_euler_rad()), *rates_frd(autopilot)
    )


def attitude_quaternion(autopilot: Autopilot) -> MavlinkMessage:
    quaternion = quaternion_from_euler(*euler_ned_from_enu(*autopilot.quad.estimated_euler_rad()))
    return M.MAVLink_attitude_quaternion_message(autopilot.boot_ms, *quaternion, *rates_frd(autopilot))


def global_position(autopilot: Autopilot) -> MavlinkMessage:
    latitude, longitude, altitude = autopilot.here_geodetic()
    north, east, down = ned_from_enu(autopilot.quad.estimated_velocity_enu_m_s())
    return M.MAVLink_global_position_int_message(
        autopilot.boot_ms, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3),
        round((altitude - autopilot.home[2]) * 1e3), round(north * 100), round(east * 100), round(down * 100),
        heading_cdeg(autopilot),
    )  # fmt: skip


def gps_raw(autopilot: Autopilot) -> MavlinkMessage:
    latitude, longitude, altitude = autopilot.here_geodetic()
    x, y, _ = autopilot.quad.estimated_velocity_enu_m_s()
    course = round(degrees(atan2(x, y)) % 360.0 * 100) % 36000
    horizontal_mm, vertical_mm = (max(1, round(error_m * 1e3)) for error_m in autopilot.quad.reported_error_m)
    return M.MAVLink_gps_raw_int_message(
        autopilot.boot_ms * 1000, M.GPS_FIX_TYPE_3D_FIX, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3),
        90, 120, round(hypot(x, y) * 100), course, 14, round(altitude * 1e3), horizontal_mm, vertical_mm,
    )  # fmt: skip


def gps_global_origin(autopilot: Autopilot) -> MavlinkMessage:
    latitude, longitude, altitude = autopilot.quad.origin
    return M.MAVLink_gps_global_origin_message(
        round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), autopilot.boot_ms * 1000
    )


def home_position(autopilot: Autopilot) -> MavlinkMessage:
    latitude, longitude, altitude = autopilot.home
    local = ned_from_enu(enu_from_geodetic(latitude, longitude, altitude, autopilot.quad.origin))
    return M.MAVLink_home_position_message(
        round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), *local, [1.0, 0.0, 0.0, 0.0],
        0.0, 0.0, 0.0, autopilot.boot_ms * 1000,
    )  # fmt: skip


def extended_sys_state(autopilot: Autopilot) -> MavlinkMessage:
    return M.MAVLink_extended_sys_state_message(0, autopilot.landed_state)


class SensorBits(NamedTuple):
    """Bits of SYS_STATUS but for the arming checks in `healthy`."""

    present: int
    enabled: int
    healthy: int


def system_time(autopilot: Autopilot) -> MavlinkMessage:
    """Time since boot only: the stand-in has no wall clock."""
    return M.MAVLink_system_time_message(0, autopilot.boot_ms)


def sys_status(autopilot: Autopilot, sensors: SensorBits) -> MavlinkMessage:
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


def rates_frd(autopilot: Autopilot) -> Vector3:
    return frd_from_flu(autopilot.quad.rates_rad_s)


def heading_cdeg(autopilot: Autopilot) -> int:
    yaw_ned = euler_ned_from_enu(*autopilot.quad.estimated_euler_rad())[2]
    return round(degrees(yaw_ned) % 360.0 * 100) % 36000
