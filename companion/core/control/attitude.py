"""Acceleration -> attitude and thrust, by eq. 7 and 8 as corrected."""

from __future__ import annotations

from math import atan, cos, hypot, sin, tan

from companion.geometry.vectors import between
from companion.types.autopilot import AttitudeTarget
from companion.types.values import GRAVITY_M_S2, Vector3


def limit_acceleration(
    acceleration_enu_m_s2: Vector3, max_tilt_rad: float, min_thrust_ratio: float, max_thrust_ratio: float
) -> Vector3:
    """The nearest acceleration that is possible within the tilt limit, m/s^2. Its horizontal direction is kept.

    Thrust ratios are vertical thrust over weight.
    """
    ux, uy, uz = acceleration_enu_m_s2
    lift = between(uz + GRAVITY_M_S2, min_thrust_ratio * GRAVITY_M_S2, max_thrust_ratio * GRAVITY_M_S2)
    level = hypot(ux, uy)
    most = lift * tan(max_tilt_rad)
    scale = most / level if level > most else 1.0
    return (ux * scale, uy * scale, lift - GRAVITY_M_S2)


def attitude_target(
    acceleration_enu_m_s2: Vector3,
    yaw_rad: float,
    measured_roll_rad: float,
    measured_pitch_rad: float,
    hover_thrust_norm: float,
) -> AttitudeTarget:
    """Attitude and thrust that give the wanted acceleration.

    Eq. 8 as printed is wrong. Correct, with a = u/(uZ + g): theta = atan(aX cos psi + aY sin psi) and
    phi = atan(cos theta (aX sin psi - aY cos psi)). Eq. 7, F = m (uZ + g)/(cos theta cos phi), uses the measured angles.
    Raises ValueError where uZ + g <= 0 or a measured angle is not within +-pi/2 (Remark 1: loss of control).
    """
    ux, uy, uz = acceleration_enu_m_s2
    lift = uz + GRAVITY_M_S2
    vertical_share = cos(measured_pitch_rad) * cos(measured_roll_rad)
    if not lift > 0.0 or not vertical_share > 0.0:
        raise ValueError("no attitude gives this acceleration")
    ax, ay = ux / lift, uy / lift
    cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
    pitch = atan(ax * cos_yaw + ay * sin_yaw)
    roll = atan(cos(pitch) * (ax * sin_yaw - ay * cos_yaw))
    return AttitudeTarget(roll, pitch, yaw_rad, hover_thrust_norm * lift / (GRAVITY_M_S2 * vertical_share))
