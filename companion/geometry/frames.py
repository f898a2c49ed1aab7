"""The only file that flips frames: ENU/NED, FLU/FRD, Euler/quaternion, geodetic/local.

World frame: ENU. Body frame: FLU. MAVLink uses NED and FRD. With R = Rz(psi) Ry(theta) Rx(phi) on both
sides the Euler angles map as roll -> roll, pitch -> -pitch, yaw_ned = pi/2 - yaw_enu.
"""

from __future__ import annotations

from math import asin, atan2, copysign, cos, degrees, pi, radians, remainder, sin, sqrt

from companion.types.values import Vector3

Quaternion = tuple[float, float, float, float]  # w, x, y, z

WGS84_A_M = 6378137.0
WGS84_E2 = 6.69437999014e-3


def enu_from_ned(vector_ned: Vector3) -> Vector3:
    """(north, east, down) -> (east, north, up). The same swap serves positions, velocities and accelerations."""
    north, east, down = vector_ned
    return (east, north, -down)


def ned_from_enu(vector_enu: Vector3) -> Vector3:
    """(east, north, up) -> (north, east, down)."""
    east, north, up = vector_enu
    return (north, east, -up)


def frd_from_flu(vector_flu: Vector3) -> Vector3:
    """(forward, left, up) -> (forward, right, down); rates about these axes change in the same way."""
    forward, left, up = vector_flu
    return (forward, -left, -up)


flu_from_frd = frd_from_flu


def wrap_pi(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    if -pi <= angle_rad < pi:
        return angle_rad
    return (angle_rad + pi) % (2.0 * pi) - pi


def wrap_degrees(angle_deg: float) -> float:
    """The same angle in [-180, 180], exactly: a longitude or a difference of two. Within that range it stays as it is."""
    return remainder(angle_deg, 360.0)


def euler_enu_from_ned(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Vector3:
    """Roll, pitch, yaw of FRD in NED -> of FLU in ENU. Its own inverse."""
    return (roll_rad, -pitch_rad, wrap_pi(pi / 2.0 - yaw_rad))


euler_ned_from_enu = euler_enu_from_ned


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Unit quaternion (w, x, y, z) of Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = cos(roll_rad / 2.0), sin(roll_rad / 2.0)
    cp, sp = cos(pitch_rad / 2.0), sin(pitch_rad / 2.0)
    cy, sy = cos(yaw_rad / 2.0), sin(yaw_rad / 2.0)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler_from_quaternion(quaternion: Quaternion) -> Vector3:
    """Roll, pitch, yaw of a quaternion (w, x, y, z). Raises ValueError where its norm is not close to one."""
    w, x, y, z = quaternion
    norm = sqrt(w * w + x * x + y * y + z * z)
    if not 0.99 < norm < 1.01:
        raise ValueError(f"quaternion norm {norm:.3f} is not 1")
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    sin_pitch = 2.0 * (w * y - z * x)
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(sin_pitch) if -1.0 <= sin_pitch <= 1.0 else copysign(pi / 2.0, sin_pitch),
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def _metres_per_radian(latitude_rad: float) -> tuple[float, float]:
    """(north per radian of latitude, east per radian of longitude) on the WGS84 ellipsoid."""
    root = sqrt(1.0 - WGS84_E2 * sin(latitude_rad) ** 2)
    return WGS84_A_M * (1.0 - WGS84_E2) / root**3, WGS84_A_M / root * cos(latitude_rad)


def enu_from_geodetic(
    latitude_deg: float, longitude_deg: float, altitude_amsl_m: float, origin_deg_deg_m: Vector3
) -> Vector3:
    """Position in ENU about a geodetic origin (latitude, longitude, altitude), the short way round the globe.

    Degrees are scaled as at the origin: at 300 m good to 2 cm at 47 degrees of latitude, to 20 cm at 85.
    """
    latitude0, longitude0, altitude0 = origin_deg_deg_m
    north_scale, east_scale = _metres_per_radian(radians(latitude0))
    return (
        radians(wrap_degrees(longitude_deg - longitude0)) * east_scale,
        radians(latitude_deg - latitude0) * north_scale,
        altitude_amsl_m - altitude0,
    )


def geodetic_from_enu(position_enu_m: Vector3, origin_deg_deg_m: Vector3) -> Vector3:
    """(latitude, longitude, altitude) of a position in ENU about a geodetic origin. Inverse of enu_from_geodetic."""
    latitude0, longitude0, altitude0 = origin_deg_deg_m
    north_scale, east_scale = _metres_per_radian(radians(latitude0))
    east, north, up = position_enu_m
    longitude_deg = wrap_degrees(longitude0 + degrees(east / east_scale))
    return (latitude0 + degrees(north / north_scale), longitude_deg, altitude0 + up)
